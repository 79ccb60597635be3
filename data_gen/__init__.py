"""Printed reliefs: what the fibres of Tab. 3 of the supplement look like as height fields, and data sets of them.

These names are the public ones, imported on first use. Building, checking and
describing data sets on disk have a front door of their own, :mod:`data_gen.store`.
"""

from typing import TYPE_CHECKING

from warp_caustics.front_door import front_door

if TYPE_CHECKING:
    from data_gen.bench_ranges import BenchRanges as BenchRanges
    from data_gen.benches.bench_set import Benches as Benches
    from data_gen.config import CurvesConfig as CurvesConfig
    from data_gen.config import DropsConfig as DropsConfig
    from data_gen.config import MeandersConfig as MeandersConfig
    from data_gen.config import PictureConfig as PictureConfig
    from data_gen.config import PolylinesConfig as PolylinesConfig
    from data_gen.config import RasterConfig as RasterConfig
    from data_gen.config import ReliefConfig as ReliefConfig
    from data_gen.config import RingsConfig as RingsConfig
    from data_gen.config import TextConfig as TextConfig
    from data_gen.dataset_config import DatasetConfig as DatasetConfig
    from data_gen.dataset_config import PhotonConfig as PhotonConfig
    from data_gen.making import Making as Making
    from data_gen.patterns import draw_strokes as draw_strokes
    from data_gen.samples import make_sampler as make_sampler
    from data_gen.store.reader import CausticDataset as CausticDataset
    from data_gen.testset import DEVELOPMENT_FIELDS as DEVELOPMENT_FIELDS
    from data_gen.testset import TEST_FIELDS as TEST_FIELDS
    from data_gen.testset import field_heights as field_heights
    from data_gen.testset import field_images as field_images

_HOMES = {
    "BenchRanges": "data_gen.bench_ranges",
    "Benches": "data_gen.benches.bench_set",
    "CausticDataset": "data_gen.store.reader",
    "CurvesConfig": "data_gen.config",
    "DEVELOPMENT_FIELDS": "data_gen.testset",
    "DatasetConfig": "data_gen.dataset_config",
    "DropsConfig": "data_gen.config",
    "Making": "data_gen.making",
    "MeandersConfig": "data_gen.config",
    "PhotonConfig": "data_gen.dataset_config",
    "PictureConfig": "data_gen.config",
    "PolylinesConfig": "data_gen.config",
    "RasterConfig": "data_gen.config",
    "ReliefConfig": "data_gen.config",
    "RingsConfig": "data_gen.config",
    "TEST_FIELDS": "data_gen.testset",
    "TextConfig": "data_gen.config",
    "draw_strokes": "data_gen.patterns",
    "field_heights": "data_gen.testset",
    "field_images": "data_gen.testset",
    "make_sampler": "data_gen.samples",
}

__all__ = [*_HOMES]

__getattr__ = front_door(__name__, _HOMES)
