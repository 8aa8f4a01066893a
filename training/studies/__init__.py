"""One package for each page of docs/, or family of pages: it measures, and writes the page.

Imported by file.
"""
