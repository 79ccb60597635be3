"""The lens that the lines of a design tell, where they leave more than noise of an image, or the image is blurred."""

import torch

from nets.inspection.bench_of_design import Fit
from nets.reconstruct.fibres.bench.camera_of_lines import SPREAD_ROUNDS, TELLING_SHARE, gain_of_spread, spread_asked
from nets.reconstruct.fibres.image.lines_view import LinesView


def lens_of_design(lines: torch.Tensor, view: LinesView, fit: Fit) -> tuple[torch.Tensor, LinesView]:
    """Lines and the view through the point spread that they tell; as they were where these leave more than noise.

    Args:
        lines: that explain the view, shape [L, 6] [m].
        view: the image on its bench.
        fit: fits lines to a view.
    """
    told = lines, view
    for _ in range(SPREAD_ROUNDS):
        relief = view.relief(lines)
        if not len(lines) or view.resimulation(relief).residual > TELLING_SHARE:
            break
        camera = spread_asked(view, relief)
        if camera is None:
            break
        seen = LinesView(view.resimulation.blurred_by(camera), view.model)
        moved = fit(lines, seen)
        was, now = view.left(lines), seen.left(moved)
        if was is None or now is None or not now < gain_of_spread(view) * was:
            break
        lines, view = moved, seen
    return (lines, view) if view.is_explained(lines) else told
