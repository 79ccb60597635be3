"""Data sets on disk: built anywhere, killed at any time, never wrong.

Names are imported on first use, so that ``import data_gen.store`` stays cheap.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from data_gen.store.builder import build as build
    from data_gen.store.cluster import build_on_cluster as build_on_cluster
    from data_gen.store.columns import column_ranges as column_ranges
    from data_gen.store.datamodule import CausticDataModule as CausticDataModule
    from data_gen.store.index import write_index as write_index
    from data_gen.store.progress import BuildReport as BuildReport
    from data_gen.store.progress import Progress as Progress
    from data_gen.store.reader import CausticDataset as CausticDataset
    from data_gen.store.summary import DatasetInfo as DatasetInfo
    from data_gen.store.summary import Estimate as Estimate
    from data_gen.store.summary import estimate as estimate
    from data_gen.store.summary import info as info
    from data_gen.store.verification import Verification as Verification
    from data_gen.store.verification import verify as verify

_HOMES = {
    "BuildReport": "progress",
    "CausticDataModule": "datamodule",
    "CausticDataset": "reader",
    "DatasetInfo": "summary",
    "Estimate": "summary",
    "Progress": "progress",
    "Verification": "verification",
    "build": "builder",
    "build_on_cluster": "cluster",
    "column_ranges": "columns",
    "estimate": "summary",
    "info": "summary",
    "verify": "verification",
    "write_index": "index",
}

__all__ = [
    "BuildReport",
    "CausticDataModule",
    "CausticDataset",
    "DatasetInfo",
    "Estimate",
    "Progress",
    "Verification",
    "build",
    "build_on_cluster",
    "column_ranges",
    "estimate",
    "info",
    "verify",
    "write_index",
]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f"data_gen.store.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
