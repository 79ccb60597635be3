"""The power fails at any moment: what a disk may hold then, and that a build resumes from each of it."""

import os
import random

from store_synthetic import everything, factory, make_config

from data_gen.store import build, verify
from data_gen.store.layout import Complete, Layout, Manifest, sha256
from warp_caustics.errors import DamagedDataError, InputError
from warp_caustics.io import durable
from warp_caustics.io.durable import SystemCalls

CONFIG = make_config(n_samples=4, samples_per_shard=2)


class Recorder(SystemCalls):
    """Logs what reaches the disk, and when it must have."""

    def __init__(self, syncs=True):
        self.syncs, self.log, self.files, self.contents = syncs, [], {}, {}

    def open(self, path, flags):
        descriptor = super().open(path, flags)
        if flags & os.O_CREAT and path.name != ".lock":
            file = len(self.contents)
            self.contents[file], self.files[descriptor] = b"", file
            self.log.append(("link", str(path), file))
        elif path.is_dir():
            self.files[descriptor] = str(path)
        return descriptor

    def write(self, descriptor, data):
        written = super().write(descriptor, data)
        if isinstance(self.files.get(descriptor), int):
            self.log.append(("write", self.files[descriptor], bytes(data[:written])))
        return written

    def fsync(self, descriptor):
        if self.syncs:
            self.log.append(("sync", self.files[descriptor]))

    def close(self, descriptor):
        self.files.pop(descriptor, None)
        super().close(descriptor)

    def replace(self, source, target):
        super().replace(source, target)
        self.log.append(("rename", str(source), str(target)))


def states_after_power_loss(log, chance, per_prefix):
    """Folder contents that a power failure may leave: for each moment, any of the unsynced operations missing."""
    for length in range(len(log) + 1):
        for attempt in range(per_prefix):
            # Nothing unsynced survives, all of it does, or any part.
            keep = (0.0, 1.0, 0.5)[min(attempt, 2)]
            yield _state(log[:length], chance, keep)


def _state(log, chance, keep):
    names, contents = {}, {}
    for position, (kind, *arguments) in enumerate(log):
        rest = log[position:]
        if kind == "write":
            durable = ("sync", arguments[0]) in rest
            survives = durable or chance.random() < keep
            # Lost data are zeros of the right length or nothing at all.
            lost = bytes(len(arguments[1])) if chance.random() < 0.5 else b""
            contents[arguments[0]] = contents.get(arguments[0], b"") + (arguments[1] if survives else lost)
        elif kind in ("link", "rename"):
            durable = ("sync", os.path.dirname(arguments[0])) in rest
            if durable or chance.random() < keep:
                if kind == "link":
                    names[arguments[0]] = arguments[1]
                elif arguments[0] in names:
                    names[arguments[1]] = names.pop(arguments[0])
            elif kind == "rename":
                names.pop(arguments[0], None)
    return {name: contents.get(file, b"") for name, file in names.items()}


def violations(state, layout):
    """A valid record that does not stand beside what it records."""

    def valid(kind, path):
        try:
            return kind.from_bytes(state[str(path)]) if str(path) in state else None
        except DamagedDataError:
            return None

    count = 0
    for shard in range(CONFIG.n_shards):
        manifest = valid(Manifest, layout.manifest(shard))
        if manifest is not None:
            count += sha256(state.get(str(layout.shard(shard)), b"")) != manifest.sha256
    complete = valid(Complete, layout.complete)
    for entry in complete.entries if complete else ():
        manifest = state.get(str(layout.manifest(entry.shard)), b"")
        count += sha256(manifest) != entry.manifest_sha256
    return count


def recorded_build(monkeypatch, folder, syncs):
    monkeypatch.setattr(durable, "CALLS", recorder := Recorder(syncs))
    build(folder, CONFIG, factory())
    monkeypatch.setattr(durable, "CALLS", SystemCalls())
    return recorder.log


def test_power_failure_at_any_moment(monkeypatch, folder):
    log = recorded_build(monkeypatch, folder, syncs=True)
    whole, layout, chance = everything(folder), Layout(folder), random.Random(3)
    states = list(states_after_power_loss(log, chance, 40))
    assert len(states) > 1000
    assert sum(violations(state, layout) for state in states) == 0
    # Some of them for real: the next build brings the same data set.
    for number, state in enumerate(chance.sample(states, 40)):
        place = folder.with_name(f"after-{number}")
        (place / "shards").mkdir(parents=True)
        for name, data in state.items():
            (place / os.path.relpath(name, folder)).write_bytes(data)
        try:
            build(place, CONFIG, factory(), check="full")
        except InputError:
            # The folder of shards was there before config.json: only possible here, where mkdir is always durable.
            assert not (place / "config.json").exists()
            continue
        assert everything(place) == whole and verify(place).problems == ()


def test_power_failure_without_fsync_is_caught(monkeypatch, folder):
    """Control: the model finds what a publisher that does not sync leaves behind."""
    log = recorded_build(monkeypatch, folder, syncs=False)
    states = states_after_power_loss(log, random.Random(3), 25)
    assert sum(violations(state, Layout(folder)) for state in states) > 10
