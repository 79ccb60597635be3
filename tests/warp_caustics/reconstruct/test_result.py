"""A relief simulated again: record, exposure, what is kept."""

import numpy as np
import pytest
import torch

from warp_caustics import CausticSimulator, Scene
from warp_caustics.extrapolated import ExtrapolatedCaustic
from warp_caustics.prints.model import LineModel
from warp_caustics.reconstruct.base import CausticImage
from warp_caustics.reconstruct.result import Resimulation, as_glass, make_result

SCENE = Scene(height_samples=16, image_pixels=32, radiosity_W_m2=(1.0, 2.0, 0.5))
EXPOSURE = np.array([0.5, 1.0, 2.0])


def bump(height_m):
    x = np.linspace(-1, 1, 16)
    return height_m * np.exp(-20 * (x[None] ** 2 + x[:, None] ** 2))


@pytest.fixture(scope="module")
def simulator():
    return CausticSimulator(SCENE)


@pytest.fixture(scope="module")
def image(simulator):
    """Of a bump, at another exposure."""
    caustic = simulator(torch.tensor(bump(3e-4), dtype=torch.float32)).numpy()
    return CausticImage(caustic * EXPOSURE.astype(np.float32)[:, None, None])


def result_of(resimulation, heights, **changes):
    record = {
        "reason": "converged",
        "history": [],
        "timings": {"search": 1.0},
        "counters": {"steps": 3},
        "settings": {"step": 0.1},
        "warnings": ["first"],
    }
    return make_result("test", resimulation, heights, **(record | changes))


def test_the_truth_leaves_nothing_of_its_image(simulator, image):
    """At its exposure; the stored caustic is at that of the image."""
    found = result_of(Resimulation(simulator, image, EXPOSURE), bump(3e-4))
    assert found.residual == pytest.approx(0, abs=1e-6)
    np.testing.assert_allclose(found.image, image.irradiance, rtol=1e-6)
    assert found.counters["steps"] == 3 and found.counters["energy"]["landed"]
    assert set(found.timings_s) == {"search", "resimulation"}
    believed = Resimulation(simulator, image)
    assert result_of(believed, bump(3e-4)).residual > 0.3
    np.testing.assert_allclose(believed.exposed(bump(3e-4)).exposure, EXPOSURE, rtol=1e-5)
    assert believed.exposed(least=3.0) is believed


def test_advice_hears_the_residual_and_settings_win(simulator, image):
    resimulation, told = Resimulation(simulator, image, EXPOSURE), []
    found = result_of(
        resimulation,
        np.zeros((16, 16)),
        settings={"simulation": "its own"},
        advice=lambda residual: told.append(residual) or [f"{residual:.0%}"],
    )
    assert told == [found.residual] and found.warnings == ("first", f"{found.residual:.0%}")
    assert found.settings["simulation"] == "its own"
    assert result_of(resimulation, bump(1e-4)).settings["simulation"]["preset"] == "lattice"


def test_a_relief_that_was_asked_for_lately_is_not_simulated_again(simulator, image):
    resimulation, heights = Resimulation(simulator, image), bump(1e-4)
    first = resimulation(heights).image
    assert resimulation(heights).image is first
    exposed = resimulation.exposed(heights)
    assert exposed is not resimulation and exposed(heights).image is first, "light is the same at every exposure"
    others = [bump(k * 1e-5) for k in range(resimulation.REMEMBERED)]
    for other in others:
        resimulation(other)
    assert resimulation(heights).image is not first


def test_what_a_network_says_leaves_some_plate():
    wild = np.full((16, 16), np.nan, dtype=np.float32)
    wild[0, :3] = -1.0, np.inf, 1e-4
    glass = as_glass(wild, SCENE)
    assert glass.dtype == np.float64 and np.isfinite(glass).all()
    assert glass.min() == pytest.approx(-0.9 * SCENE.base_thickness_m) and glass[0, 2] == pytest.approx(1e-4)
    assert np.isnan(wild[1, 1]), "what is given stays what it is"


@pytest.mark.parametrize("kind", ["tensor", "array", "record"])
def test_methods_take_arrays(kind):
    """Whatever the method: a plain array stands for a CausticImage."""
    import torch

    from warp_caustics.reconstruct.base import CausticImage, Reconstruction, Reconstructor

    class Seen(Reconstructor):
        name = "seen"

        def reconstruct(self, image, *, initial=None, progress=None):
            assert isinstance(image, CausticImage)
            return Reconstruction("seen", np.zeros((2, 2)), image.irradiance, 0.0, "converged")

    values = np.ones((1, 4, 4), np.float32)
    given = {"tensor": torch.from_numpy(values), "array": values[0], "record": CausticImage(values)}[kind]
    assert Seen().reconstruct(given).image.shape == (1, 4, 4)


def test_what_is_no_image_is_refused():
    from warp_caustics.errors import InputError
    from warp_caustics.reconstruct.base import as_caustic

    with pytest.raises(InputError, match="not irradiance; give an array of numbers"):
        as_caustic("capture.tif")


def test_records_are_shown_shortly():
    from warp_caustics.reconstruct.base import CausticImage, Reconstruction

    image = np.ones((3, 8, 8))
    assert repr(CausticImage(image)) == "CausticImage(3 x 8 x 8, mean 1 W/m^2, noise unknown, 0 masked)"
    result = Reconstruction("refine", np.full((4, 4), 1e-3), image, 0.05, "max_iterations", warnings=("careful",))
    assert repr(result) == (
        "Reconstruction('refine', 4 x 4 heights from 1 to 1 mm, residual 0.05, stopped by max iterations, 1 warnings)"
    )
    assert len(result.plot().axes) == 3


def test_the_version_is_that_of_the_project():
    import tomllib
    from pathlib import Path

    import warp_caustics

    project = tomllib.loads((Path(warp_caustics.__file__).parents[1] / "pyproject.toml").read_text())["project"]
    assert warp_caustics.__version__ == project["version"]


def test_more_photons_show_heights_without_the_error_of_few():
    """Of an image of exact light the true heights leave a small part of what they leave beside a usual lattice."""
    scene = Scene(height_samples=48, image_pixels=192)
    lines = 1e-3 * torch.tensor([[-15.0, -12.0, 14.0, 9.0, 4.0, 0.7], [-9.0, 15.0, 10.0, -16.0, 3.2, 0.9]]).double()
    heights = LineModel(scene).heights(lines)
    image = CausticImage(ExtrapolatedCaustic(CausticSimulator(scene), 32)(heights).numpy())
    plain = Resimulation(CausticSimulator(scene), image)
    finer = plain.finer()
    assert finer.simulator.n_photons == 16 * plain.simulator.n_photons
    found = heights.double().numpy()
    assert finer(found).residual < 0.15 * plain(found).residual
    assert finer.camera == plain.camera and plain.finer().simulator is not plain.simulator
    many = Resimulation(CausticSimulator(scene, n_photons=40_000_000), image)
    assert many.finer().simulator is many.simulator, "no more than can be waited for"
