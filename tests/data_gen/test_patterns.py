"""Strokes of the print patterns: ranges, clamps, independence of the keys."""

import numpy as np
import pytest

from data_gen.config import PATTERN_CONFIGS, PictureConfig, RasterConfig, ReliefConfig, RingsConfig
from data_gen.dataset_config import DatasetConfig, sample_generator, sample_seed
from data_gen.patterns import RING, STROKE_COLUMNS, draw_strokes, padded, perturb_strokes, picture_rows
from warp_caustics.errors import InputError


def generator(sample=0, purpose="relief"):
    return sample_generator("f" * 64, purpose, sample)


def test_lines_fill_the_ranges_of_tab_3():
    """Number of lines, ends, width and height are uniform in their ranges."""
    drawn = [draw_strokes(ReliefConfig(), generator(k)) for k in range(400)]
    counts = [len(strokes) for strokes in drawn]
    assert min(counts) == 2 and max(counts) == 30
    everything = np.concatenate(drawn)
    assert (everything[:, 0] == 0).all()
    for columns, low, high in ((slice(1, 5), -0.025, 0.025), (5, 1e-4, 4e-3), (6, 1e-4, 2e-3)):
        values = everything[:, columns]
        assert values.min() >= low and values.max() <= high
        # Mean of a uniform distribution, to four standard errors.
        error = (high - low) / np.sqrt(12 * values.size)
        assert abs(values.mean() - (low + high) / 2) < 4 * error * 1.1


def test_a_relief_depends_on_its_number_alone():
    first = draw_strokes(ReliefConfig(), generator(7))
    for k in range(5):
        draw_strokes(ReliefConfig(), generator(k))
    np.testing.assert_array_equal(first, draw_strokes(ReliefConfig(), generator(7)))
    assert first.shape != draw_strokes(ReliefConfig(), generator(8)).shape or not np.allclose(
        first, draw_strokes(ReliefConfig(), generator(8))
    )


def test_perturbation_stays_in_its_ranges_and_clamps():
    """15.3 % of the lines would become non-positive in width or height (Tab. 3)."""
    config = ReliefConfig()
    clamped = strokes = 0
    for k in range(300):
        before = draw_strokes(config, generator(k))
        after, counters = perturb_strokes(before, config, generator(k, "perturbation"))
        assert np.abs(after[:, 1:5] - before[:, 1:5]).max() <= 2.5e-3
        assert np.abs(after[:, 5:] - before[:, 5:]).max() <= 1e-3
        assert after[:, 5].min() >= config.smallest_width_m and after[:, 6].min() >= 0
        assert counters["missing_strokes"] == int((after[:, 6] == 0).sum())
        clamped += counters["missing_strokes"] + counters["narrow_strokes"]
        strokes += len(before)
    assert 0.12 < clamped / strokes < 0.20


def test_raster_is_parallel_and_evenly_spaced():
    strokes = draw_strokes(RasterConfig(line_count=(5, 5)), generator())
    along = strokes[:, 3:5] - strokes[:, 1:3]
    np.testing.assert_allclose(along, np.repeat(along[:1], 5, axis=0), atol=1e-15)
    steps = np.diff((strokes[:, 1:3] + strokes[:, 3:5]) / 2, axis=0)
    np.testing.assert_allclose(steps, np.repeat(steps[:1], 4, axis=0), atol=1e-15)
    assert abs(float(steps[0] @ along[0])) < 1e-12
    assert len(set(strokes[:, 5])) == 1


def test_rings():
    strokes = draw_strokes(RingsConfig(), generator())
    assert (strokes[:, 0] == RING).all() and (strokes[:, 3] >= 1e-3).all()
    after, _ = perturb_strokes(strokes, RingsConfig(), generator(purpose="perturbation"))
    assert (after[:, 4] == 0).all() and (after[:, 3] >= 0).all()


def test_picture_prints_runs_of_cells():
    """Top row first; two runs in the first row, one in the second."""
    config = PictureConfig(rows=("##.#", "####"), size_m=(0.04, 0.04), centre_m=(0.0, 0.0))
    strokes = draw_strokes(config, generator())
    np.testing.assert_allclose(
        strokes[:, 1:5],
        [[-0.015, 0.005, -0.005, 0.005], [0.015, 0.005, 0.015, 0.005], [-0.015, -0.005, 0.015, -0.005]],
        atol=1e-15,
    )


def test_picture_rows_of_an_image():
    """Dark is fibre; rows keep the picture's order."""
    image = np.full((40, 80), 255, dtype=np.uint8)
    image[:20, :40] = 10
    assert picture_rows(image, rows=4) == ("####....",) * 2 + ("........",) * 2
    for bad in (np.zeros((4, 4)), np.zeros((4, 4, 3)), np.full((4, 4), np.nan)):
        with pytest.raises(InputError):
            picture_rows(bad)


@pytest.mark.parametrize("rows", [(), ("",), ("#", "##"), ("#a",)])
def test_bad_pictures_are_refused(rows):
    with pytest.raises(ValueError):
        PictureConfig(rows=rows)


def test_pattern_is_chosen_by_its_field():
    """lines where the field is missing."""
    assert isinstance(DatasetConfig(kind="updater", n_samples=1, reliefs={}).reliefs, ReliefConfig)
    for name, kind in PATTERN_CONFIGS.items():
        config = DatasetConfig.model_validate({"kind": "updater", "n_samples": 1, "reliefs": {"pattern": name}})
        assert type(config.reliefs) is kind
    with pytest.raises(ValueError, match="pattern|spiral"):
        DatasetConfig.model_validate({"kind": "updater", "n_samples": 1, "reliefs": {"pattern": "spiral"}})


def test_padding_prints_nothing():
    batch = padded([draw_strokes(ReliefConfig(), generator(k)) for k in range(3)] + [np.zeros((0, 7))])
    assert batch.shape[2] == len(STROKE_COLUMNS)
    assert (batch[3, :, 6] == 0).all()


def test_keys_have_nothing_in_common():
    """Neighbouring samples, purposes and data sets give different seeds."""
    fingerprints = [DatasetConfig(kind="updater", n_samples=5, seed=s).sample_fingerprint() for s in (5, 2**32 + 5)]
    seeds = {
        sample_seed(fingerprint, purpose, sample)
        for fingerprint in fingerprints
        for purpose in ("photons/noisy", "photons/clean", "relief")
        for sample in range(200)
    }
    assert len(seeds) == 2 * 3 * 200
    assert all(0 <= seed < 2**63 for seed in seeds)
