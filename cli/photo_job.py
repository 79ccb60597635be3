"""``nsfc simulate --camera``: a photo with its dark and flat frames instead of an image of irradiance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cli.shipped_files import shipped_cameras, shipped_file
from warp_caustics.camera.config import CameraConfig, read_camera
from warp_caustics.camera.files import photograph_files, write_photographs
from warp_caustics.camera.operator import Camera
from warp_caustics.camera.photographs import photographs
from warp_caustics.errors import InputError

if TYPE_CHECKING:
    import torch

    from warp_caustics.scene import Scene
    from warp_caustics.simulator import CausticSimulator

BENCH_CAMERA = "bench"
"""Value of --camera that is no name; a file of that name is ./bench."""
SATURATED = 0.01
"""Share of saturated pixels that is worth a warning; ``nsfc capture`` warns from there on, too."""


def camera_config(source: str) -> CameraConfig:
    """Camera of a --camera value: a bare name means a shipped one, anything else a file.

    Raises:
        InputError: neither, or a camera that is none.
    """
    return read_camera(shipped_file(source, shipped_cameras(), "camera") or source)


def camera_source(source: str, bench: str | None) -> str | CameraConfig:
    """What a --camera value means beside --bench: ``bench`` is the camera that was calibrated.

    Raises:
        InputError: ``bench`` without one.
    """
    if source != BENCH_CAMERA:
        return source
    if bench is None:
        raise InputError("--camera bench is that of a calibrated bench; give its file with --bench bench.yaml")
    from warp_caustics.calibration.bench_file import read_bench

    return read_bench(bench).camera


@dataclass(frozen=True, eq=False)
class PhotoJob:
    """A photo that can be taken, all of it checked.

    Attributes:
        config: the camera.
        scene: what it looks at.
        files: where frames go.
    """

    config: CameraConfig
    scene: "Scene"
    files: Mapping[str, Path]

    @classmethod
    def checked(
        cls,
        source: str | CameraConfig,
        output: str,
        scene: "Scene",
        inputs: Sequence[Any],
        *,
        noise: float,
        force: bool,
    ) -> "PhotoJob":
        """Refuse a camera or an output that cannot be used before the simulation instead of after it."""
        from cli.output import check_file

        if noise > 0:
            raise InputError(
                f"--noise {noise:g} and --camera exclude each other; the camera's sensor has its own noise"
            )
        config = source if isinstance(source, CameraConfig) else camera_config(source)
        if isinstance(source, str) and ("/" in source or "." in source):
            inputs = [*inputs, source]
        files = photograph_files(output, Camera(config, scene))
        if not files["photo"].parent.is_dir():
            raise InputError(f"folder {str(files['photo'].parent)!r} does not exist; create it first")
        for kind, file in files.items():
            check_file(file, force, inputs, "output" if kind == "photo" else f"{kind} file")
        return cls(config, scene, files)

    def write(self, simulator: "CausticSimulator", image: "torch.Tensor", seed: int) -> dict[str, Any]:
        """Take the photo and write all files; returns what to put on record, and ``warnings``."""
        import torch

        flat = simulator(torch.zeros(2 * (self.scene.height_samples,), dtype=image.dtype, device=image.device))
        camera = Camera(self.config, self.scene, device=image.device, dtype=image.dtype)
        frames = photographs(camera, image, flat, seed)
        write_photographs(self.files, frames, camera)
        return {
            "files": {kind: str(file) for kind, file in self.files.items()},
            "camera": self.config.model_dump(mode="json"),
            "photo_shape": list(frames.photo.shape),
            "saturated_fraction": frames.saturated,
            "warnings": [
                f"channel {channel}: {share:.1%} of the photo is saturated (limit {SATURATED:.0%}); lower "
                f"sensor.exposure from {self.config.sensor.exposure:g}"
                for channel, share in enumerate(frames.saturated)
                if share > SATURATED
            ],
        }

    def lines(self, made: Mapping[str, Any]) -> list[str]:
        """What was written, for people."""
        shape = " x ".join(map(str, made["photo_shape"]))
        named = [f"{kind:<10} {file}" for kind, file in made["files"].items() if kind != "photo"]
        return [f"photo      {made['files']['photo']}, {shape}, 16 bits", *named]
