"""What lines and their bench become by steps that nothing but an image's noise holds."""

from nets.reconstruct.fibres.bench.gap_fits import Run, told_by
from nets.reconstruct.fibres.bench.noise_steps import NoiseSteps, Told
from nets.reconstruct.fibres.bench.run_state import RunState

OF_FOUND, OF_TOLD = 1.0, 2.0
"""Standard deviations that light must go farther or less far than on a bench so far: one that was found, and one that
is as told. Plates on benches exactly as told are 1.1 and 1.6 away, by the error of their lattice; steps helped plates
that were 1.8 and 2.5 away, and harmed one that was 0.2 away."""


def is_open(run: Run) -> bool:
    """Whether an image may tell more of how far light goes than lines have told.

    Not of a bench on which light goes as far as it does, within what a hundred pixels leave open, or twice that where
    nothing at all of the bench was found to be other: there a look at all numbers would take most plates longer than
    all the rest.
    """
    if run.told_share is None:
        return True
    share, sigma = run.told_share
    return abs(share) > (OF_TOLD if run.covariance is None else OF_FOUND) * sigma


def fit_by_noise(run: Run) -> Told | None:
    """Lines, bench and lens where an image's noise tells clearly more of them; what it told, None if it was not asked.

    It is asked by lines that leave nothing but noise everywhere. A search takes a bench as told where a hundred pixels
    that err together do not tell it: five lines on an ordinary bench, light going 3.2 % farther, were 6.6 um off so.
    What is stated of lines and bench is what a hundred leave open, here as elsewhere.

    Args:
        run: lines so far; lines, section, bench, view and covariance change where those of the steps leave less.

    Raises:
        KeyboardInterrupt: the run's time is over; lines are as they were.
    """
    if not (is_open(run) and run.view.is_settled(run.lines)):
        return None
    steps, kept, is_kept = NoiseSteps(run), RunState.of(run), False
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
        run.hinted = 0.0
    return steps.told
