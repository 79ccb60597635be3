"""Reconstruction with networks: methods of the same interface as those in ``warp_caustics.reconstruct``."""
