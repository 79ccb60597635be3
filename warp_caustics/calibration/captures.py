"""Captures of known plates on one bench as a problem of least squares, at one size of pixels."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch

from warp_caustics.calibration.coordinates import Coordinates
from warp_caustics.calibration.least_squares import Normal, huber
from warp_caustics.calibration.noise_model import first_variance, fitted_variance, terms
from warp_caustics.calibration.view import View, as_tensors, enlarged_camera, enlarged_scene
from warp_caustics.calibration.view_model import ViewModel
from warp_caustics.setup.set_up import SetUp

MEDIAN_SQUARE = 0.4549
"""Of a standard normal number."""
OVERSAMPLING = 3
"""Simulated pixels along the side of one that is looked at: a picture moved by parts of a pixel before it is blurred
needs
finer ones. With two a shift with 1 % noise came out 0.07 pixels beside its place, made up for by a tilt of 17 mrad,
at four
times their deviation; four and six change nothing more."""
BLOCKS = 16
"""Along each side, for the scatter of what different parts of an image say."""
LEAST_BLOCK_PX = 4


class Own(NamedTuple):
    """Where a view's own numbers stand in the vector of all.

    Attributes:
        brightness: of its channels.
        plate: numbers of its plate.
    """

    brightness: slice
    plate: slice


class Looked(NamedTuple):
    """A view at one x.

    Attributes:
        model: what it should show [W/m^2], shape [C, m, m].
        residual: model less image, in standard deviations, shape [C, m, m]; 0 where pixels do not count.
        columns: derivatives of the residual by x, shape [P, C, m, m].
    """

    model: torch.Tensor
    residual: torch.Tensor
    columns: torch.Tensor


class Captures:
    """Views of known plates in pixels ``factor`` times as large as theirs.

    Args:
        setup: the bench in the views' own pixels.
        views: of known plates.
        own: where their own numbers stand.
        coordinates: of all numbers: the set-up's first.
        factor: by how much pixels are larger.
        blur_px: Gaussian that image and model are looked at through [large px]; 0 is none.
        border_px: small pixels on all sides that do not count.
        photons: light paths along each side, at least; footprints should be small against pixels and relief.
        oversampling: simulated pixels along the side of one that is looked at.
        device: where to simulate.
    """

    def __init__(
        self,
        setup: SetUp,
        views: Sequence[View],
        own: Sequence[Own],
        coordinates: Coordinates,
        factor: int,
        *,
        blur_px: float = 0.0,
        border_px: int = 8,
        photons: int = 256,
        oversampling: int = OVERSAMPLING,
        device: str | torch.device = "cpu",
    ):
        self.setup, self.views, self.own, self.coordinates = setup, tuple(views), tuple(own), coordinates
        self.factor, self.blur_px = factor, blur_px
        assert setup.camera_config is not None
        # Simulated pixels are finer than those that are looked at.
        fine = factor / oversampling
        scene = enlarged_scene(setup.nominal_scene, fine)
        ranges = {p.name: (p.low / fine, p.high / fine) for p in setup.parameters if p.unit == "px"}
        ranges |= {p.name: (p.low, p.high) for p in setup.parameters if p.unit != "px"}
        small = SetUp.of(
            scene,
            enlarged_camera(setup.camera_config, fine),
            setup.names,
            ranges=ranges,
            priors={p.name: p.prior / (fine if p.unit == "px" else 1) for p in setup.parameters},
        )
        self._scale = torch.tensor([1 / fine if p.unit == "px" else 1.0 for p in setup.parameters], dtype=torch.float64)
        powers = torch.tensor([2.0 if p.is_squared else 1.0 for p in setup.parameters], dtype=torch.float64)
        self._column_scale = self._scale**powers
        side = max(photons, scene.height_samples)
        self.models = []
        for view in self.views:
            heights, modes = view.plate.surface(scene)
            self.models.append(
                ViewModel(small, heights, modes, view.is_divided, device, oversampling, n_photons=side**2)
            )
        large = [view.binned(factor) for view in self.views]
        border = -(-border_px // factor)
        at = torch.device(device)
        self.images, self.counts = zip(*(as_tensors(view, border, at) for view in large), strict=True)
        self.noise = [torch.as_tensor(view.noise, dtype=torch.float64, device=at) for view in large]
        self._level = torch.tensor(scene.radiosity_W_m2, dtype=torch.float64, device=at).clamp_min(1e-30)
        self.variance: list[torch.Tensor] = []

    @property
    def pixels(self) -> int:
        """Large pixels per side."""
        return int(self.images[0].shape[-1])

    # ------------------------------------------------------------------ noise

    def start_noise(self, x: torch.Tensor) -> None:
        """Noise before residuals are understood: as large as they are."""
        self.variance = []
        for k in range(len(self.views)):
            model = self._bright(k, x, self._image(k, x))
            variance = first_variance(terms(model, self.noise[k], self._level))
            square = ((model - self.images[k]) ** 2 / variance)[self.counts[k]]
            self.variance.append(variance * max(1.0, float(square.median()) / MEDIAN_SQUARE))

    def fit_noise(self, x: torch.Tensor) -> None:
        """Noise that explains the residuals at x."""
        self.variance = []
        for k in range(len(self.views)):
            model = self._bright(k, x, self._image(k, x))
            parts = terms(model, self.noise[k], self._level)
            self.variance.append(fitted_variance(parts, model - self.images[k], self.counts[k]))

    # ------------------------------------------------------------------ the problem

    def cost(self, x: torch.Tensor) -> float:
        """Sum of rho over all pixels."""
        return sum(float(huber(self._residual(k, self._bright(k, x, self._image(k, x))))[0].sum()) for k in self._all())

    def normal(self, x: torch.Tensor) -> Normal:
        """The same with derivatives by x."""
        cost = 0.0
        information = torch.zeros(len(x), len(x), dtype=torch.float64)
        gradient = torch.zeros(len(x), dtype=torch.float64)
        for looked in self.looked(x):
            rho, weight = huber(looked.residual)
            cost += float(rho.sum())
            flat = looked.columns.flatten(1)
            weighted = flat * weight.flatten()
            information += (weighted @ flat.T).cpu()
            gradient += (weighted @ looked.residual.flatten()).cpu()
        return Normal(cost, information, gradient)

    def scores(self, x: torch.Tensor) -> torch.Tensor:
        """What each block of each image says, gradients by x, shape [blocks, P]; all channels of a block together."""
        found = []
        for looked in self.looked(x):
            _, weight = huber(looked.residual)
            pulls = (looked.columns * (weight * looked.residual)).sum(1)
            m = pulls.shape[-1]
            size = max(LEAST_BLOCK_PX, m // BLOCKS)
            kept = m // size * size
            blocks = pulls[:, :kept, :kept].reshape(len(x), kept // size, size, kept // size, size).sum((2, 4))
            found.append(blocks.flatten(1).T.cpu())
        return torch.cat(found)

    def pull(self, x: torch.Tensor, others: Sequence[torch.Tensor]) -> torch.Tensor:
        """Gradient by x if the model showed something else, less that of what it shows, shape [P].

        Args:
            x: where.
            others: of another simulation, shape [C, m, m] each.
        """
        total = torch.zeros(len(x), dtype=torch.float64)
        for k, looked in enumerate(self.looked(x)):
            _, weight = huber(looked.residual)
            change = self._residual(k, others[k]) - looked.residual
            total += (looked.columns.flatten(1) @ (weight * change).flatten()).cpu()
        return total

    def looked(self, x: torch.Tensor) -> Iterator[Looked]:
        """Each view with its derivatives."""
        widths = self.coordinates.widths
        theta = self._theta(x)
        count = len(theta)
        for k, own in enumerate(self.own):
            values = self.coordinates.values(x)
            image, by_setup, by_plate = self.models[k].derivatives(theta, values[own.plate])
            model = self._bright(k, x, image)
            columns = torch.zeros(len(x), *image.shape, dtype=torch.float64, device=image.device)
            bright = values[own.brightness].to(image.device)[:, None, None]
            columns[:count] = by_setup * (self._column_scale * widths[:count]).to(image.device)[:, None, None, None]
            columns[own.plate] = by_plate * widths[own.plate].to(image.device)[:, None, None, None]
            columns *= bright
            for channel, number in enumerate(range(own.brightness.start, own.brightness.stop)):
                columns[number, channel] = image[channel] * float(widths[number])
            sigma = self.variance[k].sqrt()
            columns = self._smooth(torch.where(self.counts[k], columns / sigma, 0.0))
            yield Looked(model, self._residual(k, model), columns)

    def models_at(self, x: torch.Tensor) -> list[torch.Tensor]:
        """What each view should show [W/m^2], shape [C, m, m] each."""
        return [self._bright(k, x, self._image(k, x)) for k in self._all()]

    def _all(self) -> range:
        return range(len(self.views))

    def _theta(self, x: torch.Tensor) -> torch.Tensor:
        values = self.coordinates.values(x)[: len(self.setup.parameters)]
        return values * self._scale

    def _image(self, k: int, x: torch.Tensor) -> torch.Tensor:
        return self.models[k].image(self._theta(x), self.coordinates.values(x)[self.own[k].plate])

    def _bright(self, k: int, x: torch.Tensor, image: torch.Tensor) -> torch.Tensor:
        return image * self.coordinates.values(x)[self.own[k].brightness].to(image.device)[:, None, None]

    def _residual(self, k: int, model: torch.Tensor) -> torch.Tensor:
        off = (model - self.images[k]) / self.variance[k].sqrt()
        return self._smooth(torch.where(self.counts[k], off, 0.0))

    def _smooth(self, images: torch.Tensor) -> torch.Tensor:
        if not self.blur_px:
            return images
        m = images.shape[-1]
        k = 2 * torch.pi * torch.fft.fftfreq(m, dtype=images.dtype, device=images.device)
        along = torch.exp(-((self.blur_px * k) ** 2) / 2)
        result: torch.Tensor = torch.fft.irfft2(
            torch.fft.rfft2(images) * along[:, None] * along[: m // 2 + 1], s=images.shape[-2:]
        )
        return result
