"""One orientation of all pictures: row 0 on top, as a photo viewer shows the image that was given.

Pictures of other commands are looked at wherever their own tests draw them (``tests/upright.py``).
"""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from cli.figures import new_figure, plate_extent_mm, show_plate
from cli.lit_glass import lit_glass
from cli.overview import overview_figure, uncertainty_figure
from cli.stages import stages_figure
from tests.upright import turned
from warp_caustics.capture.stage import CaptureStage
from warp_caustics.reconstruct.plot import result_figure
from warp_caustics.scene import Scene

SCENE = Scene(height_samples=32, image_pixels=64)
DARK = np.full((32, 32), 1e-6)


def corner(size):
    """Bright or high at rows and columns 0 to size / 4 only."""
    values = np.zeros((size, size))
    values[: size // 4, : size // 4] = 1
    return values


def pixels(figure):
    FigureCanvasAgg(figure).draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3].astype(int)


@pytest.mark.parametrize(("origin", "inverted"), [("upper", False), ("lower", True), ("lower", False), ("upper", True)])
def test_what_is_upside_down_is_found(any_way_up, origin, inverted):
    """By the pixels themselves: the bright corner of an array, however its axes are put."""
    figure = Figure(figsize=(2, 2), dpi=50)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(corner(32), origin=origin, cmap="gray", extent=None if origin == "lower" else (0, 1, 1, 0))
    if inverted:
        axes.invert_yaxis()
    axes.set_axis_off()
    shown = pixels(figure)[..., 0]
    is_on_top = shown[12, 12] > 200 > 50 > shown[-12, 12]
    assert (not turned(figure)) == is_on_top == ((origin, inverted) in (("upper", False), ("lower", True)))


def test_maps_of_the_plate():
    """Row 0, the lowest y, on top: in the picture and in what the axis says of it."""
    figure = new_figure(3, 3)
    axes = figure.subplots()
    show_plate(axes, SCENE, corner(32), "corner", cmap="gray")
    assert not turned(figure)
    low, high = axes.transData.transform([(0, -25), (0, 25)])[:, 1]
    assert low > high and plate_extent_mm(SCENE) == (-25, 25, 25, -25)


def test_a_result():
    image = np.stack([corner(64)] * 3)
    whole = overview_figure(scene=SCENE, measured=image, simulated=image, heights_m=corner(32))
    for figure in (whole, uncertainty_figure(SCENE, DARK), result_figure(corner(32), image, DARK, (0.05, 0.05))):
        assert sum(len(axes.get_images()) for axes in figure.axes) > 0 and not turned(figure)
    shown = pixels(whole)
    box = whole.axes[0].get_window_extent()
    x, y = box.x0 + box.width / 8, shown.shape[0] - box.y1 + box.height / 8
    assert shown[int(y), int(x)].min() > 200 > 50 > shown[int(y + box.height / 2), int(x)].max()


def test_lit_glass_is_lit_from_above():
    """In the picture: a hill is bright on the side of row 0, or it looks like a pit."""
    y, x = np.mgrid[:48, :48] - 23.5
    hill = 1e-3 * np.exp(-(x**2 + y**2) / (2 * 6**2))
    shown = lit_glass(hill, SCENE.model_copy(update={"height_samples": 48}), 5.0).mean(axis=-1)
    half = len(shown) // 2
    assert shown[: half - 8].mean() > shown[half + 8 :].mean() + 0.02


def test_steps_of_a_capture():
    """The photo as a viewer shows it, with the marks where they are."""
    image = np.stack([corner(64)] * 3)
    stage = CaptureStage(
        "window", "found", image, image, np.array([[8.0, 8.0], [56.0, 8.0], [56.0, 56.0], [8.0, 56.0]]), {}
    )
    figure = stages_figure([stage], SCENE.wavelengths_m)
    drawn = [axes for axes in figure.axes if axes.get_images()]
    assert len(drawn) == 2 and not turned(figure)
    (first,) = [line for line in drawn[0].get_lines() if len(line.get_xdata()) == 1]
    low, high = drawn[0].transData.transform([first.get_xydata()[0], (32, 32)])[:, 1]
    assert low > high, "the corner at row 8 lies above the middle"
