"""An image whose channels are not the scene's wavelengths is told what to do with the camera that took it."""

import pytest

from warp_caustics.errors import MismatchError
from warp_caustics.io.channels import check_channel_count

RGB = (610e-9, 530e-9, 430e-9)


@pytest.mark.parametrize(
    ("count", "scene", "told"),
    [
        (
            1,
            RGB,
            r"has 1 channel, the scene 3 wavelengths; for a monochrome camera .*--set scene.wavelengths_m=\[530nm\]",
        ),
        (3, RGB[:1], "has 3 channels, the scene 1 wavelength; .*; of a colour camera .*: --mixing FILE, a row of it"),
        (
            2,
            RGB,
            "has 2 channels, the scene 3 wavelengths; give an image with one channel per wavelength, or set [^;]*$",
        ),
    ],
)
def test_the_mend_is_for_the_camera(count, scene, told):
    with pytest.raises(MismatchError, match=told):
        check_channel_count(count, scene, None)
