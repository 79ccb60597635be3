"""What lines and their bench become by steps that nothing but an image's noise holds."""

from nets.reconstruct.fibres.bench.gap_fits import Run, is_open, told_by
from nets.reconstruct.fibres.bench.line_posterior import JointCovariance
from nets.reconstruct.fibres.bench.noise_posterior import noise_posterior
from nets.reconstruct.fibres.bench.noise_steps import NoiseSteps, Told
from nets.reconstruct.fibres.bench.run_state import RunState
from nets.reconstruct.fibres.image.descent_numbers import DescentNumbers


def fit_by_noise(run: Run) -> Told | None:
    """Lines, bench and lens where an image's noise tells clearly more of them; what it told, None if it was not asked.

    It is asked by lines that leave nothing but noise everywhere: where these nearly tell another bench, or all of them
    together hint at one. A search takes a bench as told where a hundred pixels that err together do not tell it: five
    lines on an ordinary bench, light going 3.2 % farther, were 6.6 um off so. What is stated of lines and bench is what
    a hundred leave open, here as elsewhere.

    Args:
        run: lines so far; lines, section, bench, view and covariance change where those of the steps leave less.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    if not run.view.is_settled(run.lines):
        return None
    steps, kept, is_kept = NoiseSteps(run), RunState.of(run), False
    if not (steps.is_within_reach and (is_open(run) or steps.is_hinted())):
        return None
    try:
        there = steps()
        if steps.told.is_more:
            run.lines, run.model.shape, run.bench = there.lines, there.shape, there.bench
            run.view = run.on(there.bench, there.camera)
            together = run.together()
            run.bench = together.with_sigma(run.bench, told_by(run, together))
            # The discrepancy takes shared noise for white: a thousandth of it more or less says nothing here.
            is_kept = run.view.is_settled(run.lines)
    finally:
        if not is_kept:
            kept.put(run)
    if is_kept:
        run.hinted, run.covariance = 0.0, _posterior(run, steps)
    return steps.told


def _posterior(run: Run, steps: NoiseSteps) -> JointCovariance:
    """Of lines and bench where steps came to."""
    assert steps.information is not None
    places = DescentNumbers(run.model, len(run.lines), run.moves_section).of_shape
    n_beside = len(run.numbers.parameters) + len(run.bench.field)
    return noise_posterior(steps.information, run.model.shape, places, len(run.lines), n_beside)
