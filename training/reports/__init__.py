"""What every page of docs/ is made with: tables, numbers, intervals, figures.

Imported by file: figures need matplotlib.
"""
