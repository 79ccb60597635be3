"""The picture of a result."""

import numpy as np
import pytest

from cli.figures import rgb_composite, write_figure
from cli.overview import overview_figure, uncertainty_figure
from warp_caustics.io.images import read_image
from warp_caustics.scene import Scene


def test_longest_wavelength_is_red_and_shortest_blue():
    image = np.stack([np.full((2, 2), value) for value in (0.25, 0.5, 1.0)])
    shown = rgb_composite(image, (430e-9, 610e-9, 530e-9), white=1.0)
    np.testing.assert_allclose(shown[0, 0] ** 2.2, [0.5, 1.0, 0.25])


@pytest.mark.parametrize("count", [1, 2, 5])
def test_any_number_of_wavelengths_is_shown(count):
    wavelengths = tuple(np.linspace(700e-9, 400e-9, count))
    shown = rgb_composite(np.arange(count * 4.0).reshape(count, 2, 2), wavelengths, white=4.0 * count)
    assert shown.shape == (2, 2, 3)
    assert np.ptp(shown, axis=-1).max() == 0 if count == 1 else np.ptp(shown, axis=-1).max() > 0


def test_values_beyond_white_and_below_zero_are_clipped():
    shown = rgb_composite(np.array([[[-1.0, 7.0]]]), (530e-9,), white=2.0)
    np.testing.assert_array_equal(shown[0, :, 0], [0.0, 1.0])


@pytest.fixture
def panels():
    """Images of the four panels for an image with one bright and one missing corner."""
    scene = Scene(height_samples=16, image_pixels=32, plate_size_m=(0.04, 0.02))
    measured, simulated, heights = np.ones((3, 32, 32)), np.ones((3, 32, 32)), np.zeros((16, 16))
    measured[:, :2, :2], simulated[:, -2:, -2:] = 9.0, 2.0
    simulated[:, 10, 10] = 0.25
    heights[-1, 0] = 1e-3
    figure = overview_figure(scene=scene, measured=measured, simulated=simulated, heights_m=heights, caption="caption")
    return [axes.images[0] for axes in figure.axes[:4]]


def test_input_and_simulation_share_their_scale(panels):
    """White is the 99.5th percentile of the input: its few brightest pixels, 0.4 % here, do not count."""
    measured, simulated = (panel.get_array() for panel in panels[:2])
    assert measured[5, 5, 0] == simulated[5, 5, 0] == 1.0
    assert simulated[10, 10, 0] == pytest.approx(0.25 ** (1 / 2.2))


def test_heights_are_micrometres_on_millimetres_with_row_0_on_top(panels):
    heights = panels[2]
    assert heights.get_array()[-1, 0] == pytest.approx(1000)
    assert heights.get_extent() == [-20.0, 20.0, 10.0, -10.0]
    assert heights.origin == "upper"
    assert heights.colorbar.ax.get_ylabel() == "height [um]"


def test_residual_is_signed_and_its_colours_symmetric(panels):
    residual = panels[3]
    assert residual.get_array()[-1, -1] == pytest.approx(1.0)
    assert residual.get_array()[0, 0] == pytest.approx(-8.0)
    low, high = residual.get_clim()
    assert low == -high < 0


def figure_of(scene, value):
    image = np.full((3, 32, 32), value)
    return overview_figure(scene=scene, measured=image, simulated=image, heights_m=np.zeros((16, 16)))


def test_a_black_image_matched_perfectly_is_still_a_picture(full_figures, tmp_path, tiny_scene):
    write_figure(tmp_path / "a.png", figure_of(tiny_scene, 0.0))
    picture = read_image(tmp_path / "a.png").values
    assert picture.shape[1:] == (1000, 1100) and np.ptp(picture) > 0


def test_a_failing_writer_leaves_no_file(tmp_path, tiny_scene):
    with pytest.raises(ValueError, match="xyz"):
        write_figure(tmp_path / "a.xyz", figure_of(tiny_scene, 1.0))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("least_um", "low_um"), [(0.5, 0.5), (4.0, 0.8), (1e-4, 8e-3)])
def test_colours_of_an_uncertainty_begin_at_its_least(least_um, low_um):
    """But a decade at least and three at most below the largest."""
    uncertainty = np.full((16, 16), least_um * 1e-6)
    uncertainty[3, 4] = 8e-6
    figure = uncertainty_figure(Scene(height_samples=16, image_pixels=32), uncertainty)
    norm = figure.axes[0].images[0].norm
    assert (norm.vmin, norm.vmax) == (pytest.approx(low_um), pytest.approx(8.0))
