"""What tests of methods with networks share."""

from tests.tiny_networks import heights, image, one_thread, saved, scene, shipped

__all__ = ["heights", "image", "one_thread", "saved", "scene", "shipped"]
