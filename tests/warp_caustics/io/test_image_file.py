"""Which axis of a bare array is the channel."""

from pathlib import Path

import numpy as np
import pytest

from warp_caustics.errors import InputError
from warp_caustics.io import read_image
from warp_caustics.io.image_file import channel_axis


@pytest.mark.parametrize(
    ("shape", "axis"),
    [((3, 64, 64), 0), ((64, 64, 3), 2), ((3, 512, 3), 0), ((8, 64, 64), 0), ((64, 64, 8), 2), ((60, 60, 60), -1)],
)
def test_which_axis_is_the_channel(tmp_path: Path, shape: tuple[int, int, int], axis: int) -> None:
    assert channel_axis(shape) == axis
    array = np.random.default_rng(2).random(shape, dtype=np.float32)
    np.save(tmp_path / "x.npy", array)
    if axis < 0:
        with pytest.raises(InputError, match="no axis"):
            read_image(tmp_path / "x.npy")
    else:
        np.testing.assert_array_equal(read_image(tmp_path / "x.npy").values, np.moveaxis(array, axis, 0))
