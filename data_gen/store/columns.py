"""What a data set's rows of named numbers hold: each column with its lowest and highest value."""

import numpy as np

from data_gen.sampler import Column
from data_gen.store.folder import open_folder, present_shards
from data_gen.store.reader import OpenShard
from data_gen.store.verification import check_shard
from warp_caustics.errors import DamagedDataError
from warp_caustics.io.atomic import PathLike, reason


def column_ranges(directory: PathLike) -> dict[Column, tuple[float, float]]:
    """Lowest and highest value of each column over all built samples; nothing where no field has columns.

    Read a shard at a time, without comparing hashes.

    Raises:
        InputError: it is no data set.
        DamagedDataError: config.json or a shard is broken.
    """
    layout, config = open_folder(directory)
    found: dict[Column, tuple[float, float]] = {}
    for shard in present_shards(layout, config):
        manifest, problem = check_shard(layout, config, shard)
        if manifest is None or problem is not None:
            continue
        fields = [field for field in manifest.fields if field.columns]
        if not fields:
            return {}
        try:
            opened = OpenShard(layout, config, shard, None)
            try:
                tables = [np.asarray(opened.datasets[field.name]) for field in fields]
            finally:
                opened.close()
        except (OSError, RuntimeError, KeyError, DamagedDataError) as error:
            raise DamagedDataError(
                f"{str(layout.shard(shard))!r} cannot be read ({reason(error)}); build again with --repair"
            ) from error
        for field, table in zip(fields, tables, strict=True):
            for column, low, high in zip(field.columns, table.min(axis=0), table.max(axis=0), strict=True):
                before = found.get(column, (np.inf, -np.inf))
                found[column] = min(before[0], float(low)), max(before[1], float(high))
    return found
