"""One objective at many reliefs: image and gradient as one CUDA graph."""

import torch

from warp_caustics.cuda_graph import recorded
from warp_caustics.data_gradient import Camera, DataGradient, Objective, data_gradient, possible_heights
from warp_caustics.engine import MAX_GRAPH_PHOTONS
from warp_caustics.simulator import CausticSimulator

UNRECORDED = 2
"""Calls before the graph is recorded: kernels load in the first, and many objectives are asked once."""


class RecordedGradient:
    """:func:`~warp_caustics.data_gradient.data_gradient` of one objective, called for many reliefs.

    On a GPU all launches of a call are replayed as one CUDA graph from the third call on, so that the host does not
    hold it up; elsewhere, and with more than :data:`~warp_caustics.engine.MAX_GRAPH_PHOTONS` photons, they are launched
    one by one.

    Args:
        simulator: S.
        objective: F; what it reads besides must stay where it is.
        camera: C; nothing if None.
    """

    def __init__(self, simulator: CausticSimulator, objective: Objective, camera: Camera | None = None):
        self.simulator, self.objective, self.camera = simulator, objective, camera
        self._calls = 0
        self._heights: torch.Tensor | None = None
        self._graph: torch.cuda.CUDAGraph | None = None
        self._found: DataGradient | None = None

    def __call__(self, heights: torch.Tensor) -> DataGradient:
        """Value, image and gradient at a relief.

        Args:
            heights: [m], shape [n, n], on the simulator's device; what is no glass is replaced (see
                :func:`~warp_caustics.data_gradient.possible_heights`), for nobody waits to tell.
        """
        simulator = self.simulator
        if self._heights is None:
            self._heights = heights.detach().to(simulator.dtype).clone()
        self._heights.copy_(heights)
        self._calls += 1
        is_small = simulator.n_photons <= MAX_GRAPH_PHOTONS
        if simulator.device.type != "cuda" or not is_small or self._calls <= UNRECORDED:
            return self._call()
        if self._graph is None:
            self._graph, self._found = recorded(self._call, is_copied=True)
        self._graph.replay()
        assert self._found is not None
        return DataGradient(*(each.clone() for each in self._found))

    def _call(self) -> DataGradient:
        assert self._heights is not None
        possible = possible_heights(self._heights, self.simulator.scene)
        return data_gradient(self.simulator, possible, self.objective, self.camera, is_checked=False)
