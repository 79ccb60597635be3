"""Development or test fields as files, ready for ``nsfc reconstruct`` and ``nsfc compare``."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cli.output import ResultKind, check_target, result_folder
from data_gen.testset import (
    COUNTS,
    NOISE_STD,
    TEST_PHOTONS,
    FieldSet,
    field_count,
    field_heights,
    field_images,
    fields_config,
)
from warp_caustics.io.heights import write_heights
from warp_caustics.io.images import write_image
from warp_caustics.io.json_file import write_json
from warp_caustics.scene import Scene

if TYPE_CHECKING:
    from cli.parts_progress import Told


def testset_kind() -> ResultKind:
    """What a folder of test fields holds."""
    names = [f"field_{k}_{what}" for k in range(max(COUNTS.values())) for what in ("heights.npy", "image.tif")]
    return ResultKind("test fields", ("testset.json", *names))


def write_testset(
    directory: str,
    scene: Scene,
    device: str,
    fields: int | None = None,
    which: FieldSet = "development",
    *,
    force: bool = False,
    n_photons: int | None = None,
    told: "Told | None" = None,
) -> dict[str, Any]:
    """Write ``field_0_heights.npy``, ``field_0_image.tif`` ... and ``testset.json``.

    Args:
        directory: made complete or not at all.
        scene: the set-up.
        device: where to simulate.
        fields: how many, the first ones; all if None.
        which: the set.
        force: replace earlier test fields.
        n_photons: light paths per wavelength; None for those of the test set.
        told: called with the number of fields done and of all.

    Returns:
        What ``testset.json`` holds.

    Raises:
        InputError: another number of fields, or a folder that is in use or cannot be made.
    """
    count, kind = field_count(which, fields), testset_kind()
    with result_folder(check_target(directory, force, kind), force, kind) as folder:
        return _write(folder, scene, device, count, which, n_photons, told)


def _write(
    folder: Path,
    scene: Scene,
    device: str,
    fields: int,
    which: FieldSet,
    n_photons: int | None,
    told: "Told | None",
) -> dict[str, Any]:
    heights = field_heights(scene, device, which)[:fields].astype(np.float64)
    photons = TEST_PHOTONS.model_copy(update={"n_photons": n_photons} if n_photons is not None else {})
    images = field_images(scene, device, fields=fields, photons=photons, which=which, told=told)
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
        "photons": photons.model_dump(),
        "scene": scene.model_dump(mode="json"),
    }
    write_json(folder / "testset.json", record)
    return record
