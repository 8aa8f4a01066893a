"""One package for each page of docs/: it measures, and writes the page."""
