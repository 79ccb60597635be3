"""Merged exposures, unmixed channels and hot pixels, each against a truth."""

from dataclasses import replace

import numpy as np
import pytest

from warp_caustics.capture.bracketing import merged_exposures
from warp_caustics.capture.hot_pixels import dead_in_flat, hot_in_dark, odd_among_neighbours
from warp_caustics.capture.mixing import Mixing, read_mixing, unmixed
from warp_caustics.capture.radiometric import capture_to_irradiance
from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io import ImageFile

from .conftest import View
from .pinhole_camera import TILTED, PinholeCamera
from .test_photo import calibrated, registered

# ------------------------------------------------------------------ exposures

TIMES = (1e-3, 8e-3, 64e-3)


def light_of_many_decades() -> np.ndarray:
    """From 2 to 60000 counts in the shortest exposure, shape [1, 128, 128]."""
    waves = 1 + 0.4 * np.sin(np.arange(128) / 3)[:, None] * np.ones(128)
    return np.geomspace(2.0, 4e4, 128 * 128).reshape(1, 128, 128) * waves


def exposed(time_s: float, seed: int, moved: int = 0, electrons_per_count: float = 2.5) -> ImageFile:
    random = np.random.default_rng((9, seed))
    counts = np.roll(light_of_many_decades(), moved, axis=1) * (time_s / TIMES[0])
    counts = random.poisson(counts * electrons_per_count) / electrons_per_count + 100
    counts = np.clip(np.rint(counts + random.normal(0, 4, counts.shape)), 0, 65535)
    return ImageFile(counts.astype(np.float32), full_scale=65535.0, bit_depth=16, format="tiff")


def dark_frame() -> ImageFile:
    counts = np.rint(100 + np.random.default_rng(1).normal(0, 4, (1, 128, 128)))
    return ImageFile(counts.astype(np.float32), full_scale=65535.0, bit_depth=16, format="tiff")


def test_merged_exposures_beat_every_single_one():
    """In each brightness class the error is below that of each frame; faint light gains a digit and more."""
    dark, truth = dark_frame(), light_of_many_decades()
    frames = [exposed(time, i) for i, time in enumerate(TIMES)]
    merged = merged_exposures(frames, TIMES, [dark] * 3)
    assert merged.image.warnings == () and merged.exposure_s == TIMES[0]
    # Frames are trusted up to 95 % of full scale: no class reaches into the rest of one.
    classes = np.digitize(truth, [10, 100, 900, 7000])
    gains = []
    for number in range(5):
        here = classes == number
        error = np.sqrt(np.mean((merged.image.values[here] - truth[here]) ** 2))
        for frame, time in zip(frames, TIMES, strict=True):
            usable = here & (frame.values < 65535)
            if usable.sum() == here.sum():
                single = (frame.values - 100) / (time / TIMES[0])
                single_error = np.sqrt(np.mean((single[here] - truth[here]) ** 2))
                assert error < 1.02 * single_error
                if time == TIMES[0]:
                    gains.append(single_error / error)
    assert gains[0] > 10
    # Dynamic range: full scale over the error of the faintest light, beyond the 16 bits of a frame.
    faint = classes == 0
    assert 65535 / np.sqrt(np.mean((merged.image.values[faint] - truth[faint]) ** 2)) > 2**17


def test_the_estimated_noise_is_the_true_one():
    dark = dark_frame()
    results = [
        merged_exposures([exposed(time, 10 * n + i) for i, time in enumerate(TIMES)], TIMES, [dark] * 3)
        for n in range(6)
    ]
    spread = np.stack([result.image.values for result in results]).std(axis=0, ddof=1)
    true = np.sqrt(np.median(spread**2) / 0.87)  # median of chi^2_5 / 5
    assert np.mean([result.noise_std[0] for result in results]) == pytest.approx(true, rel=0.2)


def test_light_that_saturates_every_frame_stays_saturated():
    frames = [exposed(time, i) for i, time in enumerate((1.0, 2.0))]  # a thousand times too long
    merged = merged_exposures(frames, (1.0, 2.0), [None, None])
    assert (merged.image.values[0, -20:] == 65535).all()


def test_disagreement_is_reported():
    dark = [dark_frame()] * 3
    frames = [exposed(time, i) for i, time in enumerate(TIMES)]
    wrong = merged_exposures(frames, (TIMES[0], TIMES[1] * 1.1, TIMES[2]), dark)
    assert [line.startswith("frame 2 is 0.909") for line in wrong.image.warnings] == [True]
    moved = merged_exposures([frames[0], exposed(TIMES[1], 1, moved=6), frames[2]], TIMES, dark)
    assert any("move between them" in line for line in moved.image.warnings)
    offset = merged_exposures(frames, TIMES, [None] * 3)
    assert any("dark frame" in line for line in offset.image.warnings)


def test_frames_that_cannot_be_merged():
    frame = exposed(TIMES[0], 0)
    for frames, times, text in (
        ([frame], [1.0], "two or more"),
        ([frame, frame], [1.0], "one time each"),
        ([frame, frame], [1.0, 0.0], "above 0"),
        ([frame, frame], [1.0, float("nan")], "above 0"),
        ([frame, replace(frame, full_scale=None)], [1.0, 2.0], "holds floats"),
    ):
        with pytest.raises(InputError, match=text):
            merged_exposures(frames, times, [None] * len(frames))
    with pytest.raises(MismatchError, match="record all alike"):
        merged_exposures([frame, replace(frame, values=frame.values[:, :64])], [1.0, 2.0], [None, None])


# ------------------------------------------------------------------ channels

MATRIX = np.array([[0.9, 0.15, 0.02], [0.2, 0.8, 0.12], [0.03, 0.25, 0.7], [0.3, 0.4, 0.3]])
WAVELENGTHS = (610e-9, 530e-9, 430e-9)


@pytest.mark.parametrize("rows", [3, 4])
def test_unmixing_is_the_inverse_of_mixing(rows):
    light = np.random.default_rng(0).uniform(0, 2, (3, 20, 20))
    mixed = np.tensordot(MATRIX[:rows], light, axes=1)
    valid = np.ones(mixed.shape, bool)
    valid[0, 3, 4] = False
    found, good, rest = unmixed(mixed, valid, MATRIX[:rows])
    np.testing.assert_allclose(found / MATRIX[:rows].max(axis=0)[:, None, None], light, atol=1e-12)
    assert good.sum() == good.size - 3 and not good[:, 3, 4].any()
    assert np.isnan(rest) if rows == 3 else rest < 1e-12


def test_mixed_capture_gives_the_irradiance(tilted):
    """A camera with four channels that see all wavelengths; flat field and photo are unmixed alike."""
    camera = tilted.camera

    def mixed(seen: np.ndarray, seed: int) -> ImageFile:
        frame = camera.record(seen, seed=seed)
        counts = np.tensordot(MATRIX, frame.values - camera.offset, axes=1) + camera.offset
        return replace(frame, values=np.clip(np.rint(counts), 0, 65535).astype(np.float32))

    plain = capture_to_irradiance(
        tilted.photo, scene=tilted.scene, dark=tilted.dark, flat=tilted.flat, registration=registered(tilted)
    )
    frames = {kind: mixed(seen, seed) for kind, seen, seed in (("photo", tilted.seen, 1), ("flat", tilted.lit, 2))}
    dark = replace(tilted.dark, values=np.concatenate([tilted.dark.values, tilted.dark.values[:1]]))
    photo = frames["photo"]
    options = {"scene": tilted.scene, "dark": dark, "flat": frames["flat"], "registration": registered(tilted)}
    order = [2, 0, 1]
    mixing = Mixing(MATRIX[:, order], tuple(WAVELENGTHS[i] for i in order))
    capture = capture_to_irradiance(photo, mixing=mixing, **options)
    inner = capture.mask & plain.mask
    np.testing.assert_allclose(np.median((capture.irradiance - plain.irradiance)[inner]), 0, atol=2e-3)
    assert np.sqrt(np.mean((capture.irradiance - plain.irradiance)[inner] ** 2)) < 0.05
    assert any("condition number" in step for step in capture.steps)
    with pytest.raises(MismatchError, match="4 rows, the image 3 channels"):
        capture_to_irradiance(tilted.photo, scene=tilted.scene, mixing=mixing, registration=registered(tilted))
    with pytest.raises(InputError, match="exclude each other"):
        capture_to_irradiance(photo, mixing=mixing, wavelength_order="1,2,3,4", **options)


def test_matrix_files(tmp_path):
    (tmp_path / "m.csv").write_text("610e-9,530e-9,430e-9\n" + "\n".join(",".join(map(str, row)) for row in MATRIX))
    (tmp_path / "m.yaml").write_text(f"wavelengths_m: {list(WAVELENGTHS)}\nmatrix: {MATRIX.tolist()}\n")
    for name in ("m.csv", "m.yaml"):
        mixing = read_mixing(tmp_path / name)
        np.testing.assert_array_equal(mixing.matrix, MATRIX)
        assert mixing.wavelengths_m == WAVELENGTHS
    np.testing.assert_array_equal(mixing.for_scene((430e-9, 610e-9, 530e-9)), MATRIX[:, [2, 0, 1]])
    with pytest.raises(MismatchError, match="measure it with the scene's light"):
        mixing.for_scene((430e-9, 610e-9, 540e-9))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("matrix: [[1, 0], [0, 1]]", "write"),
        ("{wavelengths_m: [610e-9, 530e-9], matrix: [[1, 0], [0, x]]}", "no matrix of numbers"),
        ("{wavelengths_m: [610e-9, 530e-9], matrix: [[1, 0, 0], [0, 1, 0]]}", "shape"),
        ("{wavelengths_m: [610, 530], matrix: [[1, 0], [0, 1]]}", "give metres"),
        ("{wavelengths_m: [610e-9, 530e-9], matrix: [[1, -1], [0, 1]]}", "negative"),
        ("{wavelengths_m: [610e-9, 530e-9], matrix: [[1, 0], [1, 0]]}", "none at all"),
        ("{wavelengths_m: [610e-9, 530e-9], matrix: [[1, 1]]}", "cannot tell 2"),
        ("{wavelengths_m: [610e-9, 530e-9], matrix: [[1, 1], [1, 1.001]]}", "condition number"),
    ],
)
def test_bad_matrix_files_are_one_line(tmp_path, text, problem):
    (tmp_path / "m.yaml").write_text(text)
    with pytest.raises(InputError) as caught:
        read_mixing(tmp_path / "m.yaml")
    assert problem in str(caught.value) and "\n" not in str(caught.value)


# ------------------------------------------------------------------ hot pixels


@pytest.mark.parametrize("blur_px", [0.4, 0.6, 1.0])
def test_hot_pixels_are_found_and_filaments_are_not(light, blur_px):
    """At least 99 % of the hot and dead pixels in the window, at most 0.01 % of the good ones."""
    camera = PinholeCamera(width=340, height=300, hot=500, blur_px=blur_px, **TILTED)
    view = View(camera, *light)
    bad = np.zeros(camera.width * camera.height, bool)
    bad[camera.hot_at] = True
    bad = bad.reshape(camera.height, camera.width)
    place = camera.screen_position(np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1))
    inside = (np.abs(place) < 0.0245).all(axis=-1)
    region = (np.abs(place) < 0.025).all(axis=-1)
    dark, flat = view.dark.values.astype(float), view.flat.values.astype(float)
    signal = view.photo.values - np.median(dark, axis=(1, 2), keepdims=True)
    hits, false = [], []
    for channel in range(3):
        odd = odd_among_neighbours(signal[channel])
        found = odd | hot_in_dark(dark[channel]) | dead_in_flat(flat[channel] - dark[channel], region)
        hits.append(found[bad & inside].mean())
        false.append(found[~bad].mean())
        # The picture alone, without dark frame and flat field, eats no filament either.
        assert odd[~bad].mean() <= 1e-4
    assert min(hits) >= 0.99 and max(false) <= 1e-4


def test_hot_pixels_are_replaced_and_masked(tilted):
    with_search, without = calibrated(tilted, hot_pixels=True), calibrated(tilted)
    (stage,) = [stage for stage in with_search.stages if stage.name == "hot pixels"]
    assert stage.figures["hot_pixels"] > 60 and len(stage.marks_px) >= 30
    error = [np.abs(capture.irradiance - tilted.direct).max(axis=0) for capture in (with_search, without)]
    assert np.quantile(error[0], 0.999) <= np.quantile(error[1], 0.999)


def test_too_many_hot_pixels_are_a_wrong_frame(tilted):
    random = np.random.default_rng(0)
    spots = np.where(random.uniform(size=tilted.dark.values.shape) < 0.05, 60000, tilted.dark.values)
    capture = capture_to_irradiance(
        tilted.photo,
        scene=tilted.scene,
        flat=tilted.flat,
        flat_dark=tilted.dark,
        dark=replace(tilted.dark, values=spots.astype(np.float32)),
        registration=registered(tilted),
        hot_pixels=True,
    )
    assert any("look hot" in warning for warning in capture.warnings)
