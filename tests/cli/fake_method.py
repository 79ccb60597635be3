"""A reconstruction method that only pretends, to test what happens around one."""

import types

import numpy as np

from warp_caustics.reconstruct.base import Progress, Reconstruction, Reconstructor


class Fake(Reconstructor):
    """Returns the initial relief after some iterations."""

    name = "fake"

    def __init__(self, scene, max_iterations=3, max_time_s=60.0, fail=None):
        self.scene, self.iterations, self.fail = scene, max_iterations, fail

    def reconstruct(self, image, *, initial=None, progress=None):
        n = self.scene.height_samples
        heights = np.zeros((n, n)) if initial is None else initial
        history = []
        for iteration in range(1, self.iterations + 1):
            history.append({"iteration": iteration, "residual": 1 / iteration})
            if progress:
                progress(Progress("pretending", iteration, self.iterations, 1 / iteration, 0.1 * iteration))
            if self.fail:
                raise {"bug": KeyError, "memory": MemoryError}[self.fail]("on purpose")
        return Reconstruction(
            "fake", heights, 0.9 * image.irradiance, 1 / len(history), "max_iterations", history,
            {"iterations": 0.5}, {"landed": [1.0, np.float32(1.0), float("nan")]}, {"device": "cpu"}, ("only a fake",),
        )  # fmt: skip


def methods_module():
    """A stand-in for ``nets.reconstruct.methods`` that knows this method only."""
    module = types.ModuleType("nets.reconstruct.methods")
    module.create = lambda name, scene, device="cpu", **options: Fake(scene, **options)
    module.SEEDED = ()
    return module
