"""What each part of the conditioned network is worth: docs/network.md."""
