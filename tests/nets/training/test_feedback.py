"""A network in training that is given its own answers."""

import pydantic
import pytest
import torch

from nets.architecture import architecture_record, build, parse_architecture
from nets.symmetries import all_symmetries, transformed
from nets.told import bench_values
from nets.told_scene import told_scene
from nets.training.batch import Batch
from nets.training.bench_stream import BenchStream
from nets.training.feedback import Echoes, ToldAhead
from nets.training.keys import fresh_dataset
from nets.training.seeing import Given, Viewer
from nets.training.sources import make_source
from nets.training.told_task import ToldTask
from nets.training.weights import load_initial_weights
from nets.weights import save_weights
from warp_caustics.scene import Scene

CPU = torch.device("cpu")


@pytest.fixture
def looking_run(told_run):
    """A run of a network with feedback."""

    def make(**training):
        options = {"batch_size": 4, "replay": {"size": 16, "fresh_per_step": 4}} | training
        config = told_run(**options)
        return type(config).model_validate(
            config.model_dump() | {"network": config.network.model_copy(update={"feedback": True})}
        )

    return make


def test_a_scene_of_numbers_has_these_numbers(told_run):
    dataset = fresh_dataset(told_run(), is_validation=False)
    stream = BenchStream(dataset, CPU, 0.2)
    plates = stream(range(40))
    stream.close()
    assert {scene.is_collimated for scene in plates.scenes} == {True, False}
    for scene, values in zip(plates.scenes, plates.values.tolist(), strict=True):
        believed = told_scene(dataset.scene, values)
        assert bench_values(believed) == pytest.approx(values, rel=1e-5, abs=1e-9)
        assert believed.screen_position_m == pytest.approx(scene.screen_position_m, abs=1e-7)
        assert believed.lamp_radius_m == pytest.approx(scene.lamp_radius_m, abs=1e-7)
        assert believed.emission_half_angle_rad == pytest.approx(scene.emission_half_angle_rad, rel=1e-4)


def test_a_scene_with_light_of_its_own_comes_back():
    tilted = Scene(light_tilt_rad=(0.01, -0.02))
    near = Scene(light_position_m=(0.01, 0.02, 0.4), emission_half_angle_rad=0.2)
    for scene in (tilted, near):
        assert bench_values(told_scene(scene, list(bench_values(scene)))) == pytest.approx(
            bench_values(scene), rel=1e-6, abs=1e-9
        )


def random_batch(config, count=2) -> Batch:
    scene = config.scene
    generator = torch.Generator().manual_seed(1)
    image = 1 + 0.3 * torch.rand(
        count, scene.n_wavelengths, scene.image_pixels, scene.image_pixels, generator=generator
    )
    return {"image": image, "told": torch.rand(count, 2 * 11, generator=generator)}


def test_feedback_begins_as_nothing_and_a_first_look_is_one_at_a_flat_plate(told_run, looking_run, tmp_path):
    without, config = told_run(), looking_run()
    torch.manual_seed(0)
    plain = build(without.network, without.scene)
    torch.nn.init.normal_(plain.head.conv.weight, std=0.1)
    save_weights(tmp_path / "w.safetensors", plain, scene=without.scene, data_fingerprint="", training={})
    network = build(config.network, config.scene)
    load_initial_weights(str(tmp_path / "w.safetensors"), network, config.scene, starts_flat=False)
    given = random_batch(config)
    n = config.scene.height_samples
    answer, echo = 1e-3 * torch.rand(2, n, n), 2 * given["image"].flip(0)
    with torch.no_grad():
        before = plain(given["image"], given["told"])
        assert before.abs().max() > 1e-5
        assert torch.equal(network(given["image"], given["told"]), before)
        assert torch.equal(network(given["image"], given["told"], answer, echo), before)
        # A network that has learned to look.
        torch.nn.init.normal_(network.look.weight, std=0.1)
        torch.nn.init.normal_(network.keep.conv.weight, std=0.1)
        first = network(given["image"], given["told"])
        flat = network.flat.expand_as(given["image"])
        assert torch.allclose(network(given["image"], given["told"], 0 * answer, flat), first, atol=1e-9)
        for one in (network(given["image"], given["told"], answer, flat),
                    network(given["image"], given["told"], 0 * answer, echo)):  # fmt: skip
            assert (one - first).abs().max() > 1e-5


def test_a_network_that_only_keeps_gives_back_what_it_is_given(looking_run):
    config = looking_run()
    network = build(config.network, config.scene)
    network.keep.conv.bias.data.fill_(1.0)
    given = random_batch(config)
    answer = 1e-3 * torch.rand(2, config.scene.height_samples, config.scene.height_samples)
    with torch.no_grad():
        assert torch.allclose(network(given["image"], given["told"], answer, given["image"]), answer, atol=1e-9)


def test_older_files_know_nothing_of_it(told_run, looking_run):
    old, new = told_run().network, looking_run().network
    assert "feedback" not in architecture_record(old) and architecture_record(new)["feedback"] is True
    assert parse_architecture(architecture_record(old)) == old
    assert parse_architecture(architecture_record(new)) == new


def test_the_echo_of_the_truth_is_the_image(looking_run):
    """Heights and bench as they are give what a perfect camera sees, moved and levelled alike."""
    config = looking_run(scene_share=0.0, photons=[{"share": 1.0, "photons_per_pixel": 16}])
    config = config.model_copy(update={"training": config.training.model_copy(update={"camera": None})})
    source, viewer = make_source(config, CPU), Viewer(config, CPU)
    batch = source.validation()[0]
    source.close()
    known = torch.ones(len(batch["bench"]), len(viewer.table))
    seen = viewer.seen(batch["image"], batch["bench"], torch.Generator(), None, known)
    scenes = [told_scene(config.scene, values) for values in seen.values.tolist()]
    echo = Echoes(config, CPU, viewer)(seen, batch["heights"] / seen.scale, scenes)
    flat = viewer.flat.expand_as(echo)
    own, other = (echo - seen.image).norm(), (flat - seen.image).norm()
    assert own < 0.15 * other  # coarse photons, and Fresnel's losses, which nobody is told


def test_a_pool_keeps_answers_and_what_was_told(looking_run):
    config = looking_run(feedback={"share": 1.0, "twice_share": 0.0})
    source = make_source(config, CPU)
    asked = []

    def network(image, told, *before):
        asked.append(len(before))
        return torch.full((len(image), 16, 16), 1e-4)

    source.network = network
    try:
        batch = source.batch(0)
        assert sum(values.numel() * values.element_size() for values in source.pool.values()) == source.bytes_needed
        given = Given.of(batch)
        assert given is not None and asked and set(asked) == {2}
        assert (given.answer == 1e-4).all() and (given.is_given == 1).all()
        told = ToldAhead(config)
        stream = BenchStream(fresh_dataset(config, is_validation=False), CPU, config.training.scene_share, told)
        plates = stream(source.fresh.ids(0))
        stream.close()
        assert torch.equal(source.pool["told"][:4], plates.told.told)
        assert torch.equal(source.pool["known"][:4], plates.told.known)
        # What a visit tells is what was told with the answer; of the camera what is drawn now.
        viewer = Viewer(config, CPU)
        one, other = (
            viewer.seen(
                batch["image"], batch["bench"], *(torch.Generator().manual_seed(s) for s in (s, s)), given=given
            )
            for s in (1, 2)
        )
        count = len(viewer.table)
        scene = [*range(count - 2), *range(count, 2 * count - 2)]
        assert torch.equal(one.told[:, scene], other.told[:, scene])
        assert not torch.equal(one.told, other.told) and not torch.equal(one.image, other.image)
    finally:
        source.close()


def test_shares_of_looks(looking_run):
    from nets.training.feedback import Feedback

    feedback = Feedback(looking_run(feedback={"share": 0.4, "twice_share": 0.5}), CPU)
    looks = [feedback.looks(round_) for round_ in range(2000)]
    assert looks.count(1) / 2000 == pytest.approx(0.2, abs=0.03)
    assert looks.count(2) / 2000 == pytest.approx(0.2, abs=0.03)


def test_answers_turn_with_their_plates(looking_run):
    """The loss of a turned batch is that of the batch, for a network that is blind to turns."""
    config = looking_run(feedback={"share": 1.0, "twice_share": 0.0})
    source = make_source(config, CPU)
    source.network = lambda image, told, *before: image.mean(dim=1)[:, ::4, ::4] * 1e-4
    batch = source.batch(0)
    source.close()
    task = ToldTask(config, CPU)
    turned = task.turned(batch, 3)
    from nets.symmetries import draw_symmetries

    symmetries = draw_symmetries(4, config.scene, task.generator("symmetries", 3))
    assert torch.equal(turned["echo"], transformed(batch["echo"], symmetries))
    assert torch.equal(turned["answer"], transformed(batch["answer"], symmetries))
    assert torch.equal(turned["is_given"], batch["is_given"])
    x = task.table.x
    assert torch.equal(turned["told"][:, x].abs() + turned["told"][:, x + 1].abs(),
                       batch["told"][:, x].abs() + batch["told"][:, x + 1].abs())  # fmt: skip
    assert len(all_symmetries(config.scene).T) == 8


def test_it_trains_and_says_how_the_second_look_is(looking_run, train, tmp_path):
    config = looking_run(steps_per_epoch=4, validation={"count": 4})
    result = train(config, tmp_path / "run", max_steps=4)
    found = result.validation
    assert found["val_second_rmse_um"] > 0 and found["val_default_second_rmse_um"] > 0
    # Without a pool as well.
    bare = looking_run(steps_per_epoch=2, validation={"count": 4}, replay={"size": 0})
    assert train(bare, tmp_path / "bare", max_steps=2).step == 2


def test_feedback_needs_a_network_that_is_told(tiny_run):
    with pytest.raises(pydantic.ValidationError, match=r"backbone\.conditions"):
        tiny_run("direct", network={"feedback": True})


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_round_waits_for_no_gpu(looking_run):
    config, device = looking_run(feedback={"share": 1.0, "twice_share": 0.5}), torch.device("cuda")
    source = make_source(config, device)
    network = build(config.network, config.scene).to(device).eval()
    source.network = torch.no_grad()(network.forward)
    for step in range(4):
        source.batch(step)
    try:
        torch.cuda.set_sync_debug_mode("error")
        batch = source.batch(4)
        with pytest.raises(RuntimeError, match="synchroniz"):
            float(batch["answer"].sum())  # control: what waits is found
    finally:
        torch.cuda.set_sync_debug_mode("default")
        source.close()
