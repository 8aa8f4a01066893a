"""Training of the two networks: losses, settings, checkpoints.

Imported by file: settings need no torch.
"""
