"""Cameras of images that tests make."""

import dataclasses

import numpy as np
import torch

from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.pixel_means import pixel_means
from warp_caustics.reconstruct.seen_camera.point_spread import FineLight
from warp_caustics.simulator import CausticSimulator


def blurring(blur_px, pixels):
    """One that blurs by Gaussians in the pixels' band [px], a number or one for each of three channels."""
    blur = np.array(np.broadcast_to(np.asarray(blur_px, float), 3))
    return dataclasses.replace(ChannelCamera.perfect(3, pixels), blur=blur)


def through_lens(scene, heights, lens_px, noise):
    """An image of a relief that a lens blurred before its pixels [px], with noise of a flat plate's light."""
    fine = FineLight(CausticSimulator(scene))(heights)
    shown = torch.stack([pixel_means(light, scene.image_pixels, lens_px) for light in fine]).numpy()
    white = np.random.default_rng(0).standard_normal(shown.shape)
    return CausticImage((shown + noise * white).astype(np.float32), np.full(3, noise))
