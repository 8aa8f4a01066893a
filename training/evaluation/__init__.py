"""Judged answers of solvers on held-out objects, and what holds when it is shaken.

Imported by file.
"""
