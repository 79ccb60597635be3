"""The network family of Tab. 2."""

import pytest

from nets.config import BEST_DENOISER, BEST_UPDATER, RANGES, NetworkConfig


def test_best_networks_are_those_of_table_2():
    assert BEST_DENOISER.model_dump(exclude_none=True) == {
        "learning_rate": 0.00151, "nonlinearity": "PReLU", "k_down": 5, "k_up": 2, "m_s": 2, "n_s": 4, "c_init": 31,
    }  # fmt: skip
    assert BEST_UPDATER.model_dump(exclude_none=True) == {
        "learning_rate": 0.005155, "nonlinearity": "PReLU", "k_down": 9, "k_up": 9, "m_s": 8, "n_s": 1,
        "m_dec": 8, "k_dec": 4, "lambda_tv": 9.81e-10,
    }  # fmt: skip


def test_every_field_has_a_range():
    assert set(RANGES) == set(NetworkConfig.model_fields)


@pytest.mark.parametrize(
    ("key", "value"),
    [("k_down", 1), ("k_up", 12), ("n_s", 5), ("m_s", 0), ("c_init", 33), ("learning_rate", 0.2), ("m_dec", 12),
     ("k_dec", 3), ("lambda_tv", 1e-3), ("learning_rate", float("nan")), ("nonlinearity", "Tanh")],
)  # fmt: skip
def test_values_outside_the_family_are_refused(key, value):
    values = BEST_UPDATER.model_dump() | {key: value}
    with pytest.raises(ValueError, match=key):
        NetworkConfig.model_validate(values)


@pytest.mark.parametrize(("key", "limits"), [("k_down", (2, 11)), ("c_init", (1, 32)), ("n_s", (1, 4))])
def test_both_ends_of_a_range_belong_to_it(key, limits):
    for value in limits:
        assert getattr(NetworkConfig.model_validate(BEST_UPDATER.model_dump() | {key: value}), key) == value
