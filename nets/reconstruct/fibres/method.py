"""``fibres``: relief by a network, its lines by least squares, and these fitted to the image.

Printed plates are made of lines (Tab. 3). Where a relief found by a network can
be written as a few of them, nothing but their numbers is left to find, and the
image says these to a fraction of a micrometre. Where it cannot, or where the
image is explained no better, the answer is that of ``direct``.
"""

import dataclasses
import time
from functools import cached_property

import torch

from nets.reconstruct.bench_search import BenchSearch
from nets.reconstruct.direct import Direct
from nets.reconstruct.direct_options import DirectOptions
from nets.reconstruct.fibres.after_lines import after_lines
from nets.reconstruct.fibres.bench.bench_and_light import BEND_LIGHT
from nets.reconstruct.fibres.lines_of_image import LinesOfImage
from nets.reconstruct.fibres.options import FibresOptions
from nets.reconstruct.fibres.trust.beliefs import told_together
from nets.reconstruct.fibres.trust.told_bench import ToldBench, told_bench
from nets.reconstruct.refinement import Refinement
from nets.reconstruct.with_bench import with_bench
from nets.reconstruct.with_causes import with_causes
from nets.reconstruct.with_doubt import with_doubt
from warp_caustics.found_bench.bench_numbers import AMBIENT, VERGENCE
from warp_caustics.found_bench.bench_record import is_picture_larger
from warp_caustics.reconstruct.base import CausticImage, ProgressCallback, Reconstruction, Reconstructor
from warp_caustics.reconstruct.pyramid import check_image
from warp_caustics.reconstruct.run_log import following
from warp_caustics.scene import Scene
from warp_caustics.types import FloatArray

NO_BENCH = {"numbers": [], "is_kept": False, "is_picture": False}
"""Record of a result for which none was looked for."""
CLEARLY_LESS = 0.95
"""Of what lines leave of an image, below which free heights are taken in their place; both were refined. Sixteen
thousand numbers leave a little less than two hundred by being more: of ten own plates that were asked lines left 5 to
70 % less on nine, and a little more on one, 5 um off, where free heights were 17."""


def nearer_lines(first: LinesOfImage, later: LinesOfImage) -> LinesOfImage:
    """The search whose lines are taken, each on its bench; of both if both are, that which leaves less of the image."""
    if not (first.takes_lines and later.takes_lines):
        return later if later.takes_lines else first
    return min(first, later, key=lambda each: float(each.counters["residual_of_fibres"]))


class Fibres(Reconstructor):
    """Network, lines, image.

    Args:
        scene: the set-up of the measurement.
        options: see :class:`FibresOptions`.
        device: where to compute.

    Raises:
        InputError: no network is shipped, or no such file.
        MismatchError: the network is for another scene.
    """

    name = "fibres"

    def __init__(self, scene: Scene, options: FibresOptions | None = None, device: str | torch.device = "cpu"):
        self.options = options or FibresOptions()
        of_direct = {key: getattr(self.options, key) for key in DirectOptions.model_fields}
        plain = DirectOptions(**(of_direct | {"set_up": "known"}))
        self.network = Direct(
            scene,
            plain.model_copy(
                update={"refine": False, "flatness_m": 0.0, "causes": False, "losses": False, "samples": 0}
            ),
            device,
        )
        self.device = self.network.device
        is_gpu = self.device.type == "cuda"
        self.scene = scene = self.network.scene
        self.options = self.options.on(self.device.type)
        self.finds_bench = (self.options.set_up or ("estimate" if is_gpu else "known")) == "estimate"
        self.takes_bench_as_told = self.options.set_up == "known"
        self.looks_first = not self.takes_bench_as_told and self.options.max_time_s is None
        """Whether a bench that looks other is found without lines first."""
        self.finds_other_with_lines = is_gpu
        """But a picture of another size: on a GPU bench and lines together take seconds."""
        self.refinement = Refinement(scene, plain, self.device, self.network.network.seen.scale)
        self.finds_section = self.options.profile == "found"

    def reconstruct(
        self,
        image: CausticImage,
        *,
        initial: FloatArray | None = None,
        progress: ProgressCallback | None = None,
    ) -> Reconstruction:
        """Recover the relief; see :class:`~warp_caustics.reconstruct.base.Reconstructor`.

        ``Reconstruction.fibres_m`` holds the lines where they explain the image. Ctrl-C and ``max_time_s`` return the
        best so far.
        """
        started, measured = time.perf_counter(), check_image(image, self.scene)
        search = BenchSearch(self.network, self.network.numbers)
        image = search.cleared(measured)
        answer = self.network.found(image, initial, progress)
        if answer.stop_reason == "interrupted":
            return self.network.asked[0].grid.result(dataclasses.replace(answer, method=self.name))
        run, direct = LinesOfImage(self, image, answer, started, progress), None
        if self.looks_first and self._looks_other(search, image, answer):
            # Lines would be searched for in vain on a bench that is not there, or go astray: where a picture is larger
            # lines that lie further out explain it nearly.
            run.leave()
            direct = self._by_network(run, measured, initial, progress)
            if direct.stop_reason == "interrupted":
                return direct
            run = self._run_after(direct, search, measured, answer, started, progress)
            if run.answer.stop_reason == "interrupted":
                return dataclasses.replace(direct, stop_reason="interrupted")
        run.fit()
        if direct is None and self._may_be_larger(run):
            # Lines take a picture that is too large for a lamp nearby; heights tell both apart.
            direct = self._by_network(run, measured, initial, progress)
            if direct.stop_reason != "interrupted" and is_picture_larger(direct.counters.get("bench", NO_BENCH)):
                later = self._run_after(direct, search, measured, answer, started, progress)
                if later.answer.stop_reason == "interrupted":
                    return dataclasses.replace(direct, stop_reason="interrupted")
                later.fit()
                run = nearer_lines(run, later)
        if direct is not None:
            stop = direct.stop_reason if run.reason == "converged" else run.reason
            counters = direct.counters | {"fibres": len(run.lines)}
            direct = dataclasses.replace(direct, stop_reason=stop, counters=counters)
        is_free = self._is_free(run)
        asks_network = is_free and (self.options.samples or not self.takes_bench_as_told)
        plain = None
        if not run.takes_lines and (direct or asks_network):
            plain = direct or self._by_network(run, measured, initial, progress)
        else:
            found = run.result()
            may_be_other = run.takes_lines and not run.is_noise_left and self.options.refine
            if may_be_other and is_free and run.reason == "converged":
                other = direct or self._by_network(run, measured, initial, progress)
                plain = other if run.residual_of(other) < CLEARLY_LESS * found.residual else None
            if plain is None:
                plain = self._finished(found, run)
                if run.takes_lines and not run.may_be_pieces():
                    return plain
        return self._with_curves(plain, run, search, measured, answer, started, progress)

    def _looks_other(self, search: BenchSearch, image: CausticImage, answer: Reconstruction) -> bool:
        """Whether the bench is looked for without lines first."""
        glance = search.glance(image, answer, answer.heights_m)
        if glance.has_other_size if self.finds_other_with_lines else glance.is_other:
            return True
        return search.is_far(image, answer, answer.heights_m)

    def _is_free(self, run: LinesOfImage) -> bool:
        """Whether nobody waits for the end."""
        return self.options.max_time_s is None and run.reason == "converged"

    def _may_be_larger(self, run: LinesOfImage) -> bool:
        """Whether lines leave open what size the picture has, and the network is asked anyhow."""
        is_asked = run.numbers.is_picture or self.takes_bench_as_told
        is_open = not is_asked and VERGENCE in run.numbers.names and not run.is_noise_left
        return is_open and self._is_free(run) and (self.options.refine or not run.takes_lines)

    def _finished(self, found: Reconstruction, run: LinesOfImage) -> Reconstruction:
        """With what it knows of itself, on the user's grid."""
        if self.options.causes and found.stop_reason != "interrupted":
            numbers = None if found.counters.get("bench", {}).get("is_kept") else self.network.numbers
            is_exact = run.takes_lines and run.is_noise_left
            found = with_causes(found, *run.shown_to(found), numbers, is_exact=is_exact)
        if self.options.bench_uncertainty:
            counted = () if run.covariance is None else told_together(run.asked)
            told = None if set(BEND_LIGHT) & set(counted) else _as_told(run)
            found = with_bench(found, self.network.numbers, counted, self.options.flatness_m, told)
        return self.network.asked[0].grid.result(with_doubt(found))

    @cached_property
    def _direct(self) -> Direct:
        """What finds plates that are no lines, with the bench and losses of light of its own."""
        options = {key: getattr(self.options, key) for key in DirectOptions.model_fields}
        return Direct(self.network.network.seen.user, DirectOptions(**options), self.device)

    def _run_after(
        self,
        direct: Reconstruction,
        search: BenchSearch,
        measured: CausticImage,
        answer: Reconstruction,
        started: float,
        progress: ProgressCallback | None,
    ) -> LinesOfImage:
        """The search for lines on the bench that was found without them; on the told one if none was.

        Args:
            direct: what was found without lines.
            search: of the bench.
            measured: the image.
            answer: of the network on the told bench.
            started: when the method did.
            progress: of the whole run.
        """
        direct_s, bench = time.perf_counter() - started, None
        if direct.counters.get("bench", {}).get("is_kept"):
            after = following(progress, len(direct.history), started)
            again = search.method_on(direct).found(search.on_found(measured, direct), None, after)
            answer = after_lines(again, direct.history, direct_s, {}, {})
            bench = direct.counters["bench"], self.network.numbers.before[AMBIENT]
        else:
            answer = dataclasses.replace(answer, history=direct.history)
        timings = {"without lines": direct_s}
        return LinesOfImage(self, search.cleared(measured), answer, started, progress, bench, timings)

    def _with_curves(
        self,
        plain: Reconstruction,
        before: LinesOfImage,
        search: BenchSearch,
        measured: CausticImage,
        answer: Reconstruction,
        started: float,
        progress: ProgressCallback | None,
    ) -> Reconstruction:
        """Lines with corners and curves where they explain the image better than what was found without lines.

        Args:
            plain: that result; it is returned where they do not.
            before: the search for straight lines.
            search: of the bench.
            measured: the image.
            answer: of the network on the told bench.
            started: when the method did.
            progress: of the whole run.
        """
        is_over = before.is_left_alone or plain.stop_reason in ("interrupted", "max_time")
        if is_over or not (self.options.looks_for_curves and self._is_free(before)):
            return plain
        run = self._run_after(plain, search, measured, answer, started, progress)
        if run.answer.stop_reason == "interrupted":
            return dataclasses.replace(plain, stop_reason="interrupted")
        if not run.fit_curves(plain):
            return plain if run.reason == "converged" else dataclasses.replace(plain, stop_reason=run.reason)
        return self._finished(run.result(), run)

    def _by_network(
        self, run: LinesOfImage, image: CausticImage, initial: FloatArray | None, progress: ProgressCallback | None
    ) -> Reconstruction:
        """The record of ``direct``, where lines do not tell the image."""
        log = run.log
        after = following(progress, len(log.history), log.started, "without lines, ")
        self._direct.take_over(self.network)
        found = self._direct.reconstruct(image, initial=initial, progress=after)
        timings, counters = run.timings, run.counters | {"explained_by": "network"}
        told = after_lines(found, log.history, run.seconds, timings, counters)
        return dataclasses.replace(told, method=self.name, settings=found.settings | self.options.model_dump())


def _as_told(run: LinesOfImage) -> ToldBench | None:
    """What lines tell of gap, base and index that are as told; None of lines that do not explain the image, or bend.

    Of curves how far light goes on the bench that they told.
    """
    if run.way_sigma is not None:
        return told_bench((0.0, run.way_sigma), run.numbers, run.bench, run.relief())
    if not (run.takes_lines and run.is_noise_left) or run.curves is not None or run.waves is not None:
        return None
    told = run.told_share
    if told is not None and run.hinted:
        told = 0.0, told[1]  # heights are as uncertain as the hint says already
    return told_bench(told, run.numbers, run.bench, run.relief())
