"""Photos: what the cameras of many benches show of the light on their screens, brought to irradiance."""

import math

import numpy as np
import torch

from data_gen.bench_ranges import CameraRanges
from data_gen.benches.columns import BenchBatch
from warp_caustics.camera.form import CameraForm
from warp_caustics.camera.mosaic import demosaicked, mosaicked
from warp_caustics.camera.operator import channels, even, placed
from warp_caustics.camera.parameters import CameraParameters
from warp_caustics.camera.placement import Frame
from warp_caustics.camera.psf import psf_reach
from warp_caustics.camera.sensors import Frames, SensorLimits, Sensors, electrons_of, exposed_batch, keys_of
from warp_caustics.scene import Scene

MOSAIC = "rggb"
LEAST_FLAT = 0.1
"""Part of the light expected in the flat frame that a pixel must have: dead and covered ones would shine else."""
MOST_READ_SHARE = 0.99


def camera_parameters_of(benches: BenchBatch, device: torch.device) -> CameraParameters:
    """Parameters of the benches' cameras, leading dimension [B], float32."""

    def tensor(*columns: object) -> torch.Tensor:
        values = np.stack([np.asarray(column) for column in columns], axis=-1) if len(columns) > 1 else columns[0]
        return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32)).to(device, non_blocking=True)

    n, count = benches.wavelengths, len(benches)
    one = np.ones((1, n))
    mixing = benches.of("mixing")[:, None, None]
    others = (np.ones((n, n)) - np.eye(n)) / max(1, n - 1)
    light = np.stack([benches.of(f"light_{name}") for name in ("x", "y", "xx", "xy", "yy")], axis=-1)
    return CameraParameters(
        psf_px=tensor(benches.channels("psf_px")),
        box_px=tensor(benches.of("box_px")[:, None] * one),
        shift_px=tensor(benches.of("shift_x_px"), benches.of("shift_y_px")),
        turn_rad=tensor(benches.of("turn_rad")),
        magnification=tensor(benches.of("magnification")),
        homography=torch.eye(3, device=device).expand(count, 3, 3),
        colour_shift_px=tensor(benches.channels("colour_shift_x_px"), benches.channels("colour_shift_y_px")),
        colour_scale=tensor(benches.channels("colour_scale")),
        light=tensor(light[:, None, :] * one[..., None]),
        ambient=tensor(benches.of("ambient")[:, None] * one),
        mixing=tensor((1 - mixing) * np.eye(n) + mixing * others if n > 1 else np.ones((count, 1, 1))),
        gain=tensor(benches.channels("gain")),
    )


def camera_form_of(ranges: CameraRanges, pixels: int) -> CameraForm:
    """The form of all cameras that ranges allow: it must not depend on who is in a batch."""
    moves = any(span[1] > 0 for span in (ranges.shift_px, ranges.colours_apart_px, ranges.colour_scale))
    turns = any(ranges.turn_rad)
    widest = ranges.psf_px[1] * (1 + ranges.psf_apart[1])
    return CameraForm(
        pixels=pixels,
        frame=Frame(pixels, pixels),
        is_dark=False,
        places=moves or turns or ranges.magnification != (1.0, 1.0),
        turns=turns,
        blurs=widest > 0 or ranges.box_px[1] > 0,
        reach=psf_reach(widest, ranges.box_px[1]),
        mosaic=None,
    )


def sensor_limits_of(ranges: CameraRanges) -> SensorLimits:
    """What the sensors of all benches have in common."""
    sensor = ranges.sensor
    return SensorLimits(
        largest_speckle_px=sensor.speckle_width_px[1] if sensor.speckle_contrast[1] > 0 else 0.0,
        most_grains=sensor.dust_grains[1] + sensor.fresh_dust_grains[1],
        dust_radius_px=sensor.dust_radius_px,
        dust_depth=sensor.dust_depth,
        hot_level=sensor.hot_level,
    )


def sensors_of(benches: BenchBatch, device: torch.device) -> Sensors:
    """Sensors of the benches."""
    exposure = benches.of("exposure")
    full, read = electrons_of(benches.of("noise"), np.minimum(benches.of("read_share"), MOST_READ_SHARE), exposure)
    numbers = [
        exposure, full, read, benches.of("calibration_frames"), benches.of("black_level"), 2 ** benches.of("bits") - 1,
        benches.of("speckle_contrast"), benches.of("dust_grains"), benches.of("fresh_dust_grains"),
        benches.of("hot_pixels"),
    ]  # fmt: skip
    return Sensors(
        torch.from_numpy(np.stack(numbers, axis=1).astype(np.float32)).to(device, non_blocking=True),
        torch.from_numpy(benches.of("speckle_width_px").astype(np.float32)).to(device, non_blocking=True),
        torch.from_numpy(keys_of(benches.of("noise_seed"))).to(device, non_blocking=True),
    )


class Cameras:
    """Cameras of any benches of one data set.

    Args:
        ranges: that all benches are from.
        scene: gives n_w, m and L_i.
        device: where to compute.
    """

    def __init__(self, ranges: CameraRanges, scene: Scene, device: torch.device):
        self.form, self.limits = camera_form_of(ranges, scene.image_pixels), sensor_limits_of(ranges)
        self.device = device
        self.flat = torch.tensor(scene.radiosity_W_m2, device=device)
        self.level = max(scene.radiosity_W_m2)

    def signal(self, light: torch.Tensor, benches: BenchBatch) -> torch.Tensor:
        """What the channels would show without noise [W/m^2 behind a flat plate], shape [B, n_w, m, m].

        Args:
            light: on the screens [W/m^2], same shape.
            benches: B of them.
        """
        parameters = camera_parameters_of(benches, self.device)
        return self._lit(placed(light, parameters, self.form), parameters)

    def flat_signal(self, flats: torch.Tensor | None, benches: BenchBatch) -> torch.Tensor:
        """The same behind plates without relief; None for light that is even."""
        if flats is not None:
            return self.signal(flats, benches)
        m, parameters = self.form.pixels, camera_parameters_of(benches, self.device)
        # Blur and displacement leave even light as it is.
        light = self.flat[:, None, None].expand(len(benches), len(self.flat), m, m)
        return self._lit(light, parameters)

    def _lit(self, light: torch.Tensor, parameters: CameraParameters) -> torch.Tensor:
        ambient = (parameters.ambient * self.flat)[..., None, None]
        return channels(even(light, parameters, self.form) + ambient, parameters)

    def photos(self, light: torch.Tensor, flats: torch.Tensor | None, benches: BenchBatch) -> torch.Tensor:
        """Photos as irradiance [W/m^2], shape [B, n_w, m, m].

        A bench that takes frames divides by them, L_i (photo - dark) / (flat - dark); one that does not takes away its
        black level and divides by its exposure.

        Args:
            light: on the screens behind the plates [W/m^2], same shape.
            flats: behind plates without relief; None where it is even.
            benches: B of them.
        """
        is_calibrated = torch.from_numpy(benches.of("is_calibrated") > 0).to(self.device, non_blocking=True)
        has_mosaic = benches.of("has_mosaic") > 0
        takes_frames = bool((benches.of("is_calibrated") > 0).any())
        sensors = sensors_of(benches, self.device)
        lit = self.flat_signal(flats, benches) if takes_frames else None
        frames = exposed_batch(self.signal(light, benches), lit, self.level, sensors, self.limits)
        if has_mosaic.any():
            rows = torch.from_numpy(np.flatnonzero(has_mosaic)).to(self.device)
            frames = Frames(*(_through_mosaic(frame, rows) for frame in frames))
        exposure, black = (sensors.numbers[:, column, None, None, None] for column in (0, 4))
        plain = (frames.photo - black) * (self.level / exposure)
        if lit is None:
            return plain
        expected = lit * (exposure / self.level)
        divisor = torch.maximum(frames.flat - frames.dark, LEAST_FLAT * expected)
        corrected = (frames.photo - frames.dark) / divisor * self.flat[:, None, None]
        return torch.where(is_calibrated[:, None, None, None], corrected, plain)


def _through_mosaic(frame: torch.Tensor, rows: torch.Tensor) -> torch.Tensor:
    """Frames of which some are taken through colour filters, and channels made up again."""
    if not frame.numel():
        return frame
    filtered = demosaicked(mosaicked(frame[rows], MOSAIC), MOSAIC)
    return frame.index_copy(0, rows, filtered)


def has_even_flat(scene: Scene) -> bool:
    """Whether a plate without relief is evenly lit up to its border, to a quarter of a pixel."""
    if not scene.is_collimated:
        return False
    way = max(
        scene.base_thickness_m / glass - scene.screen_position_m[2] / outside
        for glass, outside in zip(scene.glass_indices, scene.exit_indices, strict=True)
    )
    return math.sin(scene.lamp_half_angle_rad) / 2 * way < 0.25 * min(scene.pixel_size_m)
