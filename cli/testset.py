"""Development or test fields as files, ready for ``nsfc reconstruct`` and ``nsfc compare``."""

from pathlib import Path
from typing import Any

import numpy as np

from data_gen.testset import (
    NOISE_STD,
    TEST_PHOTONS,
    FieldSet,
    field_count,
    field_heights,
    field_images,
    fields_config,
)
from warp_caustics.errors import InputError
from warp_caustics.io.heights import write_heights
from warp_caustics.io.images import write_image
from warp_caustics.io.json_file import write_json
from warp_caustics.scene import Scene


def write_testset(
    directory: str, scene: Scene, device: str, fields: int | None = None, which: FieldSet = "development"
) -> dict[str, Any]:
    """Write ``field_0_heights.npy``, ``field_0_image.tif`` ... and ``testset.json``.

    Args:
        directory: made if it is missing.
        scene: the set-up.
        device: where to simulate.
        fields: how many, the first ones; all if None.
        which: the set.

    Returns:
        What ``testset.json`` holds.

    Raises:
        InputError: another number of fields, or a folder that cannot be made.
    """
    fields = field_count(which, fields)
    folder = Path(directory)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"folder {directory!r} cannot be made ({error.strerror}); create its parent first") from error
    heights = field_heights(scene, device, which)[:fields].astype(np.float64)
    images = field_images(scene, device, fields=fields, which=which)
    names = [f"field_{k}" for k in range(fields)]
    for name, relief, image in zip(names, heights, images, strict=True):
        write_heights(folder / f"{name}_heights.npy", relief)
        write_image(
            folder / f"{name}_image.tif", image, wavelengths_m=scene.wavelengths_m, pixel_size_m=scene.pixel_size_m
        )
    record = {
        "fields": names,
        "set": which,
        "fingerprint": fields_config(which=which).sample_fingerprint(),
        "flat_guess_rmse_um": (np.sqrt((heights**2).mean(axis=(1, 2))) * 1e6).tolist(),
        "noise_std_of_flat": NOISE_STD,
        "photons": TEST_PHOTONS.model_dump(),
        "scene": scene.model_dump(mode="json"),
    }
    write_json(folder / "testset.json", record)
    return record
