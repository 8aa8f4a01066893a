"""The conditioned network: features, network, files, and the solver `conditioned`.

Imported by file: the configuration needs no torch.
"""
