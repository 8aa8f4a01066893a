"""Policies on the same episodes: docs/policies.md and its kin."""
