"""What a search varies."""

import pytest
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.trial import FixedTrial

from nets.config import BEST_DENOISER, BEST_UPDATER, RANGES, Choice, NetworkConfig
from nets.search.space import best_of_paper, described_ranges, distributions, keys, suggested

BEST = {"denoiser": BEST_DENOISER, "updater": BEST_UPDATER}


def test_the_space_is_that_of_the_ranges():
    """No key without a range, no range that neither kind searches."""
    assert set(keys("denoiser")) | set(keys("updater")) == set(RANGES)
    assert set(RANGES) - set(keys("denoiser")) == {"m_dec", "k_dec", "lambda_tv"}
    assert set(RANGES) - set(keys("updater")) == {"c_init"}


@pytest.mark.parametrize("kind", BEST)
def test_limits_and_types_are_those_of_the_ranges(kind):
    for name, found in distributions(kind).items():
        limits = RANGES[name]
        if isinstance(limits, Choice):
            assert isinstance(found, CategoricalDistribution) and found.choices == limits.values
        else:
            assert (found.low, found.high, found.log) == (limits.low, limits.high, limits.is_log)
            is_float = name in ("learning_rate", "lambda_tv")
            assert isinstance(found, FloatDistribution if is_float else IntDistribution)


@pytest.mark.parametrize("kind", BEST)
def test_the_papers_best_is_in_the_space_and_comes_back(kind):
    values = suggested(FixedTrial(best_of_paper(kind)), kind)
    assert NetworkConfig(**values) == BEST[kind]


def test_a_change_of_a_range_is_seen(monkeypatch):
    before = described_ranges("denoiser")
    monkeypatch.setitem(RANGES, "c_init", Choice((1, 2)))
    after = described_ranges("denoiser")
    assert {name for name in before if before[name] != after[name]} == {"c_init"}
    assert distributions("denoiser")["c_init"].choices == (1, 2)
