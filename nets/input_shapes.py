"""Refusing images and height maps of another scene than that a network was built for."""

import torch

from warp_caustics.errors import MismatchError
from warp_caustics.scene import Scene


def check_image(image: torch.Tensor, scene: Scene, name: str) -> None:
    """Refuse an image that is not of the scene; one channel must never broadcast into three.

    Args:
        image: should have shape [B, n_w, m, m].
        scene: what the network was built for.
        name: of the image, for the message.

    Raises:
        MismatchError: another shape.
    """
    _check_shape(image, (scene.n_wavelengths, scene.image_pixels, scene.image_pixels), name)


def check_heights(heights: torch.Tensor, scene: Scene, name: str) -> None:
    """Refuse a height map that is not of the scene.

    Args:
        heights: should have shape [B, n, n].
        scene: what the network was built for.
        name: of the map, for the message.

    Raises:
        MismatchError: another shape.
    """
    _check_shape(heights, (scene.height_samples, scene.height_samples), name)


def _check_shape(x: torch.Tensor, expected: tuple[int, ...], name: str) -> None:
    if x.ndim != len(expected) + 1 or tuple(x.shape[1:]) != expected:
        wanted = ", ".join(("B", *map(str, expected)))
        raise MismatchError(
            f"{name} has shape {list(x.shape)}, the network was built for [{wanted}]; "
            "use a network for this scene, or resample"
        )
