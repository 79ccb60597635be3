"""Blur and displacement of channels that were sampled by colour filters, with lines in closed form."""

import numpy as np
import pytest
import torch

from tests.warp_caustics.reconstruct.seen_camera.test_channel_registration import BLUE, RED, lines, noise, stacked
from warp_caustics.reconstruct.colour_filters import own_pixels, through_filters
from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.channel_registration import registered
from warp_caustics.reconstruct.seen_camera.mosaic_registration import as_seen, registered_through_filters

OWN = own_pixels("rggb", 128)


def found(measured, simulated):
    through = through_filters(measured, OWN)
    return registered_through_filters(Measurement(through, torch.ones_like(through), None), simulated, OWN)


@pytest.mark.parametrize("blur", [(0.8, 0.8, 0.8), (1.5, 1.2, 1.8)])
@pytest.mark.parametrize("bent", [0.0, 0.3])
def test_blur_is_found_behind_filters(blur, bent):
    """Which is not what spectra of all pixels say, sharp lines being made up in between."""
    measured = stacked(*[lines(blur=each) for each in blur]) + noise(3, 128, 128)
    camera = found(measured, stacked(*[lines(bent=bent)] * 3))
    np.testing.assert_allclose(camera.blur, blur, atol=0.2)


def test_sharp_lines_are_sharp_though_pixels_were_made_up():
    sharp = stacked(*[lines()] * 3) + noise(3, 128, 128)
    assert not found(sharp, stacked(*[lines(bent=0.3)] * 3)).blurs


def test_spectra_of_all_pixels_do_not_tell_blur_behind_filters():
    """Red and blue look sharp, and green as if it had the blur of all: why own pixels are asked alone."""
    measured = through_filters(stacked(*[lines(blur=0.8)] * 3) + noise(3, 128, 128), OWN)
    plain = registered(Measurement(measured, torch.ones_like(measured), None), stacked(*[lines()] * 3))
    assert np.abs(plain.blur - 0.8).max() > 0.3


def test_displacements_are_found_behind_filters():
    measured = stacked(lines(RED), lines(), lines(BLUE)) + noise(3, 128, 128)
    camera = found(measured, stacked(*[lines()] * 3))
    np.testing.assert_allclose(camera.shift, [RED, (0, 0), BLUE], atol=0.06)


def test_a_channel_without_light_tells_nothing():
    measured = stacked(lines(blur=1.0), lines(blur=1.0), np.zeros((128, 128)))
    weight = torch.ones_like(measured)
    weight[2] = 0
    through = Measurement(through_filters(measured, OWN), weight, None)
    camera = registered_through_filters(through, stacked(lines(), lines(), np.zeros((128, 128))), OWN)
    np.testing.assert_allclose(camera.blur[:2], 1.0, atol=0.2)
    assert camera.blur[2] == 0


def test_a_simulation_is_shown_as_closed_forms_are():
    camera = ChannelCamera(
        np.array([RED, (0, 0), BLUE]), np.array([2e-3, 0, 0]), np.array([0.0, 1.0, 0.0]), np.ones(3), np.zeros(3), 128
    )
    shown = as_seen(stacked(*[lines()] * 3), camera)
    wanted = stacked(lines(RED, 2e-3), lines(blur=1.0), lines(BLUE))
    inside = (..., slice(16, -16), slice(16, -16))
    np.testing.assert_allclose(shown[inside], wanted[inside], atol=0.03)
