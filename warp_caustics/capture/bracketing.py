"""Several frames of one view with different exposure times, merged to one linear image.

Counts per second are averaged with the inverse of their expected variance
(electrons and read noise), saturated pixels left out. The result is in counts
of the shortest frame, so that its full scale stays that of the camera.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from warp_caustics.errors import InputError, MismatchError
from warp_caustics.io.image_file import ImageFile
from warp_caustics.io.noise import BoolImage, FloatImage

NEAR_SATURATION = 0.95
"""Sensors bend before they clip; frames are trusted up to this part of full scale."""
MAX_DISAGREEMENT = 0.02
"""Relative difference between the frames' brightness that exposure times do not explain."""
MOVED_SIGMAS, MAX_MOVED = 6.0, 0.01
"""Pixels further apart than noise explains, and how many of them are tolerated."""


@dataclass(frozen=True, eq=False)
class Merged:
    """One image of several frames.

    Attributes:
        image: counts of the shortest frame, dark subtracted, shape [C, H, W]; full scale where every frame saturates;
            its warnings tell where frames disagree.
        exposure_s: of the shortest frame [s].
        noise_std: median expected standard deviation per channel [counts of the shortest frame], shape [C].
        used: mean number of frames per pixel that were not saturated.
        ratios: brightness of each frame over what its exposure time says, by the frame that it agrees with best.
    """

    image: ImageFile
    exposure_s: float
    noise_std: FloatImage
    used: float
    ratios: tuple[float, ...]


def merged_exposures(
    frames: Sequence[ImageFile], times_s: Sequence[float], darks: Sequence[ImageFile | None]
) -> Merged:
    """Merge frames of one view.

    Args:
        frames: integer frames, each of shape [C, H, W].
        times_s: exposure time of each [s].
        darks: dark frame of each, or None.

    Raises:
        InputError: fewer than two frames, equal times only, floats, or times that are not above 0.
        MismatchError: frames of different shape or depth.
    """
    first = frames[0]
    if len(frames) < 2 or len(times_s) != len(frames):
        raise InputError(f"{len(frames)} frames and {len(times_s)} exposure times; give two or more, one time each")
    for number, frame in enumerate(frames, 1):
        if frame.full_scale is None:
            raise InputError(
                f"frame {number} holds floats, whose saturation cannot be told; give the camera's integers"
            )
        if frame.values.shape != first.values.shape or frame.full_scale != first.full_scale:
            raise MismatchError(
                f"frame {number} has shape {frame.values.shape} and {frame.bit_depth} bits, "
                f"the first {first.values.shape} and {first.bit_depth}; record all alike"
            )
    times = np.asarray(times_s, np.float64)
    if not (np.isfinite(times) & (times > 0)).all():
        raise InputError(f"exposure times {list(times_s)} are not all above 0 s")
    full = float(first.full_scale or 0.0)
    order = np.argsort(times)
    shortest = float(times[order[0]])
    gains = times / shortest
    signals = [
        _without_dark(frame, dark, number) for number, (frame, dark) in enumerate(zip(frames, darks, strict=True), 1)
    ]
    usable = [frame.values < NEAR_SATURATION * full for frame in frames]
    electrons, floor = _camera_noise(signals, usable, gains)
    total, weight = np.zeros(first.values.shape), np.zeros(first.values.shape)
    count = np.zeros(first.values.shape)
    # The variance comes from a common estimate of the brightness: each frame's own would favour those that read low.
    level = signals[int(order[0])]
    for index in order[1:]:
        level = np.where(usable[int(index)], signals[int(index)] / gains[int(index)], level)
    for signal, good, gain in zip(signals, usable, gains, strict=True):
        variance = (floor + electrons * np.maximum(level * gain, 0.0)) / gain**2
        part = np.where(good, 1 / variance, 0.0)
        total += part * signal / gain
        weight += part
        count += good
    lost = weight == 0
    values = np.where(lost, full, total / np.where(lost, 1.0, weight))
    noise = np.array([
        float(np.median(1 / np.sqrt(w[w > 0]))) if (w > 0).any() else float("nan") for w in weight
    ])  # fmt: skip
    ratios, warnings = _agreement(signals, usable, gains, (electrons, floor))
    notes = [line for frame in frames for line in frame.warnings]
    image = replace(first, values=values.astype(np.float32), warnings=(*dict.fromkeys(notes), *warnings))
    return Merged(image, shortest, noise, float(count.mean()), ratios)


def _without_dark(frame: ImageFile, dark: ImageFile | None, number: int) -> FloatImage:
    from warp_caustics.io.noise import smooth_frame

    if dark is None:
        return frame.values.astype(np.float64)
    if dark.values.shape != frame.values.shape:
        raise MismatchError(f"the dark frame of frame {number} has shape {dark.values.shape}; record both alike")
    smooth = np.stack([smooth_frame(channel)[0] for channel in dark.values.astype(np.float64)])
    return np.asarray(frame.values - smooth)


def _camera_noise(signals: Sequence[FloatImage], usable: Sequence[BoolImage], gains: FloatImage) -> tuple[float, float]:
    """Variance per count of signal, and read variance [counts^2], from how frames differ from each other."""
    shorter, longer = int(np.argmin(gains)), int(np.argmax(gains))
    if shorter == longer:
        longer = 1 - shorter
    good = usable[shorter] & usable[longer]
    ratio = gains[longer] / gains[shorter]
    if good.sum() < 4096:
        return 1.0, 1.0
    level = signals[longer][good] / ratio
    difference = signals[shorter][good] - level
    # var = (a L + f) + (a L ratio + f) / ratio^2
    edges = np.quantile(level, np.linspace(0, 1, 25))
    which = np.clip(np.searchsorted(edges, level) - 1, 0, 23)
    mean = np.array([level[which == i].mean() if (which == i).any() else np.nan for i in range(24)])
    spread = np.array([
        1.4826 * np.median(np.abs(d - np.median(d))) if (d := difference[which == i]).size > 32 else np.nan
        for i in range(24)
    ])  # fmt: skip
    known = np.isfinite(mean) & np.isfinite(spread) & (spread > 0)
    if known.sum() < 4:
        return 1.0, 1.0
    from scipy import optimize

    relative = 1 / spread[known] ** 2
    columns = np.stack([np.maximum(mean[known], 0.0) * (1 + 1 / ratio), np.full(known.sum(), 1 + 1 / ratio**2)], axis=1)
    scale = np.maximum(np.abs(columns).max(axis=0), 1e-300)
    found, _ = optimize.nnls(columns / scale * relative[:, None], spread[known] ** 2 * relative)
    electrons, floor = found / scale
    # Rounding to whole counts alone is a variance of 1/12.
    return float(electrons), float(max(floor, 1 / 12))


def _agreement(
    signals: Sequence[FloatImage], usable: Sequence[BoolImage], gains: FloatImage, camera: tuple[float, float]
) -> tuple[tuple[float, ...], tuple[str, ...]]:
    """Brightness of each frame over the frame that it agrees with best, and what exposure times do not explain."""
    count = len(signals)
    pairs, moved = np.full((count, count), np.nan), 0.0
    electrons, floor = camera
    for i in range(count):
        for j in range(i + 1, count):
            both = usable[i] & usable[j]
            a, b = signals[i][both] / gains[i], signals[j][both] / gains[j]
            if a.size < 256 or not (b.sum() > 0 and a.sum() > 0):
                continue
            # Light counts where there is some: a dark surround holds nothing but offset.
            bright = b >= np.quantile(b, 0.5)
            pairs[i, j] = float(a[bright].sum() / b[bright].sum())
            pairs[j, i] = 1 / pairs[i, j]
            light = np.maximum(b, 0.0)
            variance = sum((floor + electrons * light * gain) / gain**2 for gain in (gains[i], gains[j]))
            off = np.abs(a - pairs[i, j] * b) > MOVED_SIGMAS * np.sqrt(variance)
            moved = max(moved, float(off.mean()))
    ratios = []
    for row in pairs:
        known = row[np.isfinite(row) & (row > 0)]
        ratios.append(float(known[np.abs(np.log(known)).argmin()]) if known.size else float("nan"))
    warnings = [
        f"frame {number} is {ratio:.3f} times as bright as its exposure time says (tolerance {MAX_DISAGREEMENT:.0%}); "
        "check the times and the dark frame, and whether the lamp is steady"
        for number, ratio in enumerate(ratios, 1)
        if abs(ratio - 1) > MAX_DISAGREEMENT
    ]
    if any(np.isnan(ratio) for ratio in ratios):
        warnings.append("two frames share too few usable pixels to be compared; choose exposure times closer together")
    if moved > MAX_MOVED:
        warnings.append(
            f"two frames differ in {moved:.1%} of their pixels by more than noise (limit {MAX_MOVED:.0%}); "
            "did plate or camera move between them?"
        )
    return tuple(ratios), tuple(warnings)
