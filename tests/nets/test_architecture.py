"""Networks by name, their size and what is refused."""

import re

import pytest

from nets.architecture import MAX_PARAMETERS, PRESETS, build, parameter_count, parse_architecture
from nets.config import BEST_DENOISER, BEST_UPDATER
from tests.nets.conftest import KINDS, SCENE, SMALL
from warp_caustics.errors import InputError
from warp_caustics.scene import Scene


@pytest.mark.parametrize(
    ("name", "millions"),
    [("paper-denoiser", 6.21), ("paper-updater", 0.265), ("direct-small", 2.05), ("direct", 7.60),
     ("direct-large", 17.5), ("unrolled-small", 2.10), ("unrolled", 7.70)],
)  # fmt: skip
def test_presets_have_the_size_that_is_documented(name, millions):
    assert parameter_count(name, Scene()) / 1e6 == pytest.approx(millions, rel=5e-3)


@pytest.mark.parametrize("name", ["paper-denoiser", "direct", "unrolled"])
def test_shipped_sizes_fit_into_16_megabytes_of_float16(name):
    assert 2 * parameter_count(name, Scene()) < 15.9e6


@pytest.mark.parametrize("kind", list(KINDS))
def test_counting_needs_no_building(kind):
    built = build(KINDS[kind], SCENE)
    assert parameter_count(KINDS[kind], SCENE) == sum(parameter.numel() for parameter in built.parameters())


def test_numbers_of_table_2_choose_their_network():
    assert build(BEST_DENOISER, SCENE).config == PRESETS["paper-denoiser"]
    assert build(BEST_UPDATER, SCENE).config == PRESETS["paper-updater"]


@pytest.mark.parametrize("name", list(PRESETS))
def test_architectures_survive_their_record(name):
    assert parse_architecture(PRESETS[name].model_dump(mode="json")) == PRESETS[name]


def test_unknown_names_are_refused_with_those_known():
    with pytest.raises(InputError, match="'resnet' is not known; use one of paper-denoiser, "):
        build("resnet", SCENE)


def test_corners_of_the_family_that_fit_no_memory_are_refused():
    """Unless refused, this one would ask for 2 TB."""
    largest = SMALL.model_copy(update={"c_init": 32, "m_s": 8, "n_s": 4, "k_down": 11, "k_up": 11, "m_dec": None})
    with pytest.raises(InputError, match=re.escape(f"limit is {MAX_PARAMETERS:.2g}; lower channels")):
        build(largest, SCENE)


def test_a_denoiser_without_channels_is_refused():
    with pytest.raises(InputError, match="needs c_init"):
        build(BEST_DENOISER.model_copy(update={"c_init": None}), SCENE)


@pytest.mark.parametrize("record", [None, {}, {"kind": "gan"}, {"kind": "direct"}, {"kind": "denoiser", "more": 1}, []])
def test_foreign_records_are_refused(record):
    with pytest.raises(InputError):
        parse_architecture(record)
