"""Compiled kernels (numba) of the structured solvers and of the judge; imported by file."""
