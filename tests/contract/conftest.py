"""What the contract of methods needs: a small scene, its image, tiny networks; see ``tests/tiny_networks.py``."""

from tests.tiny_networks import heights, one_thread, scene

__all__ = ["heights", "one_thread", "scene"]
