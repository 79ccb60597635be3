"""A virtual HDF5 file that shows all shards as one, for people and their viewers.

HDF5 fills in for files it cannot find or open, without an error; here with NaN.
That is why nothing in this package reads through it.
"""

import io
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from data_gen.sampler import Field
from data_gen.store.folder import StoredConfig, load_complete, open_folder
from data_gen.store.layout import Layout, read_manifest
from data_gen.store.shard import describe_columns
from warp_caustics.errors import DamagedDataError, MismatchError
from warp_caustics.io.atomic import PathLike
from warp_caustics.io.durable import publish

_ID = Field("ids", (), "int64", "", "sample numbers; -1 where the file is missing")


def write_index(directory: PathLike) -> Path:
    """Write ``index.h5`` of a finished data set; the same data set gives the same bytes.

    Raises:
        MismatchError: the data set is unfinished.
        DamagedDataError: a manifest is missing.
    """
    layout, config = open_folder(directory)
    if load_complete(layout, config) is None:
        raise MismatchError(f"{str(layout.root)!r} is unfinished; finish building it before making an index")
    manifest = read_manifest(layout.manifest(0))
    if manifest is None:
        raise DamagedDataError(f"{str(layout.manifest(0))!r} is missing; build again to repair")
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=("earliest", "v110")) as file:
        for field in (*manifest.fields, _ID):
            _add(file, layout, config, field)
        file.attrs["warning"] = "missing or unreadable shards appear as NaN; do not train through this file"
    publish(layout.index, buffer.getbuffer())
    return layout.index


def _add(file: Any, layout: Layout, config: StoredConfig, field: Field) -> None:
    dtype = np.dtype(field.dtype)
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_fill_value(np.array(np.nan if dtype.kind == "f" else -1, dtype))
    # h5py's own function for virtual data sets stores the time.
    properties.set_obj_track_times(False)
    whole = h5py.h5s.create_simple((config.n_samples, *field.shape))
    corner = (0,) * len(field.shape)
    for shard in range(config.n_shards):
        ids = config.shard_ids(shard)
        part = h5py.h5s.create_simple((len(ids), *field.shape))
        whole.select_hyperslab((ids[0], *corner), (len(ids), *field.shape))
        name = f"{layout.shards.name}/{layout.shard(shard).name}"
        properties.set_virtual(whole, name.encode(), field.name.encode(), part)
    whole.select_all()
    kind = h5py.h5t.py_create(dtype, logical=True)
    dataset = h5py.Dataset(h5py.h5d.create(file.id, field.name.encode(), kind, whole, properties))
    dataset.attrs["unit"], dataset.attrs["description"] = field.unit, field.description
    describe_columns(dataset, field)
