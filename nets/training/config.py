"""What a training run is: its configuration, complete and checked, and its defaults by kind."""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from data_gen.bench_ranges import BenchRanges, CameraRanges
from data_gen.config import PatternConfig, ReliefConfig
from data_gen.dataset_config import PAPER_CLEAN, PAPER_NOISY, PhotonConfig
from data_gen.variety import PrintVariety
from nets.architecture import PRESETS, Architecture
from nets.told import told_count
from nets.training.feedback_config import FeedbackConfig
from nets.training.picture_config import PictureConfig
from nets.training.told_config import ToldConfig
from nets.unrolling_config import PhotonVariant, Share, UnrollingConfig
from warp_caustics.errors import InputError, known_names
from warp_caustics.scene import Scene
from warp_caustics.strict import Finite, Strict

TrainingKind = Literal["denoiser", "updater", "direct", "unrolled"]
Precision = Literal["32", "bf16", "16"]

VALIDATION_SEED = 5_871_781_006_564_002_453
"""Of the fixed validation reliefs: the same for all runs, so that they compare."""

Count = Annotated[int, Field(ge=1, le=10**9)]
Weight = Annotated[Finite, Field(ge=0, le=1e6)]
Seconds = Annotated[Finite, Field(gt=0, le=1e8)]


LATTICE = PhotonVariant()
VARIANTS = (
    PhotonVariant(photons_per_pixel=1.5, share=0.45),
    PhotonVariant(photons_per_pixel=4.0, share=0.45),
    # s = 5: a flat plate has 4.5 % noise; s of the lattice would give 8 %.
    PhotonVariant(placement="stratified", photons_per_pixel=8.0, smoothing=5.0, share=0.1),
)
"""About 4e5 and 1e6 photons at Tab. 1's 512 x 512 pixels, and now and then photons that are no lattice."""


class AugmentationConfig(Strict):
    """Changes of a training sample, drawn anew for every sample in every step."""

    symmetries: bool = True
    """One of the square's symmetries that the scene has, applied to plate and image together."""


LARGEST_BLUR_PX = 2.5
"""That a camera of the training may have."""


class CameraConfig(Strict):
    """How far cameras are from perfect; each visit of a sample draws one, see ``camera.py``. 0 leaves an effect out."""

    clean_share: Share = 1 / 3
    """Of the visits see an image that is nearly clean: no more than exposure and ``clean_noise``."""
    shift_px: Annotated[Finite, Field(ge=0, le=4)] = 0.6
    """Largest shift of a channel against the middle one, any direction [px]."""
    scale: Annotated[Finite, Field(ge=0, le=0.02)] = 0.0015
    """Largest difference of a channel's magnification from the middle one's."""
    blur_px: Annotated[Finite, Field(ge=0, le=LARGEST_BLUR_PX)] = 2.0
    """Largest blur of a channel, a standard deviation [px]."""
    unevenness: Annotated[Finite, Field(ge=0, le=0.5)] = 0.06
    """Largest coefficient of light that is not even, relative."""
    ambient: Annotated[Finite, Field(ge=0, le=0.5)] = 0.04
    """Most light that is not from the lamp, relative to that of a flat plate."""
    mixing: Annotated[Finite, Field(ge=0, le=0.3)] = 0.05
    """Largest share of one channel's light in another's signal."""
    exposure: Annotated[Finite, Field(ge=0, lt=1)] = 0.05
    """Largest relative error of an image's brightness, uniform."""
    gain: Annotated[Finite, Field(ge=0, lt=1)] = 0.03
    """Largest relative error of a single channel's brightness, uniform."""
    noise: Annotated[Finite, Field(ge=0, le=1)] = 0.1
    """Largest relative noise of an image; the root of the level is uniform."""
    clean_noise: Annotated[Finite, Field(ge=0, le=1)] = 0.03
    """The same of images that are nearly clean; the level is uniform."""
    correlation: Annotated[Finite, Field(ge=0, le=1)] = 0.4
    """Largest weight of a neighbour's noise beside a pixel's own."""


class ReplayConfig(Strict):
    """A pool of the last samples on the device, from which batches are drawn: cheaper than simulating each."""

    size: Annotated[int, Field(ge=0, le=10**6)] = 0
    """Samples kept; 0 for no pool. A sample of Tab. 1's scene takes 1.6 MiB (direct) to 3.2 MiB (updater)."""
    fresh_per_step: Annotated[int, Field(ge=1, le=4096)] = 8
    """Samples simulated in each step, which replace the oldest."""
    own_share: Annotated[Finite, Field(ge=0, lt=1)] = 0.0
    """Of these, ``updater``: continue samples of the pool, from the network's own answers; see ``own_starts.py``."""
    flat_share: Share = 0.0
    """Of the others, ``updater``: start from a flat plate, as a reconstruction does, and not from perturbed relief."""


class ValidationConfig(Strict):
    """The fixed samples that a network is judged by."""

    count: Annotated[int, Field(ge=1, le=4096)] = 64
    """Number of fixed samples."""
    seed: Annotated[int, Field(ge=0, lt=2**63)] = VALIDATION_SEED
    """Selects them."""
    noise: Annotated[Finite, Field(ge=0, le=1)] = 0.01
    """Relative noise of the images of ``direct`` and ``unrolled`` that no camera has changed."""


class TrainingConfig(Strict):
    """How a network is trained."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Of weights, samples and augmentation."""
    batch_size: Annotated[int, Field(ge=1, le=4096)] = 16
    """Per device and step of the optimiser's accumulation."""
    accumulate: Annotated[int, Field(ge=1, le=1024)] = 1
    """Batches per optimiser step."""
    optimiser: Literal["adam", "adamw"] = "adam"
    """What steps."""
    learning_rate: Annotated[Finite, Field(gt=0, le=10)] = 1e-3
    """Highest step width."""
    weight_decay: Annotated[Finite, Field(ge=0, le=1)] = 0.0
    """Pull of the weights towards 0."""
    clip_norm: Annotated[Finite, Field(gt=0, le=1e6)] | None = None
    """Longer gradients are shortened to this norm; None for never."""
    clip_spikes: Annotated[Finite, Field(gt=1, le=1e6)] | None = None
    """Gradients longer than this multiple of their running mean are shortened to it; None for never."""
    warmup_steps: Annotated[int, Field(ge=0, le=10**7)] = 0
    """Steps in which the learning rate rises from 0."""
    schedule: Literal["constant", "cosine"] = "constant"
    """What becomes of the learning rate afterwards."""
    final_rate: Share = 0.01
    """What cosine decay ends at, a fraction of the learning rate."""
    total_steps: Count | None = None
    """Length of the whole run, over all commands that continue it; the schedule ends there."""
    total_time_s: Seconds | None = None
    """The same in seconds of training."""
    ema_decay: Annotated[Finite, Field(ge=0, lt=1)] = 0.0
    """Average of the weights, which is what is validated and exported; 0 for none."""
    precision: Precision = "32"
    """Of the network's arithmetic: 32, bf16 or 16 bits."""
    compile: bool = False
    """Compile the network first: a minute at the start, faster steps on a GPU."""
    channels_last: bool = True
    """Memory layout that GPUs convolve faster in."""
    steps_per_epoch: Count = 500
    """Optimiser steps between validations for fresh samples; files have epochs of their own."""
    patience: Annotated[int, Field(ge=1, le=10**6)] | None = 3
    """Stop after so many epochs without progress; None for never."""
    min_epochs: Annotated[int, Field(ge=1, le=10**6)] = 5
    """No stop for lack of progress before."""
    log_every_steps: Annotated[int, Field(ge=1, le=10**6)] = 20
    """Steps between reports of progress."""
    exported: Literal["float32", "float16", "int8"] = "float32"
    """How weights.safetensors stores the weights; int8 rounds kernels to a 127th of an output channel's largest."""
    checkpoint_minutes: Annotated[Finite, Field(gt=0, le=1e5)] = 2.0
    """Checkpoint every so many minutes."""
    checkpoint_steps: Count | None = None
    """Checkpoint every so many steps, besides the time."""
    photons: Annotated[tuple[PhotonVariant, ...], Field(min_length=1, max_length=16)] = VARIANTS
    """Of fresh images, ``direct`` and ``unrolled``."""
    noisy: PhotonConfig = PhotonConfig()
    """Of fresh samples: the denoiser's input, the updater's simulated image."""
    clean: PhotonConfig = PhotonConfig()
    """Of fresh samples: the denoiser's target, the updater's target image."""
    slope_weight: Weight = 0.1
    """Weight of the slopes' error, ``direct`` and ``unrolled``; a slope of 1 counts as 1 mm."""
    height_loss: Literal["squared", "absolute"] = "squared"
    """Of ``updater``: mean square [mm^2] or mean magnitude [mm]."""
    lambda_tv: Weight = 0.0
    """Weight of the total variation [mm], ``updater``."""
    denoiser_weights: str | None = None
    """Weights file of the network that denoises the simulated images of fresh ``updater`` samples; None leaves them
    raw. A data set brings its own."""
    fixed_samples: Annotated[int, Field(ge=0, le=10**6)] = 0
    """Samples made once, kept on the device and drawn from in every step, as a search does; 0 for no such pool. An
    epoch then has ``steps_per_epoch`` steps."""
    data_workers: Annotated[int, Field(ge=0, le=64)] | None = None
    """Processes that read files for each GPU; None for half of the cores, 2 to 8. None at all for fresh samples."""
    augmentation: AugmentationConfig = AugmentationConfig()
    camera: CameraConfig | None = None
    """Through which ``direct`` and ``unrolled`` see their images; None shows them as simulated."""
    bench: BenchRanges | None = None
    """Benches of fresh ``direct`` samples, each its own; None: all on the scene. Their cameras are ``camera``'s."""
    scene_share: Share = 0.0
    """Of such samples are on the scene itself; of those that judge a network, none."""
    feedback: FeedbackConfig = FeedbackConfig()
    """How often a network with ``network.feedback`` is given an earlier answer of its own."""
    told: ToldConfig = ToldConfig()
    """What a network with ``network.backbone.conditions`` is told of its benches."""
    pictures: PictureConfig = PictureConfig()
    """Of fewer wavelengths or pixels than the scene's, which such a network sees now and then."""
    replay: ReplayConfig = ReplayConfig()
    validation: ValidationConfig = ValidationConfig()
    unrolling: UnrollingConfig = UnrollingConfig()

    @model_validator(mode="after")
    def _consistent(self) -> "TrainingConfig":
        if self.validation.seed == self.seed:
            raise ValueError(f"seed {self.seed} is that of the validation reliefs; take another")
        if all(variant.share == 0 for variant in self.photons):
            raise ValueError("all photon variants have share 0; raise one")
        return self


class RunConfig(Strict):
    """A training run: what ``config.resolved.yaml`` holds."""

    kind: TrainingKind
    scene: Scene = Scene()
    reliefs: PatternConfig = ReliefConfig()
    network: Annotated[Architecture, Field(discriminator="kind")]
    training: TrainingConfig
    data: str | None = None
    """Folder of the data set; None for fresh samples."""
    initial_weights: str | None = None
    """Weights file that the network starts from."""

    @model_validator(mode="after")
    def _of_one_kind(self) -> "RunConfig":
        if self.network.kind != self.kind:
            raise ValueError(
                f"a network of kind {self.network.kind!r} cannot be trained as {self.kind!r}; "
                f"use a preset such as {PRESETS_OF_KIND[self.kind][0]}"
            )
        if self.training.camera is not None and self.kind in ("denoiser", "updater"):
            raise ValueError(
                f"training.camera changes images, and those of a {self.kind} belong to another image or a gradient; "
                "set it to null"
            )
        self._check_benches()
        self._check_pictures()
        replayed = self.training.replay.size
        if replayed and self.data is not None:
            raise ValueError("training.replay.size is for fresh samples, a data set is a pool already; set it to 0")
        replay = self.training.replay
        if (replay.own_share or replay.flat_share) and not (replay.size and self.kind == "updater"):
            raise ValueError(
                "training.replay.own_share and flat_share are for the updater with a pool; "
                "set both to 0, or training.replay.size"
            )
        fixed = self.training.fixed_samples
        if fixed and replayed:
            raise ValueError("training.fixed_samples and training.replay.size are both pools; set one of them to 0")
        if 0 < fixed < self.training.batch_size:
            raise ValueError(
                f"training.fixed_samples {fixed} is smaller than a batch of {self.training.batch_size}; "
                "raise it, or give 0 for no pool"
            )
        if self.training.denoiser_weights is not None and (self.kind != "updater" or self.data is not None):
            raise ValueError("training.denoiser_weights is for fresh samples of the updater; leave it out")
        return self

    def _check_benches(self) -> None:
        """Benches and a network that is told of them go together."""
        bench, count = self.training.bench, told_count(self.scene.n_wavelengths)
        conditions = self.network.backbone.conditions if self.network.kind == "direct" else 0
        if bench is None:
            if self.training.scene_share:
                raise ValueError(
                    f"training.scene_share is {self.training.scene_share:g}, but all samples are on the scene; set it "
                    "to 0, or give training.bench"
                )
            if conditions:
                raise ValueError(
                    f"network.backbone.conditions is {conditions}, but all samples are on one bench; give "
                    "training.bench, as configs/family.yaml does, or set it to 0"
                )
            return
        if self.kind != "direct" or self.data is not None:
            raise ValueError("training.bench is for fresh samples of a direct network; set it to null")
        if conditions != count:
            raise ValueError(
                f"training.bench needs a network that is told of its bench; set network.backbone.conditions to {count}"
            )
        if bench.camera != CameraRanges():
            raise ValueError("training.bench.camera is not used, training.camera is; leave it out")
        bench.check(self.scene)

    def _check_pictures(self) -> None:
        """Shares of other pictures that can be shown."""
        pictures = self.training.pictures
        if pictures.is_off:
            return
        if self.training.bench is None:
            raise ValueError(
                "training.pictures is for networks that are told of benches; give training.bench, or leave it out"
            )
        if pictures.coarse_share and self.scene.image_pixels % pictures.coarse_binning:
            raise ValueError(
                f"training.pictures.coarse_binning {pictures.coarse_binning} does not divide "
                f"{self.scene.image_pixels} image pixels; use a divisor"
            )
        if self.scene.n_wavelengths == 1 and (pictures.one_wavelength_share or pictures.two_wavelengths_share):
            raise ValueError(
                "training.pictures has shares with fewer wavelengths than the scene's only one; set "
                "one_wavelength_share and two_wavelengths_share to 0"
            )


def network_feedback(config: RunConfig) -> bool:
    """Whether a run's network is given earlier answers of its own."""
    return config.network.kind == "direct" and config.network.feedback


PRESETS_OF_KIND: dict[str, tuple[str, ...]] = {
    "denoiser": ("paper-denoiser",),
    "updater": ("paper-updater", "paper-updater-no-gradient"),
    "direct": ("direct", "direct-small", "direct-large"),
    "unrolled": ("unrolled", "unrolled-small"),
}
"""Networks by kind, the default first. ``paper`` is short for the first of the paper's."""

_OURS = TrainingConfig(
    optimiser="adamw",
    learning_rate=1e-3,
    weight_decay=0.01,
    clip_norm=1.0,
    clip_spikes=4.0,
    warmup_steps=300,
    schedule="cosine",
    ema_decay=0.999,
    precision="bf16",
    patience=None,
    camera=CameraConfig(),
)
# The supplement: Adam, stop after 3 epochs without progress, at least 5 epochs.
_PAPER = TrainingConfig(batch_size=8, augmentation=AugmentationConfig(symmetries=False))


def default_run(kind: TrainingKind, preset: str | None = None) -> dict[str, Any]:
    """The configuration of a kind of training in plain types, before anything is overridden.

    Args:
        kind: what is trained.
        preset: a network of ``PRESETS_OF_KIND``; the first if None, or ``"paper"``.

    Raises:
        InputError: no such preset for this kind.
    """
    names = PRESETS_OF_KIND[kind]
    name = names[0] if preset is None or (preset == "paper" and kind in ("denoiser", "updater")) else preset
    if name not in names:
        raise InputError(f"preset {preset!r} is no {kind}; {known_names(str(preset), names)}")
    network = PRESETS[name]
    is_ours = kind in ("direct", "unrolled")
    training, reliefs = (_OURS, ReliefConfig(variety=PrintVariety())) if is_ours else (_PAPER, ReliefConfig())
    # Simulated as `nsfc` will simulate; a target from many random photons has some noise, as a capture has.
    paper_photons = {"noisy": PAPER_NOISY, "clean": PAPER_CLEAN}
    changes: dict[str, Any] = dict(paper_photons) if kind in ("denoiser", "updater") else {}
    if network.kind in ("denoiser", "updater"):
        changes["learning_rate"] = network.network.learning_rate
        changes["lambda_tv"] = network.network.lambda_tv or 0.0
    return {
        "kind": kind,
        "scene": Scene().model_dump(mode="json"),
        "reliefs": reliefs.model_dump(mode="json"),
        "network": network.model_dump(mode="json"),
        "training": training.model_copy(update=changes).model_dump(mode="json"),
        "data": None,
        "initial_weights": None,
    }
