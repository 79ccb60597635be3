"""The point spread of a camera, told by a relief that is right but for micrometres.

By least squares over pixels: each channel's picture is linear in its weights, and the lens before them is looked for
along a line. Where a relief is still wrong, lines that lie beside their place look blurred to that; so spectra tell a
blur first (:mod:`~warp_caustics.reconstruct.seen_camera.blur_estimate`), and this is asked of what leaves little.

Halos are wide and faint, and noise that neighbouring pixels share looks like them: 2 % of speckle moves them by 0.8 %
and stray light by 0.3. How well they are told is seen from strips of the image that are left out in turn (the
jackknife, Tukey 1958), for which no noise has to be known; halos that are not told are none.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from warp_caustics.reconstruct.objective import Measurement
from warp_caustics.reconstruct.seen_camera.channel_camera import ChannelCamera
from warp_caustics.reconstruct.seen_camera.pixel_means import PLACED, Lay, pixel_means
from warp_caustics.reconstruct.seen_camera.point_spread import HALOS_PX, REACH, PointSpread, in_halos
from warp_caustics.types import FloatArray

WIDTH = 0.05
"""Residual, relative to the radiosity, from which on a pixel counts less, as in descents of lines."""
LENSES, NEAR = (0.6, 0.8, 0.95, 1.1), (0.94, 1.0, 1.06)
"""That are tried, in units of the blur so far, and of a lens that is nearly right: a wider one would be sharpened."""
LEAST_BLUR_PX = 0.3
"""For that; narrower blurs are not told by spectra."""
LEAST_LENS_PX = 0.05
SIMPLER = 0.99
"""By which squares must fall for another form than the one before."""
LEAST_SEEN = 0.5
"""Of a channel's pixels that must count for it to be asked."""
WEIGHT_WIDTH = 0.1
"""Standard deviation of what is believed of a weight, beside 1 in the middle and 0 elsewhere."""
HALO_WIDTH = 0.03
"""The same of a halo."""
EVEN = 1e-9
"""Of what a picture says of its brightness, what is believed of that before."""
STRIPS = 32
"""Of an image, that are left out in turn to see how well halos are told; and for the memory's sake."""
TOLD = 5.0
"""Squares of deviations, in the mean of all halos and the median of channels, from which on an image tells them. Of
nothing, in 2 to 5 % of speckle, they have at most 3; 10 where they are 2 and 1 % of the light in 2 % of speckle, and 12
where they are 1 % and none in shot noise alone."""

_PAIRS = (2 * REACH + 1) ** 2 // 2
"""Of weights in opposite directions."""


class _Fit(NamedTuple):
    """Weights after a lens and a band."""

    lens_px: float
    band_px: float
    weights: FloatArray
    halos: FloatArray
    left: float = 0.0
    """Weighted sum of squares."""


class _Halos(NamedTuple):
    """What an image tells of a channel's halos."""

    squares: float
    """All of them, in squares of deviations."""
    share: float
    """Of the light, that lies in them."""
    stray: float
    """Standard deviation of stray light beside them."""


def found_spread(
    measurement: Measurement, fine: torch.Tensor, camera: ChannelCamera, lays: Sequence[Lay] | None = None
) -> PointSpread:
    """The point spread with which light on fine pixels explains an image best, channel by channel.

    Args:
        measurement: the image with its channels together, in units of the radiosity, all pixels.
        fine: light of the relief on fine pixels, in the same units, shape [n_w, k m, k m].
        camera: so far; channels of which too little is seen keep its blur.
        lays: where channels' pictures of this light lay on the pixels; None: where they belong.
    """
    known = camera.shown_by
    fits, form, form_blur, asked = dict[int, _Fit](), None, 0.0, list[tuple[int, _Search]]()
    middle = len(fine) // 2
    for channel in sorted(range(len(fine)), key=lambda c: abs(c - middle)):
        blur, before = float(camera.blur[channel]), _of(known, channel)
        measured, counts = measurement.irradiance[channel], measurement.weight[channel]
        if float(counts.mean()) < LEAST_SEEN:
            fits[channel] = before
            continue
        search = _Search(fine[channel], measured, counts, blur, PLACED if lays is None else lays[channel])
        if form is None:
            form, form_blur = search.form(before.lens_px, before.band_px), max(blur, LEAST_BLUR_PX)
        # One lens blurs all wavelengths in the same way, if not by as much.
        wider = max(blur, LEAST_BLUR_PX) / form_blur
        fits[channel] = search.about(wider * form[0], blur if form[1] else 0.0)
        asked.append((channel, search))
    told = [search.told_halos(fits[channel]) for channel, search in asked]
    # One glass scatters all wavelengths: what one channel leaves open others may tell. And what takes light from around
    # bright lines is no halo, but stray light of another bench, or heights.
    if (
        told
        and np.median([each.squares for each in told]) > TOLD * len(HALOS_PX)
        and np.median([each.share for each in told]) > 0
    ):
        for channel, search in asked:
            search.has_halos = True
            fits[channel] = search.about(fits[channel].lens_px, fits[channel].band_px)
    lens, band, weights, halos, _ = zip(*(fits[channel] for channel in range(len(fine))), strict=True)
    stray = float(np.sqrt(np.mean([each.stray**2 for each in told]) / len(told))) if told else 0.0
    return PointSpread(np.array(lens), np.array(band), np.stack(weights), np.stack(halos), stray)


def _of(spread: PointSpread, channel: int) -> _Fit:
    widths = float(spread.lens_px[channel]), float(spread.band_px[channel])
    return _Fit(*widths, spread.weights[channel], spread.halos[channel])


def _left(fit: _Fit) -> float:
    return fit.left


class _Search:
    """Of one channel, all of shape [m, m] but the light, [k m, k m]."""

    def __init__(self, light: torch.Tensor, measured: torch.Tensor, counts: torch.Tensor, blur_px: float, lay: Lay):
        self.light, self.measured, self.blur_px, self.lay = light, measured, blur_px, lay
        shown = pixel_means(light, measured.shape[-1], 0.0, blur_px, lay)
        self.counts = counts.clone()
        # What light the mirrored border lacks is not in the model.
        for edge in (slice(0, REACH), slice(-REACH, None)):
            self.counts[edge] = 0
            self.counts[:, edge] = 0
        self.weight = self._weight(shown)
        self.has_halos = False

    def form(self, lens_px: float, band_px: float) -> tuple[float, float]:
        """Lens and band: those before, or where it leaves clearly less another one: weights alone, a band, a lens."""
        simple = self.fit(lens_px, band_px)
        others = [self.fit(0.0, 0.0), self._lens(max(self.blur_px, LEAST_BLUR_PX), LENSES)]
        if (lens_px, band_px) != (0.0, self.blur_px):
            others.append(self.fit(0.0, self.blur_px))
        nearest = min(others, key=_left)
        best = nearest if nearest.left < SIMPLER * simple.left else simple
        return best.lens_px, best.band_px

    def about(self, lens_px: float, band_px: float) -> _Fit:
        """The best with a lens and a band that are nearly right."""
        # Of what the better form leaves, other pixels count less.
        self.weight = self._weight(self._shown(self.fit(lens_px, band_px)))
        return self._lens(lens_px, NEAR) if lens_px else self.fit(lens_px, band_px)

    def _lens(self, about_px: float, tried: tuple[float, ...]) -> _Fit:
        """With the best lens, where a parabola through the nearest three says, too."""
        fits = [self.fit(share * about_px, 0.0) for share in tried]
        best = min(range(len(fits)), key=lambda k: fits[k].left)
        near = fits[max(0, min(best - 1, len(fits) - 3)) :][:3]
        curve = np.polyfit([fit.lens_px for fit in near], [fit.left for fit in near], 2)
        if curve[0] > 0:
            low, high = (0.9 * near[0].lens_px, 1.1 * near[-1].lens_px)
            between = float(np.clip(-curve[1] / (2 * curve[0]), max(low, LEAST_LENS_PX), high))
            fits.append(self.fit(between, 0.0))
        return min(fits, key=_left)

    def fit(self, lens_px: float, band_px: float) -> _Fit:
        """Weights by least squares, with brightness and an even light beside them, which are left out of it."""
        normal = self._normal(lens_px, band_px).sum(0)
        solution, left = self._solved(normal)
        sides, brightness = solution[:_PAIRS], 1.0 + float(solution[-2])
        shares = solution[_PAIRS:-2] / brightness
        weights = np.concatenate((sides, [brightness - 2 * sides.sum()], sides[::-1])) / brightness
        return _Fit(lens_px, band_px, weights.reshape(2 * REACH + 1, 2 * REACH + 1), shares, left)

    def told_halos(self, fit: _Fit) -> _Halos:
        """Of the same lens and band; deviations are those between fits that leave out a strip each."""
        strips = self._normal(fit.lens_px, fit.band_px)
        normal = strips.sum(0)
        found = self._wide(normal)
        without = np.stack([self._wide(normal - strip) for strip in strips])
        spread = without - without.mean(0)
        covariance = (STRIPS - 1) / STRIPS * spread.T @ spread
        halos, of_halos = found[:-1], covariance[:-1, :-1]
        # An even picture has none and tells none.
        squares = halos @ np.linalg.pinv(of_halos, hermitian=True) @ halos
        return _Halos(float(squares), float(halos.sum()), float(np.sqrt(covariance[-1, -1])))

    def _wide(self, normal: torch.Tensor) -> FloatArray:
        """Halos and stray light, as shares of the light, shape [K + 1]."""
        solution, _ = self._solved(normal, has_halos=True)
        wide: FloatArray = np.append(solution[_PAIRS:-2], solution[-1]) / (1.0 + solution[-2])
        return wide

    def _normal(self, lens_px: float, band_px: float) -> torch.Tensor:
        """Normal matrices of the strips, shape [S, P + K + 3, P + K + 3].

        Of P pairs of weights, K halos, brightness and even light, and in the last row and column of what is left.
        """
        shown = pixel_means(self.light, self.measured.shape[-1], lens_px, band_px, self.lay)
        padded = torch.nn.functional.pad(shown[None, None], (REACH,) * 4, mode="replicate")[0, 0]
        side, halos, found = 2 * REACH + 1, in_halos(shown), []
        for rows in np.array_split(np.arange(len(shown)), STRIPS):
            strip = slice(int(rows[0]), int(rows[-1]) + 1)
            near = padded[strip.start : strip.stop + 2 * REACH].unfold(0, side, 1).unfold(1, side, 1)
            moved = near.flatten(2).movedim(-1, 0).flatten(1)
            # Of a picture moved to both sides, what differs from it: little, where it is soft, and exact then.
            columns = torch.cat(
                (
                    moved[:_PAIRS] + moved[_PAIRS + 1 :].flip(0) - 2 * moved[_PAIRS],
                    *(halo[strip].reshape(1, -1) for halo in halos),
                    moved[_PAIRS : _PAIRS + 1],
                    torch.ones_like(moved[:1]),
                    self.measured[strip].reshape(1, -1) - moved[_PAIRS],
                )
            )
            found.append(((columns * self.weight[strip].reshape(1, -1)) @ columns.T).double())
        return torch.stack(found).cpu()

    def _solved(self, normal: torch.Tensor, *, has_halos: bool | None = None) -> tuple[FloatArray, float]:
        """Weights, halos, brightness less 1 and even light; and the weighted sum of squares that is left.

        Args:
            normal: of the whole image, or of most of its strips.
            has_halos: whether there are any; None as this search has it.
        """
        asked = torch.ones(len(normal) - 1, dtype=torch.bool)
        asked[_PAIRS:-2] = self.has_halos if has_halos is None else has_halos
        matrix, right, square = normal[:-1, :-1][asked][:, asked], normal[:-1, -1][asked], normal[-1, -1]
        # Weights of a picture that is soft already could be anything: they are believed to be few.
        believed = torch.full((len(asked),), float(square / self.weight.count_nonzero()), dtype=torch.float64)
        believed[:_PAIRS] /= WEIGHT_WIDTH**2
        believed[_PAIRS:] /= HALO_WIDTH**2
        believed = believed[asked]
        # Of an even picture brightness and even light are one: neither is told, and neither matters.
        believed[-2:] = EVEN * matrix.diagonal()[-2:]
        solution = torch.zeros(len(asked), dtype=torch.float64)
        solution[asked] = torch.linalg.solve(matrix + believed.diag(), right)
        return solution.numpy(), float(square - solution @ normal[:-1, -1])

    def _shown(self, fit: _Fit) -> torch.Tensor:
        widths = np.array([fit.lens_px]), np.array([fit.band_px])
        spread = PointSpread(*widths, fit.weights[None], fit.halos[None])
        return spread(self.light[None], self.measured.shape[-1], [self.lay])[0]

    def _weight(self, shown: torch.Tensor) -> torch.Tensor:
        return self.counts / ((shown - self.measured).square() + WIDTH**2).sqrt()


def equal_blur_px(sharp: torch.Tensor, seen: torch.Tensor) -> FloatArray:
    """Gaussian within the pixels' band that comes nearest to a camera [px], shape [n_w].

    Args:
        sharp: image without it, shape [n_w, m, m].
        seen: image through it, same shape.
    """
    pixels = sharp.shape[-1]
    both = torch.fft.rfft2(torch.stack((sharp, seen)).double()).cpu()
    ky, kx = torch.fft.fftfreq(pixels).double(), torch.fft.rfftfreq(pixels).double()
    square = (2 * np.pi) ** 2 * (ky[:, None] ** 2 + kx**2)
    bins = (square.sqrt() * 64).long().flatten()
    size = int(bins.max()) + 1
    mean = torch.bincount(bins, square.flatten(), size) / torch.bincount(bins, minlength=size).clamp_min(1)
    found = []
    for a, b in zip(both[0], both[1], strict=True):
        own = torch.bincount(bins, a.abs().square().flatten(), size)
        crossed = torch.bincount(bins, (a.conj() * b).real.flatten(), size)
        tried = torch.linspace(0, 4, 801, dtype=torch.float64)
        transfer = torch.exp(-0.5 * tried[:, None] ** 2 * mean)
        left = transfer.square() @ own - 2 * (transfer @ crossed)
        found.append(float(tried[left.argmin()]))
    return np.array(found)
