"""The window is found to a fraction of a pixel by every way to say where it is; nonsense is refused."""

import numpy as np
import pytest

from warp_caustics.capture.border import find_border
from warp_caustics.capture.corners import WindowFile, located_window, read_window_file
from warp_caustics.capture.distortion import Distortion, read_distortion
from warp_caustics.capture.read import _brightness
from warp_caustics.capture.registration import CORNER_SIGNS, CORNERS, fitted_registration
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.scene import Scene

from .conftest import M
from .pinhole_camera import PERSPECTIVE, PinholeCamera

SIZE = (0.05, 0.05)
PLATE = CORNER_SIGNS * 0.025
SQUARE = np.array([[10.0, 12], [90, 14], [88, 91], [9, 89]])
MARKS = [(-0.022, -0.022), (0.022, -0.0215), (0.0215, 0.022), (-0.022, 0.021), (0.0, 0.0225)]


def at_512(error_px: float) -> float:
    """The same error in pixels of a window of 512."""
    return error_px * 512 / M


def test_the_cameras_are_what_they_claim():
    assert PinholeCamera(**PERSPECTIVE).perspective() == pytest.approx(0.1, abs=0.012)
    camera = PinholeCamera(lens=(-0.12, 0.03, 1.5e-3, -1e-3, 0.01), **PERSPECTIVE)
    np.testing.assert_allclose(camera.screen_position(camera.project(PLATE)), PLATE, atol=1e-12)


def test_exact_points_give_the_exact_map(view):
    found = fitted_registration(PLATE, view.camera.project(PLATE), SIZE, distortion=view.lens)
    assert view.camera.window_error_px(found, 512) < 1e-6


def test_clicks_with_a_third_of_a_pixel_of_error(view):
    """The error of the window's pixels is that of the clicks, in each of 20 tries."""
    random = np.random.default_rng(3)
    errors = []
    for _ in range(20):
        clicks = view.camera.project(PLATE) + random.normal(0, 0.3, (4, 2))
        errors.append(view.camera.window_error_px(fitted_registration(PLATE, clicks, SIZE, distortion=view.lens), M))
    assert np.median(errors) > 0.05 and max(errors) < 1


def test_the_border_is_found_in_the_flat_field(view):
    found = located_window(None, _brightness(view.flat, view.dark), view.scene, distortion=view.lens)
    assert at_512(view.camera.window_error_px(found, M)) < 0.3
    assert found.figures["border_rms_px"] < 0.1 and found.figures["border_kept"] > 0.9


def test_the_border_is_found_in_the_caustic_too(view):
    found = located_window(None, _brightness(view.photo, view.dark), view.scene, distortion=view.lens)
    assert view.camera.window_error_px(found, M) < 0.5


@pytest.mark.parametrize("with_places", [False, True])
def test_marks_are_found(view, with_places):
    """Dark dots of 0.6 mm radius; with places known to 5 px, or none."""
    frame = view.camera.record(view.camera.expected(1.0, MARKS), seed=5)
    random = np.random.default_rng(4)
    markers = [{"position_m": mark} for mark in MARKS]
    if with_places:
        places = view.camera.project(np.array(MARKS)) + random.uniform(-5, 5, (5, 2))
        markers = [{**marker, "near_px": tuple(place)} for marker, place in zip(markers, places, strict=True)]
    found = located_window(WindowFile(markers=markers), _brightness(frame, view.dark), view.scene, distortion=view.lens)
    assert at_512(view.camera.window_error_px(found, M)) < 0.5
    assert found.figures["fit_rms_px"] < 0.1


def test_without_the_lens_file_the_lens_is_noticed(light):
    """Strong barrel distortion bends the border; the fit says so instead of being wrong in silence."""
    camera = PinholeCamera(width=680, height=600, finer=1, lens=(-0.35, 0, 0, 0, 0), distance_m=0.09, tilt_deg=2.0)
    brightness = _brightness(camera.record(camera.expected(1.0)), camera.record(0.0))
    with pytest.raises(InputError, match="not straight|places only"):
        find_border(brightness)


# ------------------------------------------------------------------ orientation


def test_turned_and_mirrored_views_come_back_upright(tilted):
    """The same photo, turned or mirrored as an array, with the setting that says so, gives the same window."""
    brightness = _brightness(tilted.flat, tilted.dark)
    height, width = brightness.shape
    x, y = tilted.camera.project(PLATE).T
    # np.rot90(k=-1) moves pixel (x, y) to (height - 1 - y, x): columns turn towards rows.
    turned = located_window(None, np.rot90(brightness, -1).copy(), tilted.scene, turned_deg=90)
    np.testing.assert_allclose(turned.corners_px(), np.stack([height - 1 - y, x], axis=1), atol=0.1)
    half = located_window(None, np.rot90(brightness, 2).copy(), tilted.scene, turned_deg=180)
    np.testing.assert_allclose(half.corners_px(), np.stack([width - 1 - x, height - 1 - y], axis=1), atol=0.1)
    behind = located_window(None, brightness[:, ::-1].copy(), tilted.scene, mirrored=True)
    np.testing.assert_allclose(behind.corners_px(), np.stack([width - 1 - x, y], axis=1), atol=0.1)


def test_wrong_orders_are_refused():
    for order in ([1, 0, 3, 2], [3, 2, 1, 0], [0, 3, 2, 1], [2, 1, 0, 3]):
        with pytest.raises(InputError, match="wrong way round"):
            fitted_registration(PLATE, SQUARE[order], SIZE)
        fitted_registration(PLATE, SQUARE[order], SIZE, mirrored=True)
    for order in ([0, 2, 1, 3], [1, 0, 2, 3], [0, 1, 3, 2]):
        for mirrored in (False, True):
            with pytest.raises(InputError, match="no convex quadrilateral"):
                fitted_registration(PLATE, SQUARE[order], SIZE, mirrored=mirrored)
    with pytest.raises(InputError, match="leave mirrored out"):
        fitted_registration(PLATE, SQUARE, SIZE, mirrored=True)
    for turns in (1, 2, 3):
        (warning,) = fitted_registration(PLATE, np.roll(SQUARE, turns, axis=0), SIZE).warnings
        assert "turned by" in warning
    assert fitted_registration(PLATE, SQUARE, SIZE).warnings == ()


@pytest.mark.parametrize(
    ("corners", "text"),
    [
        ([[0, 0], [90, 0], [45, 1], [0, 90]], "straight|convex"),
        ([[0, 0], [90, 0], [180, 10], [90, 10]], "sharper"),
        ([[0, 0], [0, 0], [90, 90], [0, 90]], "coincide|line"),
        ([[0, 0], [30, 30], [60, 60], [90, 90]], "line|coincide|straight|convex"),
    ],
)
def test_flat_quadrilaterals_are_refused(corners, text):
    with pytest.raises(InputError, match=text):
        fitted_registration(PLATE, corners, SIZE)


def test_points_that_fit_no_plane_are_refused():
    position = np.concatenate([PLATE, [[0.0, 0.0]]])
    shown = np.concatenate([SQUARE, [[50.0, 75.0]]])
    with pytest.raises(InputError, match="point 5|fit no flat window"):
        fitted_registration(position, shown, SIZE)


# ------------------------------------------------------------------ pictures without a window


@pytest.mark.parametrize("kind", ["black", "noise", "disc", "triangle", "all", "small"])
def test_no_window_is_one_line(kind):
    row, column = np.mgrid[:200, :240].astype(float)
    noise = np.random.default_rng(0).normal(0, 0.01, row.shape)
    picture = {
        "black": np.zeros(row.shape),
        "noise": noise,
        "disc": noise + (np.hypot(row - 100, column - 120) < 70),
        "triangle": noise + ((row > 20) & (row < 180) & (np.abs(column - 120) < (row - 20) / 2)),
        "all": 1 + noise,
        "small": noise + ((np.abs(row - 100) < 5) & (np.abs(column - 120) < 5)),
    }[kind]
    with pytest.raises(InputError) as caught:
        located_window(None, picture, Scene(image_pixels=64))
    assert "\n" not in str(caught.value) and ("give" in str(caught.value))


# ------------------------------------------------------------------ files


def test_every_way_to_write_corners_means_the_same(tmp_path):
    named = ", ".join(f"{name}: [{x}, {y}]" for name, (x, y) in zip(CORNERS, SQUARE, strict=True))
    texts = {
        "a.yaml": f"corners: {{{named}}}\n",
        "b.yaml": f"corners: {SQUARE.tolist()}\n",
        "c.csv": "corner,x_px,y_px\n" + "".join(
            f"{CORNERS[i]},{SQUARE[i][0]},{SQUARE[i][1]}\n" for i in (2, 0, 3, 1)
        ),
        "d.csv": "x_px,y_px\n" + "".join(f"{x},{y}\n" for x, y in SQUARE),
        "e.csv": "x_m,y_m,x_px,y_px\n" + "".join(
            f"{a},{b},{x},{y}\n" for (a, b), (x, y) in zip(PLATE, SQUARE, strict=True)
        ),
    }  # fmt: skip
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        found = located_window(read_window_file(tmp_path / name), np.zeros((100, 100)), Scene())
        np.testing.assert_allclose(found.corners_px(), SQUARE, atol=1e-8, err_msg=name)


@pytest.mark.parametrize(
    ("name", "text", "problem"),
    [
        ("x.yaml", "corners: {-x-y: [1, 2], +x-y: [9, 2], +x+y: [9, 9]}", "name them"),
        ("x.yaml", "corners: {a: [1, 2], b: [9, 2], c: [9, 9], d: [1, 9]}", "name them -x-y"),
        ("x.yaml", "corners: [[1, 2], [9, 2], [9, 9]]", "four are needed"),
        ("x.yaml", "corners: [[1, 2], [9, 2], [9, 9], [1, .nan]]", "finite"),
        ("x.yaml", "edges: [[1, 2]]", "unknown key"),
        ("x.yaml", "{}", "no points"),
        ("x.yaml", "just text", "no keys"),
        ("x.yaml", "points: [{position_m: [1, 2], pixel_px: [3, 4]}]", "four are needed or more"),
        ("x.csv", "a,b\n1,2\n", "columns"),
        ("x.csv", "corner,x_px,y_px\n-x-y,1,2\n-x-y,1,2\n+x+y,1,2\n-x+y,1,2\n", "twice"),
        ("x.csv", "x_px,y_px\n1,two\n1,2\n1,2\n1,2\n", "number"),
        ("x.csv", "x_px,y_px\n1,2\n1,2\n1,2\n", "four are needed"),
    ],
)
def test_bad_corner_files_are_one_line(tmp_path, name, text, problem):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as caught:
        read_window_file(tmp_path / name)
    assert problem in str(caught.value) and "\n" not in str(caught.value)


def test_millimetres_are_recognised():
    points = [{"position_m": tuple(p * 1e3), "pixel_px": tuple(q)} for p, q in zip(PLATE, SQUARE, strict=True)]
    with pytest.raises(InputError, match="did you mean millimetres"):
        located_window(WindowFile(points=points), np.zeros((100, 100)), Scene())


def test_distortion_file(tmp_path):
    camera = PinholeCamera(lens=(-0.12, 0.03, 1.5e-3, -1e-3, 0.01))
    lens = Distortion(**camera.intrinsics())
    grid = np.stack(np.meshgrid(np.linspace(0, 719, 9), np.linspace(0, 639, 9)), axis=-1)
    np.testing.assert_allclose(lens.distort(lens.undistort(grid)), grid, atol=1e-5)
    (tmp_path / "lens.yaml").write_text("{f_px: [1000, 1000], c_px: [320, 240], k1: -0.1, image_px: [640, 480]}")
    with pytest.raises(MismatchError, match="640 x 480 pixels, this one has 600 x 480"):
        read_distortion(tmp_path / "lens.yaml").check_image(480, 600)
    for text, problem in (
        ("{k1: 1}", "f_px"),
        ("{f_px: [0, 1], c_px: [1, 1]}", "greater than 0"),
        ("{f_px: [1, 1], c_px: [1, 1], k9: 3}", "unknown key"),
    ):
        (tmp_path / "bad.yaml").write_text(text)
        with pytest.raises(InputError, match=problem):
            read_distortion(tmp_path / "bad.yaml")
    with pytest.raises(InputError, match="folds"):
        Distortion(f_px=(300, 300), c_px=(320, 240), k1=-5.0).undistort([[0.0, 0.0]])
