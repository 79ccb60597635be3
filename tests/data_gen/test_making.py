"""Prints as made: the kernel against float64 for every pattern, glass, ranges, records, and nothing changed when off."""

import hashlib
import math

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from data_gen.config import PATTERN_CONFIGS, DropsConfig, PictureConfig, ReliefConfig, RingsConfig
from data_gen.dataset_config import DatasetConfig, sample_generator
from data_gen.making import Making, draw_making, made_strokes
from data_gen.patterns import draw_strokes, perturb_strokes
from data_gen.reliefs import made_print, printed_relief
from data_gen.samples import Reliefs
from data_gen.variety import PrintVariety, plain_traits
from warp_caustics import Scene
from warp_caustics.prints.path_kernels import PATH_TRAIT_COLUMNS
from warp_caustics.prints.rows import BEGIN, JOINED, RING
from warp_caustics.prints.sections import KINDS

SCENE = Scene(height_samples=48, image_pixels=96)
COARSE = Scene(height_samples=20, image_pixels=40)
PLATE = SCENE.plate_size_m
ALL_OF_IT = Making(
    sections=("cap", "cosine", "quarter", "ellipse", "parabola", "gaussian"),
    exponent=(0.6, 1.6),
    reach=(1.0, 2.0),
    fibre_diameter_m=(3e-4, 6e-4),
    passes=(1, 6),
    overlaps=("sum", "max", "merge"),
    waviness=(0.0, 0.1),
    sideways_m=(0.0, 1e-4),
    end_thickness=(0.0, 0.3),
    bow_m=2e-5,
    base_wave_m=1e-5,
)


def dataset(pattern="lines", making=None, **values):
    if pattern == "picture":
        values["rows"] = ("##.#", "#..#")
    reliefs = PATTERN_CONFIGS[pattern](making=making, **values)
    return DatasetConfig(kind="updater", n_samples=10, scene=SCENE, reliefs=reliefs)


def generator(sample=0, purpose="making"):
    return sample_generator("f" * 64, purpose, sample)


@pytest.mark.parametrize("making", [None, Making(), ALL_OF_IT], ids=["off", "caps", "all"])
@pytest.mark.parametrize("pattern", PATTERN_CONFIGS)
def test_the_kernel_prints_what_the_oracle_prints(pattern, making):
    """Within 20 nm; 2 um where an ellipse stands upright at its edge."""
    config = dataset(pattern, making).model_copy(update={"scene": COARSE})
    reliefs = Reliefs(config, "cpu")
    ids = range(3)
    for sample, found in zip(ids, reliefs.true(ids).double().numpy(), strict=True):
        made = made_print(config, reliefs.fingerprint, sample)
        traits = plain_traits("cosine") if made is None else made.traits
        expected = printed_relief(reliefs.strokes(sample), 20, PLATE, traits)
        is_upright = traits.cross_section.foot_angle_rad(1.0, 1.0) == math.pi / 2
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-6 if is_upright else 2e-8)
        assert np.ptp(expected) > 1e-6


@pytest.mark.gpu
@pytest.mark.parametrize("pattern", PATTERN_CONFIGS)
def test_prints_on_a_gpu(pattern, device):
    config = dataset(pattern, ALL_OF_IT).model_copy(update={"scene": COARSE})
    reliefs = Reliefs(config, device)
    for sample, found in enumerate(reliefs.true(range(4)).double().cpu().numpy()):
        made = made_print(config, reliefs.fingerprint, sample)
        expected = printed_relief(reliefs.strokes(sample), 20, PLATE, made.traits)
        np.testing.assert_allclose(found, expected, rtol=0, atol=4e-6)


def test_lines_of_a_fibre_hold_its_glass():
    """Area of every line, whatever the section, is that of a whole number of passes; caps keep their angle."""
    for sample in range(40):
        making = Making(sections=("cap", "cosine", "gaussian"), fibre_diameter_m=(4e-4, 4e-4), passes=(1, 6))
        made = draw_making(making, PLATE, generator(sample, "traits"))
        drawn = draw_strokes(ReliefConfig(), generator(sample, "relief"))
        (strokes,) = made_strokes([drawn], making, [made], [generator(sample)])
        section = made.traits.cross_section
        passes = section.area_factor() * strokes[:, 5] * strokes[:, 6] / (math.pi / 4 * 4e-4**2)
        np.testing.assert_allclose(passes, passes.round(), rtol=1e-9)
        assert passes.min() >= 0.99 and passes.max() <= 6.01
        angles = 2 * np.arctan(2 * strokes[:, 6] / strokes[:, 5])
        np.testing.assert_allclose(angles, made.traits.contact_angle_rad, rtol=1e-9)
        np.testing.assert_array_equal(strokes[:, :5], drawn[:, :5])


def test_caps_without_a_fibre_take_their_height_from_the_width():
    made = draw_making(Making(passes=(4, 4)), PLATE, generator(0, "traits"))
    drawn = draw_strokes(ReliefConfig(), generator(0, "relief"))
    (strokes,) = made_strokes([drawn], Making(passes=(4, 4)), [made], [generator()])
    np.testing.assert_allclose(strokes[:, 5], 2 * drawn[:, 5])
    np.testing.assert_allclose(strokes[:, 6], np.tan(made.traits.contact_angle_rad / 2) / 2 * strokes[:, 5])
    other = Making(sections=("parabola",), passes=(4, 4))
    made = draw_making(other, PLATE, generator(0, "traits"))
    (strokes,) = made_strokes([drawn], other, [made], [generator()])
    np.testing.assert_allclose(strokes[:, 5:], 2 * drawn[:, 5:])


def test_ranges_are_kept_and_filled():
    drawn = [draw_making(ALL_OF_IT, PLATE, generator(k, "traits")) for k in range(2000)]
    assert {made.traits.section for made in drawn} == set(KINDS)
    for name in ("fibre_diameter_m", "waviness", "sideways_m", "wavelength_m", "end_thickness", "end_length_m"):
        low, high = getattr(ALL_OF_IT, name)
        values = np.array([getattr(made, name) for made in drawn])
        assert low <= values.min() < low + 0.01 * (high - low) and high - 0.01 * (high - low) < values.max() <= high
    angles = [made.traits.contact_angle_rad for made in drawn]
    assert 0.44 <= min(angles) < 0.45 and 1.21 < max(angles) <= 1.22
    merging = np.array([made.traits.merging for made in drawn])
    assert (merging == 1).mean() == pytest.approx(1 / 3, abs=0.05)
    assert np.isinf(merging).mean() == pytest.approx(1 / 3, abs=0.05)
    kept = merging[(merging > 1) & np.isfinite(merging)]
    assert 2 <= kept.min() < 2.1 and 11.5 < kept.max() <= 12
    waves = np.array([made.traits.wave for made in drawn])
    assert 0.99e-5 < waves[:, 0].max() <= 1e-5
    lengths = 2 * np.pi / np.hypot(waves[:, 1], waves[:, 2])
    assert lengths.min() * (1 + 1e-9) >= 0.01 and lengths.max() <= 0.05 * (1 + 1e-9)
    sags = [np.abs(np.linalg.eigvalsh([[xx, xy / 2], [xy / 2, yy]])).max() * 0.025**2 for xx, xy, yy in
            (made.traits.bow for made in drawn)]  # fmt: skip
    assert 1.9e-5 < max(sags) <= 2e-5 * (1 + 1e-9)


def test_a_sample_is_its_own():
    """By its number alone, in any batch, to the bit."""
    for pattern in ("lines", "rings", "text"):
        config = dataset(pattern, ALL_OF_IT)
        reliefs = Reliefs(config, "cpu")
        for sample, strokes in enumerate(reliefs.drawn(range(6))):
            np.testing.assert_array_equal(strokes, reliefs.strokes(sample))
        together = reliefs.true(range(6))
        apart = torch.cat([Reliefs(config, "cpu").true([k]) for k in reversed(range(6))]).flip(0)
        # Padding to the same number of rows moves blocks of nothing only.
        torch.testing.assert_close(together, apart, rtol=0, atol=0)
        assert len({relief.numpy().tobytes() for relief in together}) == 6


def test_every_sample_says_how_it_was_made():
    """What stands in the manifests is what was printed; data sets without making record nothing of it."""
    config = dataset("curves", ALL_OF_IT)
    reliefs = Reliefs(config, "cpu")
    records = reliefs.records(range(5))
    traits = reliefs.traits(range(5)).double().numpy()
    assert traits.shape == (5, len(PATH_TRAIT_COLUMNS))
    np.testing.assert_array_equal(records["print_section"], traits[:, 0])
    np.testing.assert_allclose(records["print_reach"], traits[:, 2], rtol=1e-6)
    np.testing.assert_allclose(records["print_base_wave_m"], traits[:, 7], rtol=1e-6)
    merging = np.where(np.isinf(traits[:, 3]), 0, traits[:, 3])
    np.testing.assert_allclose(records["print_merging"], merging, rtol=1e-6)
    is_cap = traits[:, 0] == KINDS.index("cap")
    np.testing.assert_allclose(np.cos(records["print_contact_angle_rad"])[is_cap], traits[is_cap, 1], rtol=1e-6)
    assert all(np.isfinite(values).all() and len(values) == 5 for values in records.values())
    assert Reliefs(dataset(), "cpu").records(range(5)) == {}
    assert config.canonical()["reliefs"]["making"]["waviness"] == [0.0, 0.1]


def test_lines_of_several_pieces_move_as_one():
    """A perturbed line hangs together: each piece begins where the one before ended, by at most the offsets."""
    for pattern in ("polylines", "curves", "meanders", "text"):
        config = dataset(pattern).reliefs
        strokes = draw_strokes(config, generator(1, "relief"))
        moved, counters = perturb_strokes(strokes, config, generator(1, "perturbation"))
        joined = np.flatnonzero(strokes[:, 0] == JOINED)
        np.testing.assert_allclose(moved[joined, 1:3], moved[joined - 1, 3:5], atol=1e-15)
        assert 0 < np.abs(moved[:, 1:5] - strokes[:, 1:5]).max() <= 2.5e-3
        lines = int((strokes[:, 0] != JOINED).sum())
        assert all(0 <= count <= lines for count in counters.values())
        begins = np.flatnonzero(strokes[:, 0] == BEGIN)
        np.testing.assert_array_equal(moved[begins, 1:3], moved[begins, 3:5])


def test_rings_are_flattened_only_where_they_change():
    still, wavy = Making(fibre_diameter_m=(4e-4, 4e-4)), Making(waviness=(0.05, 0.05))
    drawn = draw_strokes(RingsConfig(), generator(0, "relief"))
    for making, kinds in ((still, {RING}), (wavy, {BEGIN, JOINED})):
        made = draw_making(making, PLATE, generator(0, "traits"))
        bare, both = np.zeros((0, 7)), [generator(), generator()]
        strokes, empty = made_strokes([drawn, bare], making, [made, made], both)
        assert set(strokes[:, 0]) == kinds and empty.shape == (0, 7)
        empty, again = made_strokes([bare, drawn], making, [made, made], [generator(), generator()])
        np.testing.assert_array_equal(again, strokes)
        assert empty.shape == (0, 7)


def test_the_faster_kernel_is_used_where_it_can_be():
    """Straight lines, rings and drops that are added up need no memory for a cell's points."""
    assert not ReliefConfig().has_chains and ReliefConfig().is_plain
    caps = Making(fibre_diameter_m=(4e-4, 4e-4), passes=(1, 6), bow_m=1e-5)
    assert not ReliefConfig(making=caps).has_chains and not ReliefConfig(making=caps).is_plain
    assert not DropsConfig(making=caps).has_chains
    assert ReliefConfig(making=Making(overlaps=("sum", "max"))).has_chains
    assert ReliefConfig(making=Making(end_thickness=(0.0, 0.1))).has_chains
    assert not ReliefConfig(making=Making(bow_m=1e-5)).has_chains


STORED = {
    "lines": ("ac84a8e4a1bfa704", "9ac0f17ac0b6a356", "271400727916fe42"),
    "raster": ("6018d3445fdcd98b", "b9765b8c9f3ca448", "23dd44778cca8c02"),
    "rings": ("bd6d8541a782713e", "f3c5c810de767558", "561934cba0930426"),
    "picture": ("97b1945eb6d7e35a", "84d133600ae4d8b1", "d36605017cbee303"),
    "varied": ("8eede553fc782dde", "a31fc485bae00bd9", "88b020617345068b"),
    "quarter": ("b713a8c2a7db9d84", "f641c71a2b03cec1", "59d3e9f068e42d73"),
}
"""Fingerprints, strokes and perturbed strokes from before prints could be made otherwise."""


@pytest.mark.parametrize("name", STORED)
def test_data_sets_from_before_are_what_they_were(name):
    """Fingerprint, strokes, perturbed strokes: to the bit."""
    kinds = {
        "picture": PictureConfig(rows=("##.#", "#..#")),
        "varied": ReliefConfig(variety=PrintVariety()),
        "quarter": ReliefConfig(profile="quarter"),
    }
    reliefs = kinds.get(name) or PATTERN_CONFIGS[name]()
    config = DatasetConfig(kind="updater", n_samples=10, scene=SCENE, reliefs=reliefs)
    drawn = Reliefs(config, "cpu")
    strokes = [drawn.strokes(k) for k in range(4)]
    moved = [drawn.perturbed_strokes(each, k)[0] for k, each in enumerate(strokes)]
    found = [hashlib.sha256(np.concatenate(each).tobytes()).hexdigest()[:16] for each in (strokes, moved)]
    assert (config.fingerprint()[:16], *found) == STORED[name]
    assert "making" not in config.canonical()["reliefs"]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"contact_angle_rad": (0.5, 1.9)},
            r"contact angle 1\.9 rad, 108\.9 degrees, is above 90: .*overhang.*1\.5707",
        ),
        ({"contact_angle_rad": (0.0, 1.0)}, "contact angle 0 rad; give at least"),
        ({"contact_angle_rad": (1.2, 0.5)}, "lower end 1.2 is above upper end 0.5; swap them"),
        ({"fibre_diameter_m": (0.0, 1e-3)}, "is not above 0"),
        ({"passes": (0, 2)}, "give at least 1"),
        ({"passes": (3, 2)}, "lowest <= highest"),
        ({"passes": (1, 5000)}, "5000 is above 1000"),
        ({"waviness": (0.0, 1.5)}, r"\(0, 1\.5\) of the line; give 0 <= lowest <= highest <= 0\.9"),
        ({"sideways_m": (-0.1, 0.1)}, "below 0; give 0 for none"),
        ({"wavelength_m": (1e-6, 1e-3)}, "1e-06 m is below 0.0005; raise it"),
        ({"sections": ()}, "at least 1"),
        ({"sections": ("square",)}, "cosine"),
        ({"merging": (12.0, 2.0)}, "swap them"),
        ({"bow_m": 0.1}, "less than or equal to 0.001"),
        ({"unknown": 1}, "unknown"),
    ],
)
def test_what_cannot_be_made_is_refused(values, message):
    with pytest.raises(ValidationError, match=message):
        Making(**values)


def test_patterns_that_do_not_fit():
    with pytest.raises(ValidationError, match="variety and making both draw sections"):
        ReliefConfig(making=Making(), variety=PrintVariety())
    with pytest.raises(ValidationError, match="supersampling 16 with lines of several pieces.*8 at most"):
        PATTERN_CONFIGS["curves"](supersampling=16)
    with pytest.raises(ValidationError, match="'a', which the stroke font does not have"):
        PATTERN_CONFIGS["text"](text="abc")
    with pytest.raises(ValidationError, match="give 2 to 16"):
        PATTERN_CONFIGS["curves"](control_count=(1, 4))
