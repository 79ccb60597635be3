"""The caustic simulator: heights in, irradiance out, differentiable."""

import math
import numbers
from typing import Any, Literal, get_args

import torch
from torch.autograd.function import once_differentiable

from warp_caustics.chunked import CHUNK_BYTES
from warp_caustics.determinism import settle_gpu
from warp_caustics.engine import Engine
from warp_caustics.errors import InputError, ResourceError
from warp_caustics.extremes import Extremes
from warp_caustics.photons import PhotonPlan
from warp_caustics.presets import PRESETS, Preset
from warp_caustics.scene import Placement, Profile, Scene

MAX_SMOOTHING = 1e4

IMAGES_AT_ONCE = 4
"""Images that a call with its gradient holds in memory, about."""

IMAGES_OF_SUMS = 2
"""As many more where light is added in whole numbers, of 64 bits."""


class _Simulate(torch.autograd.Function):
    """Engine.image with Engine.image_adjoint; stores nothing but the heights."""

    @staticmethod
    def forward(ctx: Any, heights: torch.Tensor, engine: Engine, extremes: Extremes | None) -> torch.Tensor:
        ctx.save_for_backward(heights)
        ctx.engine = engine
        return engine.image(heights.detach().contiguous(), extremes)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_image: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        (heights,) = ctx.saved_tensors
        return ctx.engine.image_adjoint(heights.detach().contiguous(), grad_image.contiguous()), None, None


class CausticSimulator:
    """Simulates the caustic of a printed relief.

    Args:
        scene: the optical set-up.
        preset: ``"lattice"`` (deterministic, sharp; the default for reconstruction and
            training) or ``"paper"`` (1e6 independent random photons, s = 16).
        n_photons: number of light paths n_l; the preset's if None. Grids round it,
            see :attr:`n_photons`.
        smoothing: s, scales the photon footprint; the preset's if None.
        seed: selects the photon set; no effect on the lattice.
        device: ``"cpu"``, ``"cuda"``, ``"cuda:1"``; one that is not torch's current GPU after
            :func:`~warp_caustics.device.start_device`, for graphs are recorded there.
        dtype: torch.float32 or torch.float64, of heights and image.
        placement: overrides the preset's: lattice, stratified, sobol or random.
        profile: overrides the preset's footprint profile: gaussian or spline.
        role: photon sets of one seed with different roles are independent.

    Raises:
        InputError: a value out of range.
        ResourceError: the device is not there.
    """

    def __init__(
        self,
        scene: Scene,
        preset: Literal["lattice", "paper"] = "lattice",
        *,
        n_photons: int | None = None,
        smoothing: float | None = None,
        seed: int = 0,
        device: str | torch.device = "cpu",
        dtype: torch.dtype = torch.float32,
        placement: Placement | None = None,
        profile: Profile | None = None,
        role: str = "",
    ):
        if preset not in PRESETS:
            raise InputError(f"preset {preset!r} is not known; use one of {', '.join(PRESETS)}")
        defaults: Preset = PRESETS[preset]
        self.scene = scene
        self.preset = preset
        self.seed = _checked_seed(seed)
        self.smoothing = defaults.smoothing if smoothing is None else _checked_smoothing(smoothing)
        self.device = usable_device(device)
        if dtype not in (torch.float32, torch.float64):
            raise InputError(f"dtype {dtype} is not supported; use torch.float32 or torch.float64")
        self.dtype = dtype
        wished = defaults.photons(scene) if n_photons is None else n_photons
        self.profile = profile or defaults.profile
        if self.profile not in get_args(Profile):
            raise InputError(f"profile {profile!r} is not known; use one of {', '.join(get_args(Profile))}")
        placement = placement or defaults.placement
        self.plan = PhotonPlan(scene, placement, wished, self.seed, role)
        self.engine = Engine(scene, self.plan, self.smoothing, self.profile, self.device, dtype)
        self._extremes = Extremes(self.device, dtype) if self.device.type == "cuda" else None

    @property
    def n_photons(self) -> int:
        """n_l: photons actually traced per wavelength."""
        return self.plan.count

    def __call__(self, heights: torch.Tensor) -> torch.Tensor:
        """Irradiance on the screen.

        Args:
            heights: relief above the base [m], shape [n, n] or [B, n, n], of the
                simulator's dtype and device.

        Returns:
            Irradiance [W/m^2], shape [n_w, m, m] or [B, n_w, m, m]; a pixel is the
            mean over its square. Differentiable with respect to the heights.

        Raises:
            InputError: wrong shape, dtype or device, or heights that are not finite.
            ResourceError: the GPU's memory is too small; says which batch would fit.
        """
        batch = self._shaped(heights)
        extremes = self._extremes
        if extremes is None:
            lowest, highest = torch.stack(torch.aminmax(heights.detach())).tolist()
            self._check_heights(heights, lowest, highest)
        try:
            if torch.is_grad_enabled() and batch.requires_grad:
                image: torch.Tensor = _Simulate.apply(batch, self.engine, extremes)  # type: ignore[no-untyped-call]
            else:
                given = batch.detach() if batch.requires_grad else batch
                image = self.engine.image(given.contiguous(), extremes)
        except torch.OutOfMemoryError as error:
            raise ResourceError(self._memory_advice(len(batch))) from error
        if extremes is not None:
            # A GPU simulates while the host learns what the heights are.
            self._check_heights(heights, *extremes.read())
        return image if heights.ndim == 3 else image[0]

    @property
    def traces_changes(self) -> bool:
        """Whether :meth:`change` takes less than two images do."""
        return self.engine.rows is not None

    @torch.no_grad()
    def change(self, first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
        """Irradiance of reliefs less that of others, from which they differ in places; not differentiable.

        A lattice on a CPU traces only light that a change touches, a tenth of the time of a line that moves a bit; each
        core looks at other reliefs.

        Args:
            first: others [m], shape [B, n, n], or one, [n, n], of the simulator's dtype and device.
            second: reliefs, shape [B, n, n], or one, [n, n].

        Returns:
            Irradiance [W/m^2] of the second less that of the first, shape [n_w, m, m] of two reliefs, else
            [B, n_w, m, m].

        Raises:
            InputError: as of a call; or as many others as reliefs, or one, are not given.
        """
        others, reliefs = self._shaped(first), self._shaped(second)
        if len(others) not in (1, len(reliefs)):
            raise InputError(
                f"{len(reliefs)} reliefs change from {len(others)} others; give as many, or one for all of them"
            )
        for each in (others, reliefs):
            self._check_heights(each, *torch.stack(torch.aminmax(each)).tolist())
        change = self.engine.change(others.contiguous(), reliefs.contiguous())
        return change if first.ndim == 3 or second.ndim == 3 else change[0]

    def reseed(self, seed: int, role: str = "") -> None:
        """Take the photon set of another seed; much cheaper than a new simulator.

        Raises:
            InputError: no seed.
        """
        self.seed = _checked_seed(seed)
        self.engine.reseed(self.seed, role)
        self.plan = self.engine.plan

    def _memory_advice(self, batch: int) -> str:
        """What a batch needs and what would fit: photons come in chunks, so images decide."""
        per_image = self.scene.n_wavelengths * self.scene.image_pixels**2 * self.dtype.itemsize
        free, total = torch.cuda.mem_get_info(self.device)
        # The image, its gradient and a packed copy (four channels); a chunk of photons besides.
        images = IMAGES_AT_ONCE + IMAGES_OF_SUMS * self.engine.fused.is_fixed
        fits = max(1, int((free - CHUNK_BYTES["cuda"]) / (images * per_image)))
        needs = images * batch * per_image
        return (
            f"a batch of {batch} height fields needs about {needs / 2**30:.1f} GiB for images, "
            f"{self.device} has {free / 2**30:.1f} of {total / 2**30:.1f} GiB free; use batches of at most {fits}"
        )

    def settings(self) -> dict[str, Any]:
        """What defines the result, for records and reports."""
        return {
            "preset": self.preset,
            "placement": self.plan.placement,
            "n_photons": self.n_photons,
            "smoothing": self.smoothing,
            "profile": self.profile,
            "seed": self.seed,
            "device": str(self.device),
            "dtype": str(self.dtype).removeprefix("torch."),
        }

    def _shaped(self, heights: torch.Tensor) -> torch.Tensor:
        n, is_tensor = self.scene.height_samples, isinstance(heights, torch.Tensor)
        if is_tensor and heights.shape == (n, n) and heights.dtype == self.dtype and heights.device == self.device:
            return heights[None]  # as a rule, and a GPU waits for what is asked before it begins
        if not is_tensor:
            raise InputError(f"heights are a {type(heights).__name__}; give a torch tensor (torch.from_numpy)")
        if heights.ndim not in (2, 3) or tuple(heights.shape[-2:]) != (n, n) or 0 in heights.shape:
            raise InputError(
                f"heights have shape {list(heights.shape)}, the scene needs [{n}, {n}] or [B, {n}, {n}]; "
                "resample them or set height_samples"
            )
        if heights.dtype != self.dtype:
            raise InputError(f"heights are {heights.dtype}, the simulator {self.dtype}; convert with .to({self.dtype})")
        if heights.device.type != self.device.type:
            raise InputError(f"heights are on {heights.device}, the simulator on {self.device}; move them with .to()")
        # From another GPU to this one: kernels read heights where they are.
        return (heights if heights.ndim == 3 else heights[None]).to(self.device)

    def _check_heights(self, heights: torch.Tensor, lowest: float, highest: float) -> None:
        """Refuse heights that cannot be simulated; of those that are not all numbers the extremes are none."""
        if not (math.isfinite(lowest) and math.isfinite(highest)):
            where = (~torch.isfinite(heights)).nonzero()[0].tolist()
            raise InputError(f"height {heights[tuple(where)].item()} at index {where} is not finite; repair or mask it")
        if lowest <= -self.scene.base_thickness_m:
            raise InputError(
                f"height {lowest:g} m cuts through the plate of {self.scene.base_thickness_m:g} m; "
                "heights are above the base, in metres"
            )


def usable_device(device: str | torch.device) -> torch.device:
    """The torch device of that name.

    Raises:
        InputError: not a device name this package can use.
        ResourceError: the machine has no such device.
    """
    try:
        found = torch.device(device)
    except RuntimeError as error:
        raise InputError(f"device {device!r} is not known; use cpu, cuda or cuda:N") from error
    if found.type not in ("cpu", "cuda"):
        raise InputError(f"device {device!r} is not supported; use cpu, cuda or cuda:N")
    if found.type == "cuda":
        count = torch.cuda.device_count() if torch.cuda.is_available() else 0
        index = found.index or 0
        if index >= count:
            raise ResourceError(f"device {device} is missing, {count} CUDA devices found; use --device cpu")
        found = torch.device("cuda", index)
        settle_gpu()
    return found


def _checked_smoothing(smoothing: float) -> float:
    if not isinstance(smoothing, numbers.Real) or not 0 <= float(smoothing) <= MAX_SMOOTHING:
        raise InputError(f"smoothing {smoothing!r} is not between 0 and {MAX_SMOOTHING:g}; the paper uses 16")
    return float(smoothing)


def _checked_seed(seed: int) -> int:
    if isinstance(seed, bool) or not isinstance(seed, numbers.Integral) or not 0 <= int(seed) < 2**63:
        raise InputError(f"seed {seed!r} is not a whole number between 0 and 2^63 - 1")
    return int(seed)
