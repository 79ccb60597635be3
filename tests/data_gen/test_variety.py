"""Prints that differ: closed forms of the sections, the kernel against the float64 oracle, and the traits drawn."""

import numpy as np
import pytest
import torch

from data_gen.config import ReliefConfig, RingsConfig
from data_gen.dataset_config import DatasetConfig, sample_generator
from data_gen.patterns import draw_strokes, padded
from data_gen.reliefs import print_strokes, printed_relief, traits_of
from data_gen.samples import Reliefs
from data_gen.variety import PrintTraits, PrintVariety, draw_traits, merged, plain_traits
from warp_caustics import Scene
from warp_caustics.errors import InputError
from warp_caustics.prints.line import FAMILIES, SECTIONS, line_profile, section_height

SCENE = Scene(height_samples=48, image_pixels=96)
PLATE = SCENE.plate_size_m
VARIED = ReliefConfig(variety=PrintVariety())
T = np.linspace(0, 1, 501)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.6])
@pytest.mark.parametrize("section", FAMILIES)
def test_sections_fall_from_the_crown_to_the_edge(section, exponent):
    height = section_height(T, section, exponent)
    assert height[0] == pytest.approx(1.0) and height[-1] == 0.0
    assert (np.diff(height) <= 0).all()
    assert not section_height(np.array([1.0, 1.5]), section, exponent).any()


def test_sections_are_those_they_are_called():
    """Area under each in units of w H: raised cosine 1/2, quarter 2/pi, ellipse pi/4, parabola 2/3."""
    areas = {("cosine", 1.0): 1 / 2, ("cosine", 0.5): 2 / np.pi, ("parabola", 0.5): np.pi / 4, ("parabola", 1.0): 2 / 3}
    fine = (np.arange(200_000) + 0.5) / 200_000
    for (section, exponent), area in areas.items():
        assert section_height(fine, section, exponent).mean() == pytest.approx(area, rel=1e-4)
    # With g = 1 the Gaussian is half as high at half the way, but for what is taken off at the edge.
    assert section_height(np.array([0.5]), "gaussian", 1.0)[0] == pytest.approx((0.5 - 1 / 16) / (1 - 1 / 16))
    for profile in SECTIONS:
        plain = plain_traits(profile)
        np.testing.assert_allclose(
            2e-3 * section_height(T, plain.section, plain.exponent), line_profile(T / 2, 1.0, 2e-3, profile), atol=1e-12
        )


def test_feet_of_a_gaussian_line_go_on_beyond_its_width():
    """Out to e, where they meet the plate; within the width a long foot is the plain exponential."""
    t = np.array([0.0, 0.5, 1.0, 1.9, 2.0])
    height = section_height(t, "gaussian", 0.7, 2.0)
    k = 4 * np.log(2) * 0.7
    np.testing.assert_allclose(height[:4], np.exp(-k * t[:4] ** 2), atol=np.exp(-4 * k))
    assert height[3] > 0 and height[4] == 0


def test_merging_lies_between_sum_and_maximum():
    heights = np.array([[1e-3, 1e-3, 0.0], [1e-3, 2e-4, 0.0]])
    added, merging, highest = merged(heights, 1.0), merged(heights, 4.0), heights.max(axis=0)
    assert (merging <= added).all() and (merging >= highest).all() and merging[2] == 0
    assert merging[0] == pytest.approx(2**0.25 * 1e-3)


@pytest.mark.parametrize("exponent", [0.5, 1.3])
@pytest.mark.parametrize("merging", [1.0, 2.0, 12.0])
@pytest.mark.parametrize("section", FAMILIES)
def test_the_kernel_prints_what_the_oracle_prints(section, merging, exponent):
    """Within 0.05 um of reliefs of millimetres; 1 um where an ellipse stands upright at its edge, or p is 12."""
    traits = PrintTraits(section, exponent, 1.7 if section == "gaussian" else 1.0, merging, (2e-2, -1e-2, 3e-2))
    row = torch.tensor([traits.row()], dtype=torch.float32)
    for config in (VARIED, RingsConfig(variety=PrintVariety())):
        strokes = draw_strokes(config, sample_generator("0" * 64, "relief", 3))
        found = print_strokes(torch.from_numpy(padded([strokes])), SCENE, config, row)[0].double().numpy()
        expected = printed_relief(strokes, 48, PLATE, traits)
        is_steep = exponent == 0.5 or merging > 2
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 if is_steep else 5e-8)
        plain = printed_relief(strokes, 48, PLATE, PrintTraits())
        assert np.abs(expected - plain).max() > 1e-5, "these traits would not be tested"


def test_the_bow_has_the_sag_it_says():
    """From the centre to the middle of a side at most the largest sag, and no fibre is needed for it."""
    variety = PrintVariety(section_share=0, merging_share=0, bow_share=1, bow_m=30e-6)
    half, sags = PLATE[0] / 2, []
    for sample in range(200):
        xx, xy, yy = draw_traits(variety, PrintTraits(), PLATE, sample_generator("0" * 64, "traits", sample)).bow
        strongest = np.abs(np.linalg.eigvalsh([[xx, xy / 2], [xy / 2, yy]])).max()
        sags.append(strongest * half**2)
    assert 28e-6 < max(sags) <= 30e-6 * (1 + 1e-9)
    bare = printed_relief(np.zeros((0, 7)), 48, PLATE, PrintTraits(bow=(1e-2, 0.0, 0.0)))
    assert bare.max() == pytest.approx(1e-2 * (half * 47 / 48) ** 2, rel=1e-9)


def test_shares_are_kept_and_samples_are_their_own():
    traits = [
        draw_traits(PrintVariety(), PrintTraits(), PLATE, sample_generator("1" * 64, "traits", k)) for k in range(3000)
    ]
    plain = sum(t.section == "cosine" and t.exponent == 1.0 for t in traits) / 3000
    assert plain == pytest.approx(0.4, abs=0.03)
    assert sum(t.merging > 1 for t in traits) / 3000 == pytest.approx(0.25, abs=0.03)
    assert sum(any(t.bow) for t in traits) / 3000 == pytest.approx(1 / 3, abs=0.03)
    assert {t.section for t in traits} == set(FAMILIES)
    assert {t.reach for t in traits if t.section != "gaussian"} == {1.0}
    feet = [t.reach for t in traits if t.section == "gaussian"]
    assert 1.0 <= min(feet) < 1.05 and 1.95 < max(feet) <= 2.0
    exponents = [t.exponent for t in traits]
    assert min(exponents) < 0.52 and max(exponents) > 1.58
    dataset = DatasetConfig(kind="updater", n_samples=100, scene=SCENE, reliefs=VARIED)
    together = traits_of(dataset, dataset.sample_fingerprint(), range(20))
    apart = torch.cat([traits_of(dataset, dataset.sample_fingerprint(), [k]) for k in range(20)])
    assert torch.equal(together, apart) and len(together.unique(dim=0)) > 10


def test_data_sets_without_variety_are_what_they_were():
    """Their fingerprints do not know that it exists; the test fields hang on them."""
    plain = DatasetConfig(kind="updater", n_samples=10, scene=SCENE)
    assert "variety" not in plain.canonical()["reliefs"]
    varied = plain.model_copy(update={"reliefs": VARIED})
    assert varied.canonical()["reliefs"]["variety"]["bow_m"] == 30e-6
    assert varied.fingerprint() != plain.fingerprint()


def test_perturbed_prints_have_the_traits_of_the_true_ones():
    """A start of the updater is printed by the same machine: only its strokes are elsewhere."""
    variety = PrintVariety(section_share=0, merging_share=0, bow_share=1, bow_m=1e-3)
    still = {name: (0.0, 0.0) for name in ("line_start_m", "line_end_m", "line_width_m", "line_height_m")}
    reliefs = ReliefConfig(variety=variety, perturbation=still)
    drawn = Reliefs(DatasetConfig(kind="updater", n_samples=4, scene=SCENE, reliefs=reliefs), "cpu")
    assert torch.equal(drawn.true(range(4)), drawn.perturbed(range(4))[0])


def test_what_cannot_be_printed_is_refused():
    with pytest.raises(ValueError, match="supersampling 16 with lines that merge"):
        ReliefConfig(variety=PrintVariety(), supersampling=16)
    with pytest.raises(ValueError, match="swap"):
        PrintVariety(exponent=(1.6, 0.5))
    with pytest.raises(InputError, match="traits"):
        print_strokes(torch.zeros(2, 1, 7), SCENE, VARIED, torch.zeros(1, 6))
