"""The interior point for every convex objective, one problem at a time."""
