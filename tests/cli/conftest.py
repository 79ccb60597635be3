"""What command tests share: the small configuration, its heights and images."""

import numpy as np
import pytest

from tests.quick_figures import full_figures, quick_figures
from tests.upright import any_way_up, upright_only
from warp_caustics.prints.line import Line, line_relief

__all__ = ["any_way_up", "full_figures", "inputs", "quick_figures", "relief", "upright_only"]


@pytest.fixture(scope="session")
def relief():
    """A single wide line, shape [32, 32] [m]; it focuses light a little."""
    return line_relief([Line((-0.012, -0.01), (0.012, 0.008), 6e-3, 3e-4)], 32, (0.05, 0.05))


@pytest.fixture(scope="session")
def inputs(tmp_path_factory, relief):
    """Folder with heights.npy and image.tif, its caustic in the small configuration, sharper than methods simulate it."""
    from cli.main import main

    folder = tmp_path_factory.mktemp("inputs")
    np.save(folder / "heights.npy", relief)
    arguments = ["simulate", str(folder / "heights.npy"), "-o", str(folder / "image.tif"), "--config", "small"]
    assert main([*arguments, "--n-photons", "1e5", "--device", "cpu"]) == 0
    return folder
