"""Cameras of images that tests make."""

import dataclasses

import numpy as np

from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera


def blurring(blur_px, pixels):
    """One that blurs by Gaussians in the pixels' band [px], a number or one for each of three channels."""
    blur = np.array(np.broadcast_to(np.asarray(blur_px, float), 3))
    return dataclasses.replace(ChannelCamera.perfect(3, pixels), blur=blur)
