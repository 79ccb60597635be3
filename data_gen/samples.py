"""Samples of the supplement's two data sets, simulated, and of plates on benches.

A sample depends on the configuration (but for the number of samples) and on its
number: strokes, perturbation and each photon set have a key of their own, so that
a noisy image never shares photons with a clean one.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch

from data_gen.benches.bench_set import Benches
from data_gen.dataset_config import DatasetConfig, PhotonConfig, sample_generator, sample_seed
from data_gen.making import made_strokes
from data_gen.patterns import draw_strokes, padded, perturb_strokes
from data_gen.reliefs import made_print, print_strokes, traits_of
from data_gen.sampler import Field, SampleBatch, Sampler
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene
from warp_caustics.simulator import CausticSimulator
from warp_caustics.thinned import ThinnedSimulator

Denoiser = Callable[[torch.Tensor], torch.Tensor]
"""Noisy images [B, n_w, m, m] to denoised ones."""

MAX_BATCH_PIXELS = {"cpu": 2**23, "cuda": 2**26}
"""Image pixels simulated at a time where photons are shared by a batch."""


class Reliefs:
    """The reliefs of a data set by sample number, printed on a device.

    Args:
        config: gives pattern, scene, seed and role.
        device: where heights are wanted.
        fingerprint: selects the reliefs; the configuration's own if None.
    """

    def __init__(self, config: DatasetConfig, device: str | torch.device, fingerprint: str | None = None):
        self.config, self.device = config, torch.device(device)
        self.fingerprint = fingerprint or config.sample_fingerprint()

    def true(self, ids: Sequence[int]) -> torch.Tensor:
        """Printed heights [m], shape [len(ids), n, n], float32."""
        return self._printed(self.drawn(ids), ids)

    def perturbed(self, ids: Sequence[int]) -> tuple[torch.Tensor, dict[str, np.ndarray[Any, Any]]]:
        """Heights of the perturbed strokes [m], shape [len(ids), n, n], and how many strokes were clamped."""
        drawn = [self.perturbed_strokes(*pair) for pair in zip(self.drawn(ids), ids, strict=True)]
        names = drawn[0][1] if drawn else {}
        counters = {name: np.array([count[name] for _, count in drawn], dtype=np.float64) for name in names}
        return self._printed([strokes for strokes, _ in drawn], ids), counters

    def strokes(self, sample: int) -> np.ndarray[Any, Any]:
        """What is printed for a sample, drawn on the CPU."""
        return self.drawn([sample])[0]

    def drawn(self, ids: Sequence[int]) -> list[np.ndarray[Any, Any]]:
        """What is printed for samples, drawn on the CPU."""
        pattern = self.config.reliefs
        strokes = [draw_strokes(pattern, sample_generator(self.fingerprint, "relief", sample)) for sample in ids]
        if pattern.making is None:
            return strokes
        made = [made_print(self.config, self.fingerprint, sample) for sample in ids]
        generators = [sample_generator(self.fingerprint, "making", sample) for sample in ids]
        return made_strokes(strokes, pattern.making, [each for each in made if each is not None], generators)

    def records(self, ids: Sequence[int]) -> dict[str, np.ndarray[Any, Any]]:
        """How samples are made, a number each by name, for their manifests; nothing where the pattern has no making."""
        made = [made_print(self.config, self.fingerprint, sample) for sample in ids]
        records = [each.record() for each in made if each is not None]
        return {name: np.array([record[name] for record in records]) for name in (records[0] if records else {})}

    def perturbed_strokes(
        self, strokes: np.ndarray[Any, Any], sample: int
    ) -> tuple[np.ndarray[Any, Any], dict[str, int]]:
        """A sample's strokes perturbed, and how many were clamped."""
        return perturb_strokes(strokes, self.config.reliefs, sample_generator(self.fingerprint, "perturbation", sample))

    def traits(self, ids: Sequence[int]) -> torch.Tensor:
        """How the samples are printed, on the CPU; see :func:`data_gen.reliefs.traits_of`."""
        return traits_of(self.config, self.fingerprint, ids)

    def printed(self, strokes: torch.Tensor, traits: torch.Tensor) -> torch.Tensor:
        """Heights [m], shape [B, n, n], of strokes padded to the same number."""
        on_device = strokes.to(self.device, non_blocking=True)
        return print_strokes(on_device, self.config.scene, self.config.reliefs, traits)

    def _printed(self, strokes: list[np.ndarray[Any, Any]], ids: Sequence[int]) -> torch.Tensor:
        return self.printed(torch.from_numpy(padded(strokes)), self.traits(ids))


def simulator_of(
    scene: Scene, photons: PhotonConfig, device: str | torch.device
) -> CausticSimulator | ThinnedSimulator:
    """The simulator of that configuration.

    Raises:
        InputError: a value that does not suit the scene.
        ResourceError: the device is not there.
    """
    if photons.traced is None:
        return CausticSimulator(scene, device=device, **photons.record())
    kept = photons.model_dump(include={"n_photons", "smoothing"})
    return ThinnedSimulator(scene, traced=photons.traced, device=device, **kept)


class Images:
    """Simulated images of one kind (``"noisy"`` or ``"clean"``), each from its own photons unless they are a lattice.

    Args:
        scene: the set-up.
        photons: how to simulate.
        fingerprint: of the data set, for the photons' keys.
        purpose: distinguishes photon sets of one sample.
        device: where to simulate.
        is_shared: reliefs that are asked for together get the same photons, those of the first, in one launch; for
            samples that nobody asks for one by one.
    """

    def __init__(
        self,
        scene: Scene,
        photons: PhotonConfig,
        fingerprint: str,
        purpose: str,
        device: str | torch.device,
        *,
        is_shared: bool = False,
    ):
        self.fingerprint, self.purpose = fingerprint, purpose
        self.simulator = simulator_of(scene, photons, device)
        is_lattice = isinstance(self.simulator, CausticSimulator) and self.simulator.plan.placement == "lattice"
        self.is_random = not is_lattice
        limit = MAX_BATCH_PIXELS[self.simulator.device.type] // (scene.n_wavelengths * scene.image_pixels**2)
        self.batch = max(1, limit) if is_lattice or is_shared else 1

    def __call__(self, heights: torch.Tensor, ids: Sequence[int]) -> torch.Tensor:
        """Irradiance [W/m^2], shape [B, n_w, m, m], of heights [B, n, n] [m]."""
        with torch.no_grad():
            return torch.cat([self._simulated(part, heights[part], ids) for part in self._parts(len(ids))])

    def with_gradient(
        self, heights: torch.Tensor, target: torch.Tensor, ids: Sequence[int], denoiser: Denoiser | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Images, and the gradient of the data term with respect to the heights.

        The data term of one relief is E = 1/2 sum_w mean_pixels (D(S(h)) - I)^2; a denoiser D counts as the
        identity in its derivative, because noise does not depend on the heights.

        Args:
            heights: [m], shape [B, n, n].
            target: I [W/m^2], shape [B, n_w, m, m].
            ids: sample numbers.
            denoiser: D; none if None.

        Returns:
            D(S(h)) [W/m^2], shape of target, and dE/dh [W^2/m^5], shape of heights.
        """
        return self.with_gradients(heights, target, ids, (denoiser,))[0]

    def with_gradients(
        self, heights: torch.Tensor, target: torch.Tensor, ids: Sequence[int], denoisers: Sequence[Denoiser | None]
    ) -> list[tuple[torch.Tensor, torch.Tensor]]:
        """:meth:`with_gradient` for several denoisers, simulated once; a pair for each of them."""
        found: list[list[tuple[torch.Tensor, torch.Tensor]]] = [[] for _ in denoisers]
        pixels = target.shape[-1] * target.shape[-2]
        for part in self._parts(len(ids)):
            leaf = heights[part].detach().clone().requires_grad_()
            # A caller that fills a pool has gradients switched off.
            with torch.enable_grad():
                simulated = self._simulated(part, leaf, ids)
            for denoiser, pairs in zip(denoisers, found, strict=True):
                with torch.no_grad():
                    shown = denoiser(simulated.detach()) if denoiser else simulated.detach()
                    residual = (shown - target[part]) / pixels
                is_last = pairs is found[-1]
                (gradient,) = torch.autograd.grad(simulated, leaf, residual, retain_graph=not is_last)
                pairs.append((shown, gradient))
        return [(torch.cat([a for a, _ in pairs]), torch.cat([b for _, b in pairs])) for pairs in found]

    def _parts(self, count: int) -> list[slice]:
        return [slice(first, min(first + self.batch, count)) for first in range(0, count, self.batch)]

    def _simulated(self, part: slice, heights: torch.Tensor, ids: Sequence[int]) -> torch.Tensor:
        if self.is_random:
            self.simulator.reseed(sample_seed(self.fingerprint, f"photons/{self.purpose}", ids[part.start]))
        return self.simulator(heights)


def _image_field(scene: Scene, name: str, description: str) -> Field:
    shape = (scene.n_wavelengths, scene.image_pixels, scene.image_pixels)
    return Field(name, shape, "float16", "W/m^2", description)


def _height_field(scene: Scene, name: str, unit: str, description: str) -> Field:
    return Field(name, (scene.height_samples, scene.height_samples), "float32", unit, description)


class DenoiserSampler:
    """Pairs of a noisy and a clean image of the same relief (section 2.1)."""

    def __init__(self, config: DatasetConfig, device: str | torch.device):
        self.config = config
        self.reliefs = Reliefs(config, device)
        images = partial(Images, config.scene, fingerprint=self.reliefs.fingerprint, device=device)
        self.noisy = images(config.noisy, purpose="noisy")
        self.clean = images(config.clean, purpose="clean")

    @property
    def fields(self) -> tuple[Field, ...]:
        scene = self.config.scene
        return (
            _image_field(scene, "noisy", "irradiance from few photons, the denoiser's input"),
            _image_field(scene, "clean", "irradiance from many photons, the denoiser's target"),
        )

    def draw(self, ids: Sequence[int]) -> SampleBatch:
        heights = self.reliefs.true(ids)
        arrays = {"noisy": self.noisy(heights, ids), "clean": self.clean(heights, ids)}
        records = {**self.reliefs.records(ids), **_light_counters(arrays["clean"], self.config.scene)}
        return SampleBatch(tuple(ids), _stored(arrays, self.fields), records)


class UpdaterSampler:
    """True and perturbed relief, target and simulated image, gradient of the data term (section 2.2).

    Args:
        config: the data set.
        device: where to simulate.
        denoiser: applied to simulated images; its content hash must be ``config.denoiser``.
        shares_photons: samples drawn together share their random photons, see :class:`Images`.

    Raises:
        InputError: a denoiser without its hash, or the other way round.
    """

    def __init__(
        self,
        config: DatasetConfig,
        device: str | torch.device,
        denoiser: Denoiser | None = None,
        *,
        shares_photons: bool = False,
    ):
        if (denoiser is None) != (config.denoiser is None):
            raise InputError("denoiser and its content hash in the configuration go together; give both or neither")
        self.config, self.denoiser = config, denoiser
        self.reliefs = Reliefs(config, device)
        images = partial(Images, config.scene, fingerprint=self.reliefs.fingerprint, device=device)
        self.simulated = images(config.noisy, purpose="noisy", is_shared=shares_photons)
        self.target = images(config.clean, purpose="clean")

    @property
    def fields(self) -> tuple[Field, ...]:
        scene = self.config.scene
        what = "denoised irradiance" if self.config.denoiser else "irradiance"
        return (
            _height_field(scene, "heights", "m", "printed relief above the base"),
            _height_field(scene, "start", "m", "relief of the perturbed strokes, where the updater starts"),
            _image_field(scene, "target", "irradiance of the printed relief"),
            _image_field(scene, "simulated", f"{what} of the perturbed relief"),
            _height_field(scene, "gradient", "W^2/m^5", "of 1/2 sum_w mean_pixels (simulated - target)^2 at start"),
        )

    def draw_tensors(self, ids: Sequence[int]) -> tuple[dict[str, torch.Tensor], dict[str, np.ndarray[Any, Any]]]:
        """Samples as float32 tensors on the device, and their counters: what training on fresh samples takes."""
        heights = self.reliefs.true(ids)
        start, counters = self.reliefs.perturbed(ids)
        return self.at(heights, start, self.target(heights, ids), ids), counters

    def at(
        self, heights: torch.Tensor, start: torch.Tensor, target: torch.Tensor, ids: Sequence[int]
    ) -> dict[str, torch.Tensor]:
        """Samples of given reliefs, starts [m], shape [B, n, n], and targets [W/m^2]; photons by their numbers."""
        simulated, gradient = self.simulated.with_gradient(start, target, ids, self.denoiser)
        return {"heights": heights, "start": start, "target": target, "simulated": simulated, "gradient": gradient}

    def draw(self, ids: Sequence[int]) -> SampleBatch:
        tensors, counters = self.draw_tensors(ids)
        light = _light_counters(tensors["target"], self.config.scene)
        return SampleBatch(
            tuple(ids), _stored(tensors, self.fields), {**counters, **self.reliefs.records(ids), **light}
        )


class BenchReliefs:
    """Reliefs of a data set whose samples are of several kinds of prints.

    Args:
        benches: of the data set; they say which sample is of which kind.
    """

    def __init__(self, benches: Benches):
        self.benches = benches
        self.kinds = [Reliefs(kind, benches.device, benches.fingerprint) for kind in benches.kinds.datasets]

    def true(self, ids: Sequence[int]) -> torch.Tensor:
        """Printed heights [m], shape [len(ids), n, n], float32."""
        n = self.benches.config.scene.height_samples
        heights = torch.empty(len(ids), n, n, device=self.benches.device)
        numbers = [self.benches.kinds.number(sample) for sample in ids]
        for number, reliefs in enumerate(self.kinds):
            rows = [row for row, kind in enumerate(numbers) if kind == number]
            if rows:
                heights[torch.tensor(rows, device=heights.device)] = reliefs.true([ids[row] for row in rows])
        return heights


class CaptureSampler:
    """Reliefs and photos of them, each on a bench of its own."""

    def __init__(self, config: DatasetConfig, device: str | torch.device):
        self.config = config
        self.benches = Benches(config, device=device)
        self.reliefs = BenchReliefs(self.benches)

    @property
    def fields(self) -> tuple[Field, ...]:
        scene, columns = self.config.scene, self.benches.columns
        return (
            _height_field(scene, "heights", "m", "printed relief above the base"),
            _image_field(scene, "image", "photo as irradiance, on the sample's bench"),
            Field("bench", (len(columns),), "float64", "", "the sample's bench: one number a column", columns),
        )

    def draw(self, ids: Sequence[int]) -> SampleBatch:
        heights, benches = self.reliefs.true(ids), self.benches.draw(ids)
        images = self.benches.images(heights, benches)
        arrays = _stored({"heights": heights, "image": images}, self.fields[:2])
        return SampleBatch(tuple(ids), {**arrays, "bench": benches.values})


def make_sampler(config: DatasetConfig, device: str, denoiser: Denoiser | None = None) -> Sampler:
    """The sampler of a data set; with the denoiser filled in, a factory for the builder."""
    if config.kind == "denoiser":
        return DenoiserSampler(config, device)
    if config.kind == "capture":
        return CaptureSampler(config, device)
    return UpdaterSampler(config, device, denoiser)


def _stored(arrays: dict[str, torch.Tensor], fields: Sequence[Field]) -> dict[str, np.ndarray[Any, Any]]:
    """Arrays in the fields' types; a value beyond float16 becomes infinite, and storage refuses that."""
    types = {"float16": torch.float16, "float32": torch.float32}
    return {field.name: arrays[field.name].to(types[field.dtype]).cpu().numpy() for field in fields}


def _light_counters(images: torch.Tensor, scene: Scene) -> dict[str, np.ndarray[Any, Any]]:
    """Share of the light that misses the image, mean over wavelengths."""
    flat = torch.tensor(scene.radiosity_W_m2, dtype=torch.float64, device=images.device)
    landed = images.double().mean(dim=(2, 3)).sum(dim=1) / flat.sum()
    return {"lost_light": (1 - landed).cpu().numpy()}
