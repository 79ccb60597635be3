"""Benches at random: a function of the number, within their ranges, and enough to make the photo again."""

from pathlib import Path

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from cli.config import dataset_config, load_config
from cli.shipped_files import bench_path, shipped_benches
from data_gen.bench_ranges import BenchRanges, CameraRanges, SensorRanges, SetUpRanges, bench_scene
from data_gen.benches.bench_set import Benches
from data_gen.benches.columns import bench_columns
from data_gen.benches.photos import camera_form_of, camera_parameters_of
from data_gen.dataset_config import DatasetConfig
from data_gen.samples import make_sampler
from warp_caustics import CausticSimulator, Scene
from warp_caustics.camera.config import CameraConfig
from warp_caustics.camera.operator import Camera
from warp_caustics.errors import InputError

SCENE = Scene(height_samples=16, image_pixels=48)
EVERYTHING = BenchRanges(
    set_up=SetUpRanges(
        gap_offset_m=(0, 1e-4), base_offset_m=(-3e-5, 3e-5), index_offset=(-1e-3, 1e-3), dispersion_scale=(0.9, 1.1),
        lamp_half_angle_rad=(0.001, 0.01), tilt_rad=(0.001, 0.004), point_share=0.3, lamp_distance_m=(0.3, 3),
        fresnel_share=0.5,
    ),
    camera=CameraRanges(
        psf_px=(0.3, 1), psf_apart=(0, 0.1), box_px=(0, 1), shift_px=(0, 0.3), magnification=(0.99, 1.01),
        colours_apart_px=(0, 0.2), colour_scale=(0, 5e-4), unevenness=(0, 0.03), ambient=(0, 0.02), mixing=(0, 0.05),
        gain=(0.8, 1), mosaic_share=0.3, calibrated_share=0.6,
        sensor=SensorRanges(
            exposure=(0.03, 0.06), noise=(0.003, 0.03), read_share=(0, 0.3), calibration_frames=(4, 16),
            black_level=(0, 0.03), bits=(10, 16), speckle_contrast=(0, 0.05), speckle_width_px=(0.8, 1.5),
            dust_grains=(0, 6), fresh_dust_grains=(0, 3), hot_pixels=(0, 20),
        ),
    ),
)  # fmt: skip


def config(bench=EVERYTHING, **values):
    return DatasetConfig(**{"kind": "capture", "n_samples": 40, "scene": SCENE, "bench": bench, **values})


@pytest.fixture(scope="module")
def sampler():
    return make_sampler(config(), "cpu")


@pytest.fixture(scope="module")
def batch(sampler):
    return sampler.draw(range(8))


def test_a_sample_does_not_depend_on_its_batch_or_shard(sampler, batch):
    turned = sampler.draw([6, 1])
    other_shards = make_sampler(config(n_samples=900, samples_per_shard=7), "cpu").draw([6])
    for name, array in batch.arrays.items():
        np.testing.assert_array_equal(array[[6, 1]], turned.arrays[name])
        np.testing.assert_array_equal(array[[6]], other_shards.arrays[name])
        assert not np.array_equal(array[0], array[1])
    assert not np.array_equal(make_sampler(config(seed=1), "cpu").draw([6]).arrays["bench"], turned.arrays["bench"][:1])


def test_the_record_makes_the_photo_again(batch):
    """Another process would know the configuration, the heights and the record: no more is needed, to the bit."""
    benches = Benches(config(seed=77))  # draws others
    again = benches.images(torch.from_numpy(batch.arrays["heights"]), benches.from_records(batch.arrays["bench"]))
    np.testing.assert_array_equal(again.half().numpy(), batch.arrays["image"])


def test_every_number_reaches_both_ends_of_its_range():
    benches = Benches(config()).draw(range(400))
    ranges, camera, sensor = EVERYTHING.set_up, EVERYTHING.camera, EVERYTHING.camera.sensor
    wanted = {
        "gap_m": (1e-6, 1.01e-4), "base_thickness_m": (2.97e-3, 3.03e-3), "index_offset": ranges.index_offset,
        "dispersion_scale": ranges.dispersion_scale, "lamp_half_angle_rad": ranges.lamp_half_angle_rad,
        "box_px": camera.box_px, "magnification": camera.magnification, "ambient": camera.ambient,
        "mixing": camera.mixing, "gain_0": camera.gain, "gain_2": camera.gain, "exposure": sensor.exposure,
        "read_share": sensor.read_share, "black_level": sensor.black_level,
        "speckle_contrast": sensor.speckle_contrast, "speckle_width_px": sensor.speckle_width_px,
        "colour_scale_0": (-5e-4, 5e-4),
    }  # fmt: skip
    for name, (low, high) in wanted.items():
        values = benches.of(name)
        assert low <= values.min() < low + 0.03 * (high - low), name
        assert high - 0.03 * (high - low) < values.max() <= high, name
    for name, (low, high) in {
        "bits": sensor.bits, "calibration_frames": sensor.calibration_frames, "dust_grains": sensor.dust_grains,
        "fresh_dust_grains": sensor.fresh_dust_grains, "hot_pixels": sensor.hot_pixels,
    }.items():  # fmt: skip
        assert set(benches.of(name)) == set(range(low, high + 1)), name
    for name, share in {"is_point_source": 0.3, "fresnel": 0.5, "has_mosaic": 0.3, "is_calibrated": 0.6}.items():
        assert set(benches.of(name)) == {0.0, 1.0} and abs(benches.of(name).mean() - share) < 0.1, name
    sizes = {
        "tilt": np.hypot(benches.of("tilt_x_rad"), benches.of("tilt_y_rad")) / 0.004,
        "shift": np.hypot(benches.of("shift_x_px"), benches.of("shift_y_px")) / 0.3,
        "colours": np.hypot(benches.of("colour_shift_x_px_2"), benches.of("colour_shift_y_px_2")) / 0.2,
    }
    for name, relative in sizes.items():
        assert 0.95 < relative.max() <= 1 + 1e-12, name
    noise, point = np.log(benches.of("noise")), benches.of("is_point_source") > 0
    assert abs(noise.mean() - np.log(np.sqrt(0.003 * 0.03))) < 0.15, "its logarithm is uniform"
    distance = benches.of("lamp_distance_m")
    assert 0.3 <= distance[point].min() < 0.32 and 2 < distance[point].max() <= 3 and not distance[~point].any()
    # The middle wavelength keeps its place.
    assert not benches.of("colour_shift_x_px_1").any() and not benches.of("colour_scale_1").any()


def test_a_range_changes_its_own_number_alone():
    before = Benches(config(), "f").draw(range(5))
    wider = EVERYTHING.camera.model_copy(update={"psf_px": (0.3, 1.5)})
    after = Benches(config(EVERYTHING.model_copy(update={"camera": wider})), "f").draw(range(5))
    changed = {column.name for k, column in enumerate(bench_columns(3)) if (before.values != after.values)[:, k].any()}
    assert changed == {"psf_px_0", "psf_px_1", "psf_px_2"}


def test_a_bench_with_everything_off_is_the_simulator():
    """But for a 16-bit converter's steps: a twenty-five-thousandth of flat light."""
    sampler = make_sampler(config(BenchRanges()), "cpu")
    heights = sampler.reliefs.true([3])
    seen = sampler.benches.images(heights, sampler.benches.draw([3]))
    light = CausticSimulator(SCENE)(heights)
    assert (seen - light).abs().max() < 1 / (0.04 * 65535)
    torch.testing.assert_close(sampler.benches.light(heights, sampler.benches.draw([3])), light, rtol=0, atol=0)


@pytest.mark.parametrize("angle", [0.05, 0.01])
def test_a_scene_with_a_point_source_keeps_it(angle):
    """Off the plate's centre, of its own size, and where it lights a part of the plate alone."""
    scene = SCENE.model_copy(
        update={
            "emission_half_angle_rad": angle,
            "light_position_m": (0.01, -0.005, 0.8),
            "lamp_radius_m": 2e-3,
            "screen_position_m": (1e-3, 0.0, -1e-3),
        }
    )
    benches = Benches(config(BenchRanges(), scene=scene), "f")
    drawn, heights = benches.draw([0]), 1e-4 * torch.rand(1, 16, 16, generator=torch.Generator().manual_seed(2))
    assert drawn.of("is_point_source")[0] == 1 and drawn.of("lamp_distance_m")[0] == pytest.approx(0.797)
    wanted = CausticSimulator(scene, **benches.config.clean.record())(heights)
    torch.testing.assert_close(benches.light(heights, drawn), wanted, rtol=2e-3, atol=2e-3)
    nearer = BenchRanges.model_validate({"set_up": {"lamp_distance_m": (0.4, 0.5), "tilt_rad": (0, 0.01)}})
    for bench in Benches(config(nearer, scene=scene), "f").scenes(
        Benches(config(nearer, scene=scene), "f").draw([1, 2])
    ):
        assert 0.4 <= bench.light_distance_m <= 0.5 and not bench.is_collimated


def test_the_camera_is_that_of_nsfc_simulate():
    """The same numbers as a CameraConfig: what the channels show without noise agrees, but for where a PSF is cut."""
    benches = Benches(config())
    drawn = benches.draw(range(3))
    light = torch.rand(3, 3, 48, 48, generator=torch.Generator().manual_seed(1)) + 0.5
    seen = benches.cameras.signal(light, drawn)
    for row in range(3):
        record = drawn.record(row)
        mix = record["mixing"]
        camera = CameraConfig(
            psf_px=tuple(record[f"psf_px_{k}"] for k in range(3)),
            box_px=record["box_px"],
            shift_px=(record["shift_x_px"], record["shift_y_px"]),
            magnification=record["magnification"],
            colour_shift_px=tuple(
                (record[f"colour_shift_x_px_{k}"], record[f"colour_shift_y_px_{k}"]) for k in range(3)
            ),
            colour_scale=tuple(record[f"colour_scale_{k}"] for k in range(3)),
            light=tuple(record[f"light_{name}"] for name in ("x", "y", "xx", "xy", "yy")),
            ambient=record["ambient"],
            mixing=tuple(tuple(1 - mix if i == j else mix / 2 for j in range(3)) for i in range(3)),
            gain=tuple(record[f"gain_{k}"] for k in range(3)),
        )
        torch.testing.assert_close(seen[row], Camera(camera, SCENE).signal(light[row]), rtol=0, atol=6e-4)


def test_frames_take_away_what_is_the_cameras():
    """Uneven light, gains, dust that was there before and the black level; a flat plate shows L_i, with noise."""
    sensor = SensorRanges(noise=(0.01, 0.01), black_level=(0.02, 0.02), dust_grains=(6, 6), calibration_frames=(64, 64))
    camera = CameraRanges(unevenness=(0.1, 0.1), gain=(0.7, 1), sensor=sensor)
    flat = torch.zeros(1, 16, 16)
    seen = {}
    for share in (0.0, 1.0):
        ranges = BenchRanges(camera=camera.model_copy(update={"calibrated_share": share}))
        benches = Benches(config(ranges), "f")
        seen[share] = benches.images(flat, benches.draw([0]))[0]
    assert abs(float(seen[1.0].mean()) - 1) < 1e-3 and 0.008 < float(seen[1.0].std()) < 0.016
    assert float(seen[0.0].std()) > 0.05


def test_light_from_aside_and_from_near_stays_below_the_plate():
    """The window follows the flat plate's image: a relief's picture stays where it was, to a tenth of a pixel."""
    common = {
        "gap_m": 2e-3, "base_thickness_m": 3e-3, "index_offset": 0.0, "dispersion_scale": 1.0, "fresnel": 0.0,
        "lamp_half_angle_rad": 0.0, "lamp_distance_m": 2.0,
    }  # fmt: skip
    scene = Scene(height_samples=32, image_pixels=64)
    y, x = np.mgrid[-15.5:16, -15.5:16]
    heights = torch.tensor(2e-4 * np.exp(-(x**2 + y**2) / 8), dtype=torch.float32)

    def centre(bench):
        image = (CausticSimulator(bench)(heights) - CausticSimulator(bench)(0 * heights))[1, 8:-8, 8:-8].clamp(min=0)
        place = torch.arange(48.0)
        return torch.stack([(image.sum(0) * place).sum(), (image.sum(1) * place).sum()]) / image.sum()

    straight = centre(bench_scene(scene, **common, is_point_source=0.0, tilt_x_rad=0.0, tilt_y_rad=0.0))
    for is_point in (0.0, 1.0):
        bench = bench_scene(scene, **common, is_point_source=is_point, tilt_x_rad=0.1, tilt_y_rad=-0.06)
        assert abs(bench.screen_position_m[0]) > 3e-4 and bench.is_collimated == (not is_point)
        # Half a pixel is what the relief itself, thicker than the base, moves.
        assert (centre(bench) - straight).abs().max() < 0.2


def test_kinds_of_prints_come_as_often_as_they_should():
    level = load_config(also=[bench_path("ordinary")]).data.bench
    benches = Benches(config(level)).draw(range(300))
    shares = np.bincount(benches.of("print_kind").astype(int), minlength=4) / 300
    np.testing.assert_allclose(shares, [0.2, 0.4, 0.2, 0.2], atol=0.08)
    made = benches.of("print_kind") >= 2
    diameters = benches.of("print_fibre_diameter_m")
    assert (diameters[made] >= 3.8e-4).all() and not diameters[~made].any()
    assert len(set(benches.of("print_section")[benches.of("print_kind") == 1])) == 3


@pytest.mark.parametrize("name", ["careful", "ordinary", "poor"])
def test_shipped_levels_show_plates(name):
    described = dataset_config(
        load_config(None, ["scene.height_samples=16", "scene.image_pixels=48"], also=[bench_path(name)]),
        kind="capture",
        n_samples=4,
    )
    batch = make_sampler(described, "cpu").draw(range(4))
    assert np.isfinite(batch.arrays["image"]).all()
    means = batch.arrays["image"].astype(float).mean(axis=(2, 3))
    assert ((means > 0.4) & (means < 1.3)).all() and batch.arrays["heights"].max() > 1e-5


def test_levels_widen():
    levels = [load_config(also=[bench_path(name)]).data.bench for name in ("careful", "ordinary", "poor")]
    assert set(shipped_benches()) == {"careful", "ordinary", "poor"}
    for section, names in (
        ("set_up", ("gap_offset_m", "base_offset_m", "index_offset", "lamp_half_angle_rad", "tilt_rad")),
        ("camera", ("psf_px", "colours_apart_px", "unevenness", "ambient", "mixing", "shift_px")),
    ):
        for name in names:
            ends = [getattr(getattr(level, section), name)[1] for level in levels]
            assert ends[0] < ends[1] < ends[2], name
    for level, told in zip(levels, (5e-6, 5e-5, 2e-4), strict=True):
        assert level.set_up.gap_offset_m[0] <= told <= level.set_up.gap_offset_m[1]


def test_data_sets_without_benches_do_not_know_them():
    for kind in ("denoiser", "updater"):
        assert "bench" not in DatasetConfig(kind=kind, n_samples=1).canonical()
    first, second = config(), config(BenchRanges())
    assert first.fingerprint() != second.fingerprint() and "bench" in first.canonical()


def changed(section, **values):
    return {section: {**EVERYTHING.model_dump()[section], **values}}


@pytest.mark.parametrize(
    ("bench", "reason"),
    [
        (changed("set_up", gap_offset_m=(1e-4, 0)), "lower end 0.0001 is above upper end 0; swap them"),
        (changed("camera", psf_px=(2, 1)), r"lower end 2 is above upper end 1; swap them, write \[1, 2\]"),
        (changed("camera", mixing=(0, 1.2)), "upper end 1.2 is above 1"),
        (changed("camera", ambient=(-0.1, 0)), "lower end -0.1 is below 0; give 0 for none"),
        (changed("set_up", lamp_distance_m=(-0.1, 1)), "puts the lamp behind the plate's top .limit 0.; raise it"),
        (changed("set_up", lamp_distance_m=(0.3, 30)), "upper end 30 m is beyond 10 m; lower it"),
        (changed("set_up", lamp_half_angle_rad=(0, 1.5)), "lamp of .*use at most 0.2|too large for its distance"),
        (changed("set_up", tilt_rad=(0, 0.3)), "light_tilt_rad .* is beyond 0.25.*use -0.25 to 0.25"),
        (changed("set_up", gap_offset_m=(-1e-3, 0)), "-0.001 m puts the screen inside the plate.*give at least -1e-06"),
        (changed("set_up", base_offset_m=(-4e-3, 0)), "leaves nothing of a base of 0.003 m; give more than -0.003"),
        (changed("set_up", lamp_distance_m=None), "give bench.set_up.lamp_distance_m"),
        (changed("camera", shift_px=(0, 20)), "sees nothing of parts of the window.* 48 px; give at most 12"),
        (changed("camera", psf_px=(0, 9)), "too wide for 48 px; give at most 3"),
        (
            changed("camera", sensor={"exposure": (0.001, 0.01), "bits": (8, 8)}),
            r"the camera sees nothing.*\(limit 4\); raise bench.camera.sensor.exposure",
        ),
        (
            changed("camera", sensor={"exposure": (0.5, 1)}),
            "a flat plate saturates the camera.*lower bench.camera.sensor.exp",
        ),
        ({"prints": ()}, "prints is empty; give at least one kind"),
    ],
)
def test_benches_that_cannot_be_are_refused(bench, reason):
    with pytest.raises(ValidationError, match=reason):
        config(BenchRanges.model_validate(bench))


def test_kind_and_bench_go_together():
    with pytest.raises(ValidationError, match="needs ranges of benches; give --bench ordinary"):
        config(None)
    with pytest.raises(ValidationError, match="bench is for captures, this is a data set of the updater"):
        config(kind="updater")
    with pytest.raises(InputError, match=r"records have shape \[2, 5\]; give \[B, 67\]"):
        Benches(config()).from_records(np.zeros((2, 5)))


def test_two_wavelengths_have_their_columns():
    scene = Scene(height_samples=16, image_pixels=48, wavelengths_m=(6e-7, 5e-7), radiosity_W_m2=(1, 0.5))
    ranges = EVERYTHING.model_copy(update={"camera": EVERYTHING.camera.model_copy(update={"mosaic_share": 0.0})})
    benches = Benches(config(ranges, scene=scene))
    images = benches.images(torch.zeros(2, 16, 16), benches.draw([0, 1]))
    assert images.shape == (2, 2, 48, 48) and len(benches.columns) == 62
    with pytest.raises(ValidationError, match="mosaic_share 0.3 needs three wavelengths, the scene has 2"):
        config(scene=scene)


def test_the_form_depends_on_ranges_alone():
    form = camera_form_of(CameraRanges(), 48)
    assert not (form.places or form.turns or form.blurs)
    form = camera_form_of(EVERYTHING.camera, 48)
    assert form.places and form.blurs and not form.turns
    parameters = camera_parameters_of(Benches(config()).draw([0, 1]), torch.device("cpu"))
    assert parameters.mixing.shape == (2, 3, 3) and torch.allclose(parameters.mixing.sum(-1), torch.ones(2, 3))


@pytest.mark.gpu
def test_on_a_gpu_the_same_to_rounding(device):
    configuration = config()
    on_cpu, on_gpu = (make_sampler(configuration, name) for name in ("cpu", device))
    a, b = on_cpu.draw(range(6)), on_gpu.draw(range(6))
    np.testing.assert_array_equal(a.arrays["bench"], b.arrays["bench"])
    difference = np.abs(a.arrays["image"].astype(float) - b.arrays["image"].astype(float))
    # Rounding may tip a Poisson number over here and there.
    assert np.quantile(difference, 0.95) < 5e-3


def test_configs_stand_beside_the_cameras():
    assert bench_path("poor") == Path(__file__).parents[2] / "configs" / "benches" / "poor.yaml"
