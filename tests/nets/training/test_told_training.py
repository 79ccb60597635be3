"""Training on benches that differ, and what the network is told of them."""

import math
import shutil

import pydantic
import pytest
import torch

from data_gen.benches.bench_set import Benches
from data_gen.samples import BenchReliefs
from nets.architecture import build
from nets.flat_light import FlatLight
from nets.symmetries import all_symmetries, transformed
from nets.told import ToldTable, bench_values, dropped
from nets.told import turned as turned_values
from nets.training.bench_stream import BenchStream
from nets.training.camera import draw_cameras, seen
from nets.training.checkpoint import load_checkpoint
from nets.training.config import CameraConfig, RunConfig
from nets.training.keys import fresh_dataset
from nets.training.sources import make_source
from nets.training.telling import Teller, with_camera
from nets.training.told_config import ToldConfig
from nets.training.told_task import ToldTask
from nets.training.weights import load_initial_weights
from nets.weights import load_weights
from tests.nets.training.test_resume import differences, everything
from warp_caustics.errors import MismatchError
from warp_caustics.scene import Scene

CPU = torch.device("cpu")


def test_samples_are_those_of_benches_by_number(told_run):
    config = told_run(batch_size=6, scene_share=0.0)
    source = make_source(config, CPU)
    try:
        batch = source.batch(0)
        again = make_source(config, CPU)
        again.batch(3)
        assert all(torch.equal(values, again.batch(0)[name]) for name, values in batch.items())
        again.close()
    finally:
        source.close()
    benches = Benches(fresh_dataset(config, is_validation=False))
    drawn = benches.draw(range(6))
    scenes = benches.scenes(drawn)
    assert torch.equal(batch["bench"], torch.tensor([bench_values(scene) for scene in scenes]))
    assert torch.equal(batch["heights"], BenchReliefs(benches).true(range(6)))
    level = FlatLight(ToldTable(config.scene)).level(batch["bench"])
    light = benches.light(batch["heights"], drawn)
    assert (batch["image"] * level - light).norm() < 0.1 * light.norm()
    assert len({scene.is_collimated for scene in scenes}) == 2


def test_memory_of_a_pool_is_what_is_announced(told_run):
    source = make_source(told_run(batch_size=2, replay={"size": 4, "fresh_per_step": 2}), CPU)
    try:
        source.batch(0)
        assert sum(values.numel() * values.element_size() for values in source.pool.values()) == source.bytes_needed
    finally:
        source.close()


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_gpu_makes_the_same_samples(told_run):
    config, device = told_run(batch_size=8), torch.device("cuda")
    sources = [make_source(config, each) for each in (CPU, device)]
    try:
        for name, values in sources[0].batch(1).items():
            found = sources[1].batch(1)[name].cpu()
            assert (found - values).norm() < (1e-2 if name == "image" else 1e-5) * values.norm()
    finally:
        for source in sources:
            source.close()


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_step_waits_for_no_gpu(told_run):
    config, device = told_run(batch_size=8), torch.device("cuda")
    source = make_source(config, device)
    batch = source.batch(0)
    source.close()
    task = ToldTask(config, device)
    network = build(config.network, config.scene).to(device)
    task.loss(network, batch, 0, 0.0).backward()
    try:
        torch.cuda.set_sync_debug_mode("error")
        loss = task.loss(network, batch, 1, 0.0)
        loss.backward()
        with pytest.raises(RuntimeError, match="synchroniz"):
            loss.item()  # control: what waits is found
    finally:
        torch.cuda.set_sync_debug_mode("default")


def test_a_share_is_on_the_scene_itself(told_run):
    config = told_run()
    dataset = fresh_dataset(config, is_validation=False)
    own = torch.tensor(bench_values(config.scene))
    for share, least, most in ((0.0, 0, 0), (0.3, 5, 30), (1.0, 48, 48)):
        stream = BenchStream(dataset, CPU, share)
        values = stream(range(48)).values
        stream.close()
        assert least <= (values == own).all(dim=1).sum() <= most


def lamp_at_half_a_metre(table, count):
    true = table.centre.expand(count, -1).clone()
    true[:, table.place("divergence_1_m")], true[:, -2:] = 2.0, torch.tensor([1.0, 0.05])
    return true


def test_what_is_told_has_errors_and_gaps():
    table = ToldTable(Scene())
    config = ToldConfig(care=(1, 1), unsaid_lamp_share=0)
    count = 20_000
    true = lamp_at_half_a_metre(table, count)
    told = Teller(config, table).drawn(true, torch.Generator().manual_seed(0))
    inexact = (told.values != true).any(dim=1)
    assert inexact.float().mean() == pytest.approx(0.75, abs=0.02)
    error = (told.values - true)[inexact].std(dim=0)
    place = table.place
    for name, width in (("base_thickness_m", 3e-5), ("index", 7e-4), ("light_x", 2e-3), ("divergence_1_m", 0.06)):
        assert error[place(name)] == pytest.approx(width, rel=0.05)
    assert (told.values[:, place("gap_m")] >= 0).all()
    relative = ((told.values - true) / true)[:, [place("dispersion_0"), place("dispersion_2")]]
    assert torch.allclose(relative[:, 0], relative[:, 1], atol=1e-3) and relative.std() > 0.005
    nothing = (told.known == 0).all(dim=1).float().mean()
    assert nothing == pytest.approx(0.05 + 0.95 * 0.08**7 * 0.25, abs=0.01)
    shares = torch.tensor([0.92] * 9 + [0.5] * 2) * 0.95
    assert told.known.mean(dim=0) == pytest.approx(shares, abs=0.02)
    assert torch.equal(told.known[:, place("light_x")], told.known[:, place("light_y")])


def test_some_measure_and_others_remember():
    table = ToldTable(Scene())
    true = lamp_at_half_a_metre(table, 40_000)
    told = Teller(ToldConfig(exact_share=0, unsaid_lamp_share=0), table).drawn(true, torch.Generator().manual_seed(3))
    relative = (told.values - true)[:, table.place("index")] / 7e-4
    # Of a factor x whose logarithm is uniform from a to b the mean square is (b^2 - a^2) / (2 log(b / a)).
    assert relative.square().mean().sqrt() == pytest.approx((16 / (2 * math.log(40))) ** 0.5, rel=0.03)
    small, large = (relative.abs() < 0.05).float().mean(), (relative.abs() > 5).float().mean()
    normal = torch.randn(40_000, generator=torch.Generator().manual_seed(4)).abs()
    assert small > 2.5 * (normal < 0.05).float().mean() and large > 0.01


def test_a_lamp_that_nobody_told_is_that_of_the_scene():
    table = ToldTable(Scene())
    true = lamp_at_half_a_metre(table, 4_000)
    options = ToldConfig(unsaid_lamp_share=0.25, exact_share=1, unknown_share=0, nothing_share=0)
    told = Teller(options, table).drawn(true, torch.Generator().manual_seed(5))
    unsaid = told.values[:, table.place("divergence_1_m")] == 0
    assert unsaid.float().mean() == pytest.approx(0.25, abs=0.03)
    assert torch.equal(told.values[unsaid, :-2], table.centre.expand(len(true), -1)[unsaid, :-2])
    assert (told.known[unsaid, :-2] == 1).all()


def test_told_errors_move_the_picture_alike(told_run):
    """One resampling of camera and placement is the two one after the other."""
    config = told_run(batch_size=4)
    source = make_source(config, CPU)
    batch = source.batch(0)
    source.close()
    task = ToldTask(config, CPU)
    options = CameraConfig(unevenness=0, ambient=0, mixing=0, noise=0, clean_noise=0, gain=0, exposure=0)
    camera = draw_cameras(options, 4, 3, torch.Generator().manual_seed(1))
    values, flat = with_camera(batch["bench"], camera), task.flat
    values[:, task.table.place("divergence_1_m")] = 4.0
    generator = torch.Generator().manual_seed(2)
    once = seen(batch["image"], flat, camera, generator, task.light.places(values))
    twice = task.light.rectified(seen(batch["image"], flat, camera, generator), values)
    inner = slice(4, -4)
    moved = (once - batch["image"])[..., inner, inner].norm()
    assert (once - twice)[..., inner, inner].norm() < 0.15 * moved and moved > 0.01 * once.norm()


def test_plates_and_benches_turn_together(told_run):
    """Turned and then moved is moved and then turned."""
    config = told_run(batch_size=8)
    source = make_source(config, CPU)
    batch = source.batch(0)
    source.close()
    task = ToldTask(config, CPU)
    turned = task.turned(batch, 5)
    known = torch.ones(8, 11)
    one = dropped(with_camera(turned["bench"], None), known, task.table)
    moved = [task.light.rectified(part["image"], with_camera(part["bench"], None)) for part in (batch, turned)]
    found = 0
    for row in range(8):
        for symmetry in all_symmetries(config.scene).T:
            both = symmetry[:, None]
            if torch.equal(transformed(batch["heights"][row : row + 1], both)[0], turned["heights"][row]):
                values = turned_values(batch["bench"][row : row + 1], both, task.table)
                assert torch.equal(values[0], turned["bench"][row])
                expected = transformed(moved[0][row : row + 1], both)[0]
                assert (expected - moved[1][row]).abs().max() < 1e-3 * expected.abs().max()
                found += 1
    assert found == 8 and torch.isfinite(one).all()


def test_a_run_judges_and_records(told_run, train, tmp_path):
    config = told_run(total_steps=3, steps_per_epoch=3, replay={"size": 8, "fresh_per_step": 2})
    result = train(config, tmp_path / "run", pictures=True)
    names = {"val_rmse_um", "val_median_rmse_um", "val_unknown_rmse_um", "val_default_rmse_um", "val_perfect_rmse_um"}
    assert names <= result.validation.keys() and result.objective == "val_rmse_um"
    loaded = load_weights(result.weights)
    assert loaded.module.is_told and loaded.info.training["config"]["bench"]["set_up"]["tilt_rad"] == [0.0, 0.03]


def test_a_resumed_run_is_the_same_to_the_bit(told_run, train, tmp_path):
    config = told_run(
        total_steps=6, steps_per_epoch=2, batch_size=2, validation={"count": 2}, replay={"size": 6, "fresh_per_step": 1}
    )
    train(config, tmp_path / "whole")
    train(config, tmp_path / "parts", max_steps=3)
    train(config, tmp_path / "parts", resume=True)
    assert differences(everything(tmp_path / "whole"), everything(tmp_path / "parts")) == []
    saved = load_checkpoint(tmp_path / "whole" / "checkpoints" / "last.ckpt")
    film = [value for name, value in saved["network"].items() if "film" in name]
    assert any(value.any() for value in film)
    other = config.model_copy(update={"training": config.training.model_copy(update={"scene_share": 0.5})})
    shutil.copytree(tmp_path / "whole", tmp_path / "other")
    with pytest.raises(MismatchError, match=r"training\.scene_share differs"):
        train(other, tmp_path / "other", resume=True)


def test_it_starts_from_weights_that_know_nothing_of_benches(tiny_run, told_run, train, tmp_path):
    first = train(tiny_run("direct", total_steps=2, steps_per_epoch=2), tmp_path / "first")
    config = told_run(total_steps=1, steps_per_epoch=1)
    second = train(config.model_copy(update={"initial_weights": first.weights}), tmp_path / "second")
    info = load_weights(second.weights).info
    assert info.training["initial_weights"] == load_weights(first.weights).info.content_hash
    before, after = (load_weights(path).module.state_dict() for path in (first.weights, second.weights))
    assert (before["stem.weight"] - after["stem.weight"]).abs().max() < 0.01
    # Not the other way round: what was learned of benches would be lost in silence.
    third = tiny_run("direct", total_steps=1).model_copy(update={"initial_weights": second.weights})
    with pytest.raises(MismatchError, match="another architecture"):
        train(third, tmp_path / "third")


def told_by(config, way):
    return config.model_copy(update={"network": config.network.model_copy(update={"told_by": way, "feedback": False})})


@pytest.mark.parametrize(("way", "own"), [("film", "film"), ("maps", "maps"), ("picture", None)])
def test_each_way_to_be_told_starts_from_weights_without(tiny_run, told_run, train, tmp_path, way, own):
    """Untold ones and ones told by their picture alone: the fresh weights answer as these did, and are trained."""
    first = train(tiny_run("direct", total_steps=2, steps_per_epoch=2), tmp_path / "first")
    config = told_run(total_steps=1, steps_per_epoch=1, ema_decay=0.0)
    nearest = train(told_by(config, "picture").model_copy(update={"initial_weights": first.weights}), tmp_path / "near")
    image, told = torch.rand(2, 3, 64, 64), torch.randn(2, 22)
    for path in (first.weights, nearest.weights):
        network = build(told_by(config, way).network, config.scene)
        load_initial_weights(path, network, config.scene, starts_flat=False)
        assert torch.equal(network(image, told), load_weights(path).module(image))
    result = train(told_by(config, way).model_copy(update={"initial_weights": nearest.weights}), tmp_path / "run")
    loaded = load_weights(result.weights)
    assert loaded.info.architecture.told_by == way and loaded.module.is_told
    moved = [name for name, values in loaded.module.state_dict().items() if own and own in name and values.any()]
    assert bool(moved) == (own is not None)
    # Not from one way to another, in which what was learned of benches would be lost in silence.
    other = {"film": "maps", "maps": "film", "picture": None}[way]
    if other is not None:
        with pytest.raises(MismatchError, match="another architecture"):
            train(told_by(config, other).model_copy(update={"initial_weights": result.weights}), tmp_path / "other")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"network": {"backbone": {"conditions": 0}}}, "set network.backbone.conditions to 11"),
        ({"training": {"bench": None, "scene_share": 0.0}}, r"conditions is 11, but all samples are on one bench"),
        ({"training": {"bench": None}}, r"scene_share is 0.3, but all samples are on the scene"),
        ({"training": {"bench": {"camera": {"psf_px": [0, 1]}}}}, r"bench.camera is not used"),
        ({"training": {"bench": {"set_up": {"gap_offset_m": [-1, 0]}}}}, "puts the screen inside the plate"),
        ({"data": "folder"}, "training.bench is for fresh samples of a direct network"),
    ],
)
def test_what_does_not_go_together_is_refused(told_run, changes, message):
    tree = told_run().model_dump(mode="json")
    for section, values in changes.items():
        if section == "network":
            tree["network"]["backbone"] |= values["backbone"]
        elif section == "training":
            tree["training"] |= values
        else:
            tree[section] = values
    with pytest.raises(pydantic.ValidationError, match=message):
        RunConfig.model_validate(tree)
