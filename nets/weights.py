"""Weights of networks on disk: with all that is needed to build, to check and to trust them.

A file knows its architecture, scene, normalisation, data, training and code,
and a hash over all of it. What does not fit is refused with what differs.
"""

import importlib.metadata
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import pydantic
import torch
from torch import nn

from nets.architecture import MAX_PARAMETERS, Architecture, architecture_record, build, parse_architecture, shapes
from nets.rounded_weights import STEP, restored, rounded, stored_form
from nets.weights_file import MAX_HEADER_BYTES, decode, encode
from warp_caustics.errors import DamagedDataError, InputError, MismatchError
from warp_caustics.io.atomic import PathLike, atomic_path, regular_file
from warp_caustics.io.regular import read_regular, require_regular
from warp_caustics.scene import Scene, validation_lines

FORMAT = 1
"""Raised whenever older programs would misread a file."""

Precision = Literal["int8", "float16", "float32"]
_DTYPES: dict[Precision, torch.dtype] = {"float16": torch.float16, "float32": torch.float32}
"""Of tensors that are stored as they are; for int8 see :mod:`nets.rounded_weights`."""
MAX_NAMED = 4
"""Differences spelled out in one message."""


@dataclass(frozen=True)
class WeightsInfo:
    """What a weights file says of itself.

    Attributes:
        architecture: complete configuration of the network.
        scene: what it was trained for.
        precision: how the weights are stored. float16 rounds a weight by up to 0.05 %, and by up to 3e-8
            below 6e-5; int8 rounds kernels, by up to 0.4 % of the largest of an output channel.
        data_fingerprint: of the data it was trained on; None where there is none.
        training: record of the training.
        code: versions of the software that wrote it.
        parameters: number of learned values.
        content_hash: sha256 over everything above and all weights.
    """

    architecture: Architecture
    scene: Scene
    precision: Precision
    data_fingerprint: str | None
    training: Mapping[str, Any]
    code: Mapping[str, str]
    parameters: int
    content_hash: str


@dataclass(frozen=True)
class LoadedNetwork:
    """A network from a file.

    Attributes:
        module: float32, in evaluation mode.
        info: what the file says of itself.
    """

    module: nn.Module
    info: WeightsInfo


def save_weights(
    path: PathLike,
    module: nn.Module,
    *,
    scene: Scene,
    data_fingerprint: str | None,
    training: Mapping[str, Any],
    dtype: Precision = "float32",
) -> str:
    """Write a network's weights; the file appears complete or not at all.

    Args:
        path: file to write.
        module: network that :func:`nets.build` made; wrapped by ``torch.compile`` or not.
        scene: what it was trained for.
        data_fingerprint: of the data it was trained on; None where there is none.
        training: record of the training, JSON values.
        dtype: how weights are stored; float16 halves the file and rounds, int8 does so again, see
            :class:`WeightsInfo`.

    Returns:
        sha256 of the content.

    Raises:
        InputError: no network of this project, weights that are not finite or too large for float16, a
            record that JSON cannot hold, or a path that cannot be written.
        MismatchError: the network was built for another scene.
        ResourceError: the disk is full.
    """
    module = getattr(module, "_orig_mod", module)
    architecture = getattr(module, "config", None)
    if not isinstance(architecture, get_args(Architecture)):
        raise InputError(f"{type(module).__name__} is no network of nets.build; give one")
    _check_scene(getattr(module, "scene", scene), scene, "the network")
    record = {
        "format": FORMAT,
        "architecture": architecture_record(architecture),
        "scene": scene.record(),
        "normalisation": normalisation(architecture, scene),
        "precision": dtype,
        "data_fingerprint": data_fingerprint,
        "training": _json_value(training),
        "code": {"nsfc": importlib.metadata.version("nsfc"), "torch": torch.__version__},
    }
    content, digest = encode(record, _stored(module, dtype))
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
    return digest


def load_weights(
    path: PathLike, *, scene: Scene | None = None, map_location: str | torch.device = "cpu"
) -> LoadedNetwork:
    """Read a network, every byte checked.

    Args:
        path: file that :func:`save_weights` wrote.
        scene: what the network shall be used for; None takes any.
        map_location: device of the module.

    Raises:
        InputError: no such file.
        DamagedDataError: the content is not what was written, or holds NaN or infinity.
        MismatchError: another kind of file, another scene, or weights that do not fit their architecture.
    """
    file = regular_file(path)
    name = repr(os.fspath(path))
    record, tensors, digest = decode(_content(file, name), name)
    info = _info(record, tensors, digest, name)
    if scene is not None:
        _check_scene(info.scene, scene, name)
    _check_tensors(tensors, info, name)
    # Building draws numbers for weights that are overwritten; a program's own random numbers stay as they were.
    with torch.random.fork_rng(devices=()):
        module = build(info.architecture, info.scene)
    module.load_state_dict(restored(tensors), strict=True)
    return LoadedNetwork(module.to(map_location).eval(), info)


def weights_info(path: PathLike) -> WeightsInfo:
    """What a weights file says of itself, every byte checked, without building the network.

    Args:
        path: file that :func:`save_weights` wrote.

    Raises:
        InputError: no such file.
        DamagedDataError: the content is not what was written.
        MismatchError: another kind of file.
    """
    file = regular_file(path)
    name = repr(os.fspath(path))
    return _info(*decode(_content(file, name), name), name)


def normalisation(architecture: Architecture, scene: Scene) -> dict[str, Any]:
    """Constants by which a network's inputs and outputs are scaled, under the names of their configuration."""
    if architecture.kind in ("direct", "unrolled"):
        constants = architecture.encoding.model_dump(mode="json")
        return {**constants, "flat_irradiance_W_m2": [value or 1.0 for value in scene.radiosity_W_m2]}
    return {key: value for key, value in architecture.model_dump(mode="json").items() if "_unit" in key}


def _json_value(record: Mapping[str, Any]) -> Any:
    try:
        return json.loads(json.dumps(record, allow_nan=False))
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(
            f"training record cannot be written as JSON ({error}); give finite numbers, text, lists and mappings"
        ) from error


def _stored(module: nn.Module, dtype: Precision) -> dict[str, torch.Tensor]:
    limit = torch.finfo(_DTYPES.get(dtype, torch.float16)).max
    tensors: dict[str, torch.Tensor] = {}
    for key, tensor in module.state_dict().items():
        largest = tensor.detach().abs().max().item()
        if not largest <= limit:
            raise InputError(f"weight {key} reaches {largest:g}, {dtype} ends at {limit:g}; do not save this network")
        values = tensor.detach().cpu()
        tensors.update(rounded(key, values) if dtype == "int8" else {key: values.to(_DTYPES[dtype])})
    return tensors


def _forms(
    expected: Mapping[str, tuple[int, ...]], precision: Precision
) -> dict[str, tuple[tuple[int, ...], torch.dtype]]:
    """Shape and type of every tensor of a file."""
    if precision != "int8":
        return {key: (shape, _DTYPES[precision]) for key, shape in expected.items()}
    return {name: form for key, shape in expected.items() for name, form in stored_form(key, shape).items()}


def _content(file: Path, name: str) -> bytes:
    limit = 4 * MAX_PARAMETERS + MAX_HEADER_BYTES
    size = require_regular(file).st_size
    if size > limit:
        raise MismatchError(f"{name} has {size} bytes, the limit is {limit}; give a weights file")
    return read_regular(file, limit)


def _info(record: Mapping[str, Any], tensors: Mapping[str, torch.Tensor], digest: str, name: str) -> WeightsInfo:
    if record.get("format") != FORMAT:
        raise MismatchError(f"{name} has format {record.get('format')!r}, this program reads {FORMAT}; update nsfc")
    try:
        architecture, scene = parse_architecture(record["architecture"]), Scene.model_validate(record["scene"])
        if record["precision"] not in get_args(Precision):
            raise InputError(f"precision {record['precision']!r} is none of {', '.join(get_args(Precision))}")
        expected = normalisation(architecture, scene)
        if record["normalisation"] != expected:
            raise InputError(f"normalisation {record['normalisation']} differs from {expected}")
        for key in ("training", "code"):
            if not isinstance(record[key], dict):
                raise InputError(f"{key} is no record")
        return WeightsInfo(
            architecture=architecture,
            scene=scene,
            precision=record["precision"],
            data_fingerprint=record["data_fingerprint"],
            training=record["training"],
            code=record["code"],
            parameters=sum(tensor.numel() for key, tensor in tensors.items() if not key.endswith(STEP)),
            content_hash=digest,
        )
    except KeyError as error:
        raise MismatchError(f"{name} says nothing of its {error.args[0]}; save it with this version of nsfc") from error
    except (InputError, pydantic.ValidationError) as error:
        why = "; ".join(validation_lines(error)) if isinstance(error, pydantic.ValidationError) else str(error)
        raise MismatchError(f"{name} describes a network this program does not know ({why}); update nsfc") from error


def _check_tensors(tensors: Mapping[str, torch.Tensor], info: WeightsInfo, name: str) -> None:
    """Compare with the architecture before anything of its size is allocated."""
    try:
        expected = _forms(shapes(info.architecture, info.scene), info.precision)
    except InputError as error:
        raise MismatchError(f"{name} cannot be built: {error}") from error
    kind = info.architecture.kind
    problems = [f"{key} is missing" for key in expected if key not in tensors]
    problems += [f"{key} belongs to no {kind} network" for key in tensors if key not in expected]
    for key in expected.keys() & tensors.keys():
        found, dtype = tuple(tensors[key].shape), tensors[key].dtype
        shape, wanted = expected[key]
        if found != shape:
            problems.append(f"{key} has shape {list(found)}, not {list(shape)}")
        if dtype != wanted:
            problems.append(f"{key} is {str(dtype).removeprefix('torch.')}, not {str(wanted).removeprefix('torch.')}")
    if problems:
        raise MismatchError(f"weights in {name} do not fit their architecture: {_listed(problems)}; train again")
    bad = [key for key, tensor in tensors.items() if tensor.is_floating_point() and not torch.isfinite(tensor).all()]
    if bad:
        raise DamagedDataError(f"{name} holds weights that are not finite: {_listed(bad)}; train again")


def _check_scene(theirs: Scene, ours: Scene, name: str) -> None:
    differences = [
        f"{key} is {getattr(theirs, key)} there and {getattr(ours, key)} here"
        for key in Scene.model_fields
        if getattr(theirs, key) != getattr(ours, key)
    ]
    if differences:
        raise MismatchError(
            f"{name} is for another scene: {_listed(differences)}; use a network for this scene, or train one"
        )


def _listed(problems: Iterable[str]) -> str:
    found = sorted(problems)
    more = f", and {len(found) - MAX_NAMED} more" if len(found) > MAX_NAMED else ""
    return ", ".join(found[:MAX_NAMED]) + more
