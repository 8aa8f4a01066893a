"""Clocks, cores, processes and the machine, in words. Imported by file."""
