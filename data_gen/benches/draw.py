"""Drawing benches: each from the data set's fingerprint and its number, whatever else is drawn with it."""

from collections.abc import Mapping, Sequence

import numpy as np

from data_gen.bench_ranges import BenchRanges, bench_scene, nominal_lamp_rad
from data_gen.benches.columns import SEED_BITS, SET_UP_NAMES, BenchBatch, bench_batch, channel_names
from data_gen.dataset_config import DatasetConfig, sample_generator, sample_seed
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

_BENCH = (
    "gap", "base", "index", "dispersion", "lamp", "tilt", "tilt direction", "is point", "distance", "fresnel",
    "psf", "box", "shift", "shift direction", "turn", "magnification", "uneven", "x", "y", "xx", "xy", "yy",
    "ambient", "mixing", "mosaic", "calibrated", "exposure", "noise", "read share", "frames", "black", "bits",
    "contrast", "speckle width", "dust", "fresh dust", "hot",
)  # fmt: skip
"""What each of a bench's random numbers is for, in the order in which they are drawn; more may come at the end."""
_CHANNEL = ("psf apart", "apart", "direction apart", "scale", "gain")
"""The same of each channel."""
_ROOM, _ROOM_CHANNEL = 64, 8
"""Random numbers that are drawn for a bench and for a channel: what comes later changes none of those before."""


class _Drawn:
    """Uniform numbers from 0 to 1, by what they are for; shape [B] each."""

    def __init__(self, values: FloatArray, names: tuple[str, ...]):
        self._values: dict[str, FloatArray] = dict(zip(names, values.T, strict=False))

    def unit(self, name: str) -> FloatArray:
        return self._values[name]

    def uniform(self, name: str, interval: tuple[float, float]) -> FloatArray:
        low, high = interval
        return np.asarray(low + (high - low) * self._values[name])

    def either_way(self, name: str, interval: tuple[float, float]) -> FloatArray:
        """As large as the interval says, with either sign."""
        signed = 2 * self._values[name] - 1
        return np.asarray(np.copysign(interval[0] + (interval[1] - interval[0]) * np.abs(signed), signed))

    def is_one(self, name: str, share: float) -> FloatArray:
        """1 for a share of the benches, else 0."""
        return np.asarray(self._values[name] < share, dtype=np.float64)

    def whole(self, name: str, interval: tuple[int, int]) -> FloatArray:
        """Whole numbers, both ends included."""
        low, high = interval
        return np.asarray(np.minimum(np.floor(low + (high - low + 1) * self._values[name]), high))

    def logarithmic(self, name: str, interval: tuple[float, float]) -> FloatArray:
        """Uniform in its logarithm, from above 0."""
        low, high = interval
        unit = self._values[name]
        return np.asarray(low * (high / low) ** unit if low > 0 else high * unit)

    def vector(self, size: str, direction: str, interval: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
        """x and y of vectors of a length from an interval, in any direction."""
        length, angle = self.uniform(size, interval), 2 * np.pi * self._values[direction]
        return length * np.cos(angle), length * np.sin(angle)


def draw_benches(
    dataset: DatasetConfig, fingerprint: str, samples: Sequence[int], printed: Mapping[str, FloatArray]
) -> BenchBatch:
    """Benches of samples.

    Args:
        dataset: with ranges.
        fingerprint: selects the benches.
        samples: their numbers.
        printed: columns of how they are printed, shape [B] each.
    """
    ranges, scene = dataset.bench or BenchRanges(), dataset.scene
    channels = scene.n_wavelengths
    width = _ROOM + channels * _ROOM_CHANNEL
    units = [sample_generator(fingerprint, "bench", sample).random(width) for sample in samples]
    values = np.array(units, dtype=np.float64).reshape(len(samples), width)
    drawn = _Drawn(values[:, :_ROOM], _BENCH)
    columns = _set_up(ranges, scene, drawn) | _camera(ranges, drawn) | _sensor(ranges, drawn)
    psf_px = drawn.uniform("psf", ranges.camera.psf_px)
    for channel in range(channels):
        own = _Drawn(values[:, _ROOM + channel * _ROOM_CHANNEL :], _CHANNEL)
        found = _channel(ranges, own, psf_px, is_reference=channel == channels // 2)
        columns |= {channel_names(name, channels)[channel]: column for name, column in found.items()}
    seeds = [sample_seed(fingerprint, "bench noise", sample) >> (63 - SEED_BITS) for sample in samples]
    columns["noise_seed"] = np.array(seeds, dtype=np.float64)
    return bench_batch(channels, {**columns, **printed})


def scenes_of(scene: Scene, benches: BenchBatch) -> list[Scene]:
    """Scenes of benches whose ranges are about one."""
    rows = np.stack([benches.of(name) for name in SET_UP_NAMES], axis=1).tolist()
    return [bench_scene(scene, **dict(zip(SET_UP_NAMES, row, strict=True))) for row in rows]


def _set_up(ranges: BenchRanges, scene: Scene, drawn: _Drawn) -> dict[str, FloatArray]:
    bench, nominal = ranges.set_up, nominal_lamp_rad(scene)
    tilt_x, tilt_y = drawn.vector("tilt", "tilt direction", bench.tilt_rad)
    share = float(not scene.is_collimated) if bench.point_share is None else bench.point_share
    is_point = drawn.is_one("is point", share)
    near, far = bench.lamp_distance_m or (scene.light_distance_m, scene.light_distance_m)
    # Uniform in the divergence of the light, which is what an image shows.
    distance = 1 / drawn.uniform("distance", (1 / far, 1 / near)) if far > near else np.full_like(is_point, near)
    return {
        "gap_m": np.maximum(drawn.uniform("gap", bench.gap_offset_m) - scene.screen_position_m[2], 0.0),
        "base_thickness_m": drawn.uniform("base", bench.base_offset_m) + scene.base_thickness_m,
        "index_offset": drawn.uniform("index", bench.index_offset) + scene.index_offset,
        "dispersion_scale": drawn.uniform("dispersion", bench.dispersion_scale) * scene.dispersion_scale,
        "is_point_source": is_point,
        "lamp_distance_m": is_point * distance,
        "lamp_half_angle_rad": drawn.uniform("lamp", bench.lamp_half_angle_rad or (nominal, nominal)),
        "tilt_x_rad": tilt_x,
        "tilt_y_rad": tilt_y,
        "fresnel": drawn.is_one(
            "fresnel", float(scene.fresnel) if bench.fresnel_share is None else bench.fresnel_share
        ),
    }


def _camera(ranges: BenchRanges, drawn: _Drawn) -> dict[str, FloatArray]:
    camera = ranges.camera
    shift_x, shift_y = drawn.vector("shift", "shift direction", camera.shift_px)
    uneven = drawn.uniform("uneven", camera.unevenness)
    return {
        "box_px": drawn.uniform("box", camera.box_px),
        "shift_x_px": shift_x,
        "shift_y_px": shift_y,
        "turn_rad": drawn.uniform("turn", camera.turn_rad),
        "magnification": drawn.uniform("magnification", camera.magnification),
        **{f"light_{name}": uneven * (2 * drawn.unit(name) - 1) for name in ("x", "y", "xx", "xy", "yy")},
        "ambient": drawn.uniform("ambient", camera.ambient),
        "mixing": drawn.uniform("mixing", camera.mixing),
        "has_mosaic": drawn.is_one("mosaic", camera.mosaic_share),
        "is_calibrated": drawn.is_one("calibrated", camera.calibrated_share),
    }


def _sensor(ranges: BenchRanges, drawn: _Drawn) -> dict[str, FloatArray]:
    sensor = ranges.camera.sensor
    return {
        "exposure": drawn.uniform("exposure", sensor.exposure),
        "noise": drawn.logarithmic("noise", sensor.noise),
        "read_share": drawn.uniform("read share", sensor.read_share),
        "calibration_frames": drawn.whole("frames", sensor.calibration_frames),
        "black_level": drawn.uniform("black", sensor.black_level),
        "bits": drawn.whole("bits", sensor.bits),
        "speckle_contrast": drawn.uniform("contrast", sensor.speckle_contrast),
        "speckle_width_px": drawn.uniform("speckle width", sensor.speckle_width_px),
        "dust_grains": drawn.whole("dust", sensor.dust_grains),
        "fresh_dust_grains": drawn.whole("fresh dust", sensor.fresh_dust_grains),
        "hot_pixels": drawn.whole("hot", sensor.hot_pixels),
    }


def _channel(ranges: BenchRanges, drawn: _Drawn, psf_px: FloatArray, *, is_reference: bool) -> dict[str, FloatArray]:
    """Of one wavelength; the middle one keeps its place, as a displacement of all is the picture's."""
    camera, still = ranges.camera, np.zeros(len(psf_px))
    apart_x, apart_y = drawn.vector("apart", "direction apart", camera.colours_apart_px)
    return {
        "psf_px": psf_px * (1 + drawn.either_way("psf apart", camera.psf_apart)),
        "colour_shift_x_px": still if is_reference else apart_x,
        "colour_shift_y_px": still if is_reference else apart_y,
        "colour_scale": still if is_reference else drawn.either_way("scale", camera.colour_scale),
        "gain": drawn.uniform("gain", camera.gain),
    }
