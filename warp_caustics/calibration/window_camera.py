"""A camera as captures have it, the window and nothing else; and back to a record."""

from typing import Any

import torch

from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.parameters import CameraParameters
from warp_caustics.errors import InputError


def shown_window(camera: CameraConfig) -> CameraConfig:
    """The camera as captures have it: the window and nothing else, without sensor and mosaic.

    Raises:
        InputError: a camera of other channels than wavelengths.
    """
    tree = camera.model_dump()
    if camera.mixing is not None and len(camera.mixing) != len(camera.mixing[0]):
        raise InputError("a capture has a channel for each wavelength; leave mixing out of the camera")
    if camera.frame_px is not None:
        # Registered: where the window lies in the photo is known, and nothing of it is left in the capture.
        tree |= {"homography": None, "corners_px": None, "shift_px": (0.0, 0.0), "turn_rad": 0.0, "magnification": 1.0}
    tree |= {"frame_px": None, "mosaic": None, "sensor": {}}
    return CameraConfig.model_validate(tree)


def camera_record(nominal: CameraConfig, parameters: CameraParameters) -> CameraConfig:
    """A camera's parameters as a configuration.

    Args:
        nominal: gives what is no parameter.
        parameters: of no batch.
    """

    def values(tensor: torch.Tensor) -> Any:
        return tensor.detach().cpu().tolist()

    def pairs(tensor: torch.Tensor) -> Any:
        return tuple(tuple(row) for row in values(tensor))

    p = parameters
    is_straight = torch.equal(p.homography.cpu(), torch.eye(3, dtype=p.homography.dtype))
    is_unmixed = torch.equal(p.mixing.cpu(), torch.eye(len(p.mixing), dtype=p.mixing.dtype))
    tree = nominal.model_dump() | {
        "psf_px": tuple(values(p.psf_px)),
        "box_px": tuple(values(p.box_px)),
        "shift_px": tuple(values(p.shift_px)),
        "turn_rad": values(p.turn_rad),
        "magnification": values(p.magnification),
        "homography": None if is_straight else pairs(p.homography),
        "colour_shift_px": pairs(p.colour_shift_px),
        "colour_scale": tuple(values(p.colour_scale)),
        "light": pairs(p.light),
        "ambient": tuple(values(p.ambient)),
        "mixing": None if is_unmixed else pairs(p.mixing),
        "gain": tuple(values(p.gain)),
    }
    return CameraConfig.model_validate(tree)
