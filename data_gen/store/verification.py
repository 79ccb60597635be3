"""Is a data set what it claims to be? Names every shard that is not, with the reason."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from data_gen.store.folder import StoredConfig, load_complete, open_folder, present_shards
from data_gen.store.layout import Complete, Entry, Layout, Manifest, read_manifest, sha256
from data_gen.store.shard import identity
from warp_caustics.errors import DamagedDataError
from warp_caustics.io.atomic import PathLike
from warp_caustics.io.durable import TEMPORARY_PREFIX
from warp_caustics.io.hashes import file_sha256
from warp_caustics.io.regular import IrregularFileError, open_regular, require_regular

_HEAD_BYTES = 64 * 2**10
_MOST_NAMED = 1000


@dataclass(frozen=True)
class Problem:
    """Something wrong.

    Attributes:
        shard: its number; None where it is no shard's.
        kind: ``"missing"``, ``"damaged"``, ``"foreign"``, ``"swapped"``, ``"stale"``, ``"unpublished"``.
        reason: one line.
    """

    shard: int | None
    kind: str
    reason: str

    def __str__(self) -> str:
        where = "data set" if self.shard is None else f"shard {self.shard:05d}"
        return f"{where} {self.kind}: {self.reason}"


@dataclass(frozen=True)
class Verification:
    """What :func:`verify` found.

    Attributes:
        problems: in the order of shards; empty if all is well.
        shards_right: shards without a problem.
        n_shards: shards that there should be.
        complete: COMPLETE.json says that the data set is finished.
    """

    problems: tuple[Problem, ...]
    shards_right: int
    n_shards: int
    complete: bool

    def require(self) -> None:
        """Raise if anything is wrong.

        Raises:
            DamagedDataError: names the first problems.
        """
        if self.problems:
            more = len(self.problems) - 3
            listed = "; ".join(map(str, self.problems[:3])) + (f"; and {more} more" if more > 0 else "")
            raise DamagedDataError(f"{listed}; build again with a full check to repair")


def verify(directory: PathLike, *, full: bool = True, threads: int = 4) -> Verification:
    """Check a data set.

    Args:
        directory: its folder.
        full: hash every file; otherwise only sizes and manifests are compared.
        threads: that hash.

    Returns:
        Everything that is wrong. Shards that an unfinished data set does not have yet are not wrong.

    Raises:
        InputError: it is no data set.
        DamagedDataError: config.json is broken, so nothing can be compared.
    """
    layout, config = open_folder(directory)
    problems: list[Problem] = []
    complete: Complete | None = None
    try:
        complete = load_complete(layout, config)
    except DamagedDataError as error:
        problems.append(Problem(None, "damaged", str(error)))
    must_exist = layout.complete.exists()
    present = present_shards(layout, config)
    absent = config.n_shards - len(present)
    # Of an unfinished data set these are not wrong; of millions that are missing, the first are named.
    is_there = set(present)
    named = (shard for shard in range(config.n_shards) if shard not in is_there)
    looked_at = sorted([*present, *(islice(named, _MOST_NAMED) if must_exist else ())])
    if must_exist and absent > _MOST_NAMED:
        problems.append(Problem(None, "missing", f"{absent - _MOST_NAMED} more shards than are named here"))

    def check(shard: int) -> Problem | None:
        _, problem = check_shard(layout, config, shard, entry=complete.entries[shard] if complete else None, full=full)
        unbuilt = problem is not None and problem.kind in ("missing", "unpublished") and not must_exist
        return None if unbuilt and not layout.manifest(shard).exists() else problem

    with ThreadPoolExecutor(threads) as pool:
        found = [problem for problem in pool.map(check, looked_at) if problem is not None]
    unbuilt = sum(not layout.manifest(shard).exists() for shard in present) if not must_exist else 0
    problems += [*found, *_strangers(layout, present)]
    right = len(looked_at) - len(found) - unbuilt
    return Verification(tuple(problems), right, config.n_shards, complete is not None)


def check_shard(
    layout: Layout, config: StoredConfig, shard: int, *, entry: Entry | None = None, full: bool = False
) -> tuple[Manifest | None, Problem | None]:
    """Manifest of a shard if it is readable and its own, and what is wrong with the shard.

    Args:
        layout: where.
        config: of the data set.
        shard: which.
        entry: its line in COMPLETE.json, if there is one.
        full: hash the file; otherwise only its size is compared.
    """
    path = layout.shard(shard)
    try:
        manifest = read_manifest(layout.manifest(shard))
    except DamagedDataError as error:
        return None, Problem(shard, "damaged", str(error))
    if manifest is None:
        if path.exists():
            return None, Problem(shard, "unpublished", "there is a file but no manifest")
        return None, Problem(shard, "missing", "neither file nor manifest is there")
    if manifest.fingerprint != config.fingerprint:
        reason = f"manifest of a data set {manifest.fingerprint[:12]}, this one is {config.fingerprint[:12]}"
        return None, Problem(shard, "foreign", reason)
    if manifest.shard != shard or manifest.ids != tuple(config.shard_ids(shard)):
        return None, Problem(shard, "swapped", f"manifest of shard {manifest.shard:05d}")
    problem = _check_file(path, manifest, full)
    if entry is not None and sha256(manifest.to_bytes()) != entry.manifest_sha256:
        if problem is None and full:
            problem = Problem(shard, "stale", "file and manifest are another version than COMPLETE.json lists")
        elif problem is None or _is(path, entry.sha256):
            problem = Problem(shard, "stale", "the manifest is another version than COMPLETE.json lists")
    return manifest, problem


def _check_file(path: Path, manifest: Manifest, full: bool) -> Problem | None:
    shard = manifest.shard
    try:
        size = require_regular(path).st_size
        if size == manifest.n_bytes and not full:
            return None
        found = file_sha256(path)
        with open_regular(path) as file:
            head = file.read(_HEAD_BYTES)
    except FileNotFoundError:
        return Problem(shard, "missing", "its manifest is there, the file is not")
    except IrregularFileError as error:
        return Problem(shard, "damaged", str(error.strerror))
    except OSError as error:
        return Problem(shard, "damaged", f"it cannot be read ({error.strerror})")
    if found == manifest.sha256:
        return None
    owner = identity(head)
    if owner is not None and owner[1] != manifest.fingerprint:
        reason = f"a file of the data set {owner[1][:12]}, this one is {manifest.fingerprint[:12]}"
        return Problem(shard, "foreign", reason)
    if owner is not None and owner[0] != shard:
        return Problem(shard, "swapped", f"a file of shard {owner[0]:05d}")
    if size != manifest.n_bytes:
        return Problem(shard, "damaged", f"{size:,} bytes instead of {manifest.n_bytes:,}")
    return Problem(shard, "damaged", f"sha256 is {found[:12]} instead of {manifest.sha256[:12]}")


def _is(path: Path, digest: str) -> bool:
    try:
        return file_sha256(path) == digest
    except OSError:
        return False


def _strangers(layout: Layout, present: list[int]) -> Iterator[Problem]:
    """Files among the shards that are not theirs; temporary ones are swept by the next build."""
    if not layout.shards.is_dir():
        return
    names = {path.name for shard in present for path in (layout.shard(shard), layout.manifest(shard))}
    for path in sorted(layout.shards.iterdir()):
        if path.name not in names and not path.name.startswith(TEMPORARY_PREFIX):
            yield Problem(None, "foreign", f"shards/{path.name} is not a file of this data set")
