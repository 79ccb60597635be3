"""What makes samples: the interface between generators of samples and the storage of data sets."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from data_gen.dataset_config import DatasetConfig


@dataclass(frozen=True)
class Column:
    """One number of a field that is a row of named numbers.

    Attributes:
        name: its name.
        unit: SI unit; empty for a bare number.
        description: what it is, one line.
    """

    name: str
    unit: str
    description: str


@dataclass(frozen=True)
class Field:
    """One array of a sample.

    Attributes:
        name: name in the file.
        shape: shape of one sample's array.
        dtype: ``"float16"``, ``"float32"``.
        unit: SI unit.
        description: what it is, one line.
        columns: of a row of named numbers, one for each; empty for all other arrays.
    """

    name: str
    shape: tuple[int, ...]
    dtype: str
    unit: str
    description: str
    columns: tuple[Column, ...] = ()

    def record(self) -> dict[str, Any]:
        """Plain values; without columns where there are none, as fields were written before they had any."""
        tree = asdict(self)
        if not self.columns:
            del tree["columns"]
        return tree

    @classmethod
    def from_record(cls, tree: Mapping[str, Any]) -> "Field":
        """The field of a record."""
        columns = tuple(Column(**column) for column in tree.get("columns", ()))
        return cls(**{**tree, "shape": tuple(tree["shape"]), "columns": columns})

    @property
    def bytes_per_sample(self) -> int:
        return int(np.prod(self.shape)) * np.dtype(self.dtype).itemsize


@dataclass(frozen=True)
class SampleBatch:
    """Finished samples.

    Attributes:
        ids: sample numbers, in the order of the arrays' first axis.
        arrays: field name to array, shape [len(ids), *field.shape].
        counters: what happened while making them (light lost, lines clamped ...), shape [len(ids)] each.
    """

    ids: tuple[int, ...]
    arrays: Mapping[str, npt.NDArray[Any]]
    counters: Mapping[str, npt.NDArray[np.float64]] = field(default_factory=dict)


class Sampler(Protocol):
    """Makes samples of one data set. A sample depends on the configuration and its id, on nothing else."""

    @property
    def fields(self) -> tuple[Field, ...]:
        """The arrays of a sample."""

    def draw(self, ids: Sequence[int]) -> SampleBatch:
        """The samples of these ids."""


SamplerFactory = Callable[[DatasetConfig, str], Sampler]
"""Configuration and device to sampler. Workers are spawned, so it must be picklable: a module's function or a
functools.partial of one."""
