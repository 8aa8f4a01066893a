"""q_lrw of normal forces: wrench discs, weak directions, cuts, proofs and the judge's verdict.

Imported by file: each needs packages that not everybody has to load.
"""
