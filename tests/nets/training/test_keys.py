"""Fresh samples: a function of seed, step and rank; training, validation and test share none."""

import numpy as np
import torch

from data_gen.dataset_config import DatasetConfig, sample_generator
from data_gen.samples import Reliefs
from nets.training.fresh import FreshSource, StrokeStream
from nets.training.keys import batch_ids, fresh_dataset, step_seed
from nets.training.sources import ReplaySource

CPU = torch.device("cpu")


def test_ranks_and_steps_share_no_sample():
    seen = [i for step in range(7) for rank in range(3) for i in batch_ids(step, rank, 3, 5)]
    assert sorted(seen) == list(range(105))


def test_one_process_sees_what_three_see():
    """The global batch of a step does not depend on how many processes share it."""
    for step in range(4):
        parts = [i for rank in range(3) for i in batch_ids(step, rank, 3, 2)]
        assert parts == list(batch_ids(step, 0, 1, 6))


def test_training_validation_and_test_share_no_relief(tiny_run):
    config = tiny_run("direct")
    training = fresh_dataset(config, is_validation=False)
    validation = fresh_dataset(config, is_validation=True)
    tree = training.model_dump()
    test = DatasetConfig.model_validate({**tree, "role": "test"})
    held_out = DatasetConfig.model_validate({**tree, "role": "test", "seed": config.training.validation.seed})
    keys = [d.sample_fingerprint() for d in (training, validation, test, held_out)]
    assert len(set(keys)) == 4
    firsts = {float(sample_generator(key, "relief", sample).random()) for key in keys for sample in range(200)}
    assert len(firsts) == 800


def test_validation_is_the_same_for_all_seeds(tiny_run):
    first, second = (fresh_dataset(tiny_run("direct", seed=s), is_validation=True) for s in (1, 2))
    assert first.sample_fingerprint() == second.sample_fingerprint()


def test_seeds_of_purposes_differ():
    seeds = {step_seed(s, p, k, r) for s in range(3) for p in ("a", "b") for k in range(50) for r in range(2)}
    assert len(seeds) == 600 and all(0 <= seed < 2**63 for seed in seeds)


def test_drawing_ahead_changes_nothing(tiny_run):
    dataset = fresh_dataset(tiny_run("unrolled"), is_validation=False)
    stream, plain = StrokeStream(dataset, CPU, with_start=True), Reliefs(dataset, CPU)
    for step in range(4):
        true, start = stream.reliefs(batch_ids(step, 0, 1, 3), [batch_ids(step + k, 0, 1, 3) for k in (1, 2)])
        assert torch.equal(true, plain.true(batch_ids(step, 0, 1, 3)))
        assert torch.equal(start, plain.perturbed(batch_ids(step, 0, 1, 3))[0])
    stream.close()


def test_photon_variants_keep_their_shares(tiny_run):
    variants = [{"photons_per_pixel": 1.0, "share": 0.75}, {"photons_per_pixel": 2.0, "share": 0.0}]
    config = tiny_run("direct", photons=[*variants, {"placement": "stratified", "share": 0.25}])
    source = FreshSource(config, CPU)
    choices = [source._imager.choice(step, 0) for step in range(400)]
    assert set(choices) == {0, 1}  # the one without a share is never made
    assert abs(np.mean(choices) - 0.25) < 0.08
    source.close()


def test_the_pool_is_simulated_again_on_resume(tiny_run):
    config = tiny_run("unrolled", replay={"size": 14, "fresh_per_step": 2})
    for step in (0, 1, 3, 9):
        straight = ReplaySource(FreshSource(config, CPU), 4)
        for number in range(step + 1):
            expected = straight.batch(number)
        resumed = ReplaySource(FreshSource(config, CPU), 4)
        resumed.resume(step)
        found = resumed.batch(step)
        assert all(torch.equal(found[name], expected[name]) for name in expected)
        if step == 9:
            # Control: without the old samples the batch is another one.
            empty = ReplaySource(FreshSource(config, CPU), 4)
            empty.resume(step)
            for kept in empty.pool.values():
                kept.zero_()
            assert not torch.equal(empty.batch(step)["heights"], expected["heights"])
            empty.close()
        straight.close()
        resumed.close()
