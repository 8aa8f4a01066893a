"""What only the paper's reproduction needs: matrix inequalities, its ODE, its network.

Imported by file: each needs packages of its own.
"""
