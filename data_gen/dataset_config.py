"""What a data set is: its configuration, its fingerprint and the keys of its samples."""

import hashlib
import json
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from data_gen.bench_ranges import BenchRanges
from data_gen.config import PatternConfig, ReliefConfig
from warp_caustics.scene import Placement, Scene
from warp_caustics.strict import Strict

GENERATOR_VERSION = 1
"""Raised whenever the same configuration would give other samples."""

MAX_SAMPLES = 10**8

Kind = Literal["denoiser", "updater", "capture"]
"""Pairs of a noisy and a clean image; a relief, a start and a gradient; a relief and a photo of it on a bench."""
Role = Literal["data", "test", "bench"]
"""Of data sets and trainings; of the test fields; of the test bench's own plates."""


class PhotonConfig(Strict):
    """How one of a sample's images is simulated; None takes the preset's value."""

    preset: Literal["lattice", "paper"] = "lattice"
    """Photon set."""
    n_photons: Annotated[int, Field(ge=1, le=10**9)] | None = None
    """n_l: light paths per wavelength."""
    smoothing: Annotated[float, Field(ge=0, le=1e4, allow_inf_nan=False)] | None = None
    """s: scales the photon footprint."""
    placement: Placement | None = None
    """Where photons start: lattice, stratified, sobol or random."""
    traced: Annotated[int, Field(ge=2, le=10**9)] | None = None
    """Paths traced in place of n_l random ones, with the same mean and noise (``warp_caustics/thinned.py``); None
    traces all."""

    @model_validator(mode="after")
    def _thinned_paper(self) -> "PhotonConfig":
        if self.traced is not None and (self.preset != "paper" or self.placement not in (None, "random")):
            raise ValueError("traced stands for random photons of the preset paper; leave it out, or take that preset")
        return self

    def record(self) -> dict[str, Any]:
        """In plain types, without ``traced`` where all are: what was simulated before it keeps its fingerprint."""
        return {name: value for name, value in self.model_dump().items() if name != "traced" or value is not None}


PAPER_NOISY = PhotonConfig(preset="paper", n_photons=1_000_000)
PAPER_CLEAN = PhotonConfig(preset="paper", n_photons=16_000_000)
"""Both values of n_l in Tab. 1."""


def _default_photons(values: dict[str, Any], paper: PhotonConfig) -> PhotonConfig:
    return paper if values.get("kind") == "denoiser" else PhotonConfig()


class DatasetConfig(Strict):
    """Everything that decides the content of a data set; unknown fields are refused."""

    kind: Kind
    n_samples: Annotated[int, Field(ge=1, le=MAX_SAMPLES)]
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    role: Role = "data"
    """Samples of different roles share neither reliefs nor photons."""
    samples_per_shard: Annotated[int, Field(ge=1, le=4096)] = 32
    """Samples in one file, the unit of work."""
    scene: Scene = Scene()
    reliefs: PatternConfig = ReliefConfig()
    noisy: PhotonConfig = Field(default_factory=lambda data: _default_photons(data, PAPER_NOISY))
    """The denoiser's input, and the updater's simulated image and gradient. By default the denoiser's are as in
    the paper, 1e6 random photons, and the updater's from a lattice: no noise, and thirty times faster."""
    clean: PhotonConfig = Field(default_factory=lambda data: _default_photons(data, PAPER_CLEAN))
    """The denoiser's target, and the updater's target image. By default 1.6e7 random photons, and a lattice."""
    bench: BenchRanges | None = None
    """Ranges of benches, for captures; ``clean`` says how their light is simulated."""
    denoiser: str | None = None
    """Content hash of the network that denoises the updater's simulated images; None leaves them raw."""

    @model_validator(mode="after")
    def _denoiser_of_updater(self) -> "DatasetConfig":
        if self.denoiser is not None and self.kind != "updater":
            raise ValueError("only the updater's data set takes a denoiser; leave it out")
        return self

    @model_validator(mode="after")
    def _bench_of_captures(self) -> "DatasetConfig":
        if (self.bench is not None) != (self.kind == "capture"):
            raise ValueError(
                "a data set of captures needs ranges of benches; give --bench ordinary, or data.bench"
                if self.bench is None
                else f"bench is for captures, this is a data set of the {self.kind}; build capture, or set it to null"
            )
        if self.bench is not None:
            self.bench.check(self.scene)
            if self.clean.traced is not None:
                raise ValueError("clean.traced is not for captures, whose benches share their photons; leave it out")
        return self

    @property
    def n_shards(self) -> int:
        return -(-self.n_samples // self.samples_per_shard)

    def shard_ids(self, shard: int) -> range:
        """Sample ids of a shard."""
        first = shard * self.samples_per_shard
        return range(first, min(first + self.samples_per_shard, self.n_samples))

    def canonical(self) -> dict[str, Any]:
        """The configuration in plain types, with the generator's version.

        Without ``reliefs.variety``, ``reliefs.making`` and ``bench`` where there is none, and later fields of the scene
        at their defaults: data sets from before them keep their fingerprint.
        """
        tree = {"generator_version": GENERATOR_VERSION, **self.model_dump(mode="json"), "scene": self.scene.record()}
        for name in ("variety", "making"):
            if tree["reliefs"][name] is None:
                del tree["reliefs"][name]
        if tree["bench"] is None:
            del tree["bench"]
        return {**tree, "noisy": self.noisy.record(), "clean": self.clean.record()}

    def fingerprint(self) -> str:
        """Hash of everything: two directories of the same fingerprint hold the same data set."""
        return _digest(self.canonical())

    def sample_fingerprint(self) -> str:
        """Hash of what a single sample depends on: a longer data set begins with the samples of a shorter one."""
        return _digest({k: v for k, v in self.canonical().items() if k not in ("n_samples", "samples_per_shard")})


def _digest(tree: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(tree, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def sample_seed(sample_fingerprint: str, purpose: str, sample: int) -> int:
    """Seed below 2^63 of one purpose (``"relief"``, ``"photons/clean"``) of one sample.

    A hash: neighbouring samples, purposes and data sets have nothing in common.
    """
    digest = hashlib.sha256(f"{sample_fingerprint}/{purpose}/{sample}".encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1


def sample_generator(sample_fingerprint: str, purpose: str, sample: int) -> np.random.Generator:
    """Random numbers of one purpose of one sample; counter-based, so that no other sample need be drawn first."""
    digest = hashlib.sha256(f"{sample_fingerprint}/{purpose}".encode()).digest()
    key = np.frombuffer(digest[:16], dtype=np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=[0, 0, 0, sample]))
