"""A reconstruction method that only pretends; ``python fake_method.py ARGUMENTS`` runs nsfc with it."""

import sys
import time
import types

import numpy as np

import warp_caustics.reconstruct
from warp_caustics.reconstruct.base import Progress, Reconstruction, Reconstructor


class Fake(Reconstructor):
    """Returns the initial relief after some iterations; Ctrl-C ends them early, as the interface demands."""

    name = "fake"

    def __init__(self, scene, max_iterations=3, pause_s=0.0, max_time_s=60.0, fail=None):
        self.scene, self.iterations, self.pause_s, self.fail = scene, max_iterations, pause_s, fail

    def reconstruct(self, image, *, initial=None, progress=None):
        n = self.scene.height_samples
        heights = np.zeros((n, n)) if initial is None else initial
        history, stop_reason = [], "max_iterations"
        try:
            for iteration in range(1, self.iterations + 1):
                time.sleep(self.pause_s)
                history.append({"iteration": iteration, "residual": 1 / iteration})
                if progress:
                    progress(Progress("pretending", iteration, self.iterations, 1 / iteration, 0.1 * iteration))
                if self.fail:
                    raise {"bug": KeyError, "memory": MemoryError}[self.fail]("on purpose")
        except KeyboardInterrupt:
            stop_reason = "interrupted"
        return Reconstruction(
            "fake", heights, 0.9 * image.irradiance, 1 / max(1, len(history)), stop_reason, history,
            {"iterations": 0.5}, {"landed": [1.0, np.float32(1.0), float("nan")]}, {"device": "cpu"}, ("only a fake",),
        )  # fmt: skip


def methods_module():
    """A stand-in for ``warp_caustics.reconstruct.methods`` that knows this method only."""
    module = types.ModuleType("warp_caustics.reconstruct.methods")
    module.create = lambda name, scene, device="cpu", **options: Fake(scene, **options)
    return module


if __name__ == "__main__":
    from cli.main import main

    module = methods_module()
    sys.modules[module.__name__] = warp_caustics.reconstruct.methods = module
    sys.exit(main())
