"""Exact solvers: `dual_newton`, `interior_point`, `clarabel`, `dual_newton_torch`.

Imported by file: each needs packages of its own.
"""
