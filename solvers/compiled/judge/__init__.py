"""The judge's measurements: written apart from the solvers, sharing no code with them."""
