"""Which numbers of a set-up an image fixes, how well, and which it cannot tell apart."""

from dataclasses import dataclass
from typing import Literal

import torch

from warp_caustics.errors import InputError
from warp_caustics.setup.information import (
    Direction,
    conditional_deviations,
    directions,
    fisher_information,
    marginal_deviations,
    with_priors,
    without,
)
from warp_caustics.setup.model import SetUpJacobian
from warp_caustics.setup.parameter import Parameter
from warp_caustics.setup.set_up import SetUp
from warp_caustics.setup.trades import WORTH, partners
from warp_caustics.setup.unknown_heights import UnknownHeights

FIXED = 0.2
"""What an image leaves of a prior width at most where it fixes a parameter."""
TOLD = 0.8
"""What it leaves at most where it says something."""
WIDER = 30.0
"""Trade-offs are the image's and not the laboratory's: they are told with prior widths that many times as large."""
HEIGHTS = "heights"
"""Partner that stands for all unknown heights together."""

Verdict = Literal["fixed", "narrowed", "not told", "only its square"]
"""The last of a parameter at 0 that counts by its square: its derivative is 0, whatever the image holds."""
Trades = tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Known:
    """What an image tells about one parameter; all standard deviations are in the parameter's unit.

    Attributes:
        parameter: which.
        value: nominal.
        alone: while all else is known, by the image only; infinite where it does not depend on the parameter.
        together: while the other free parameters are known no better than before.
        with_heights: while the heights are unknown, too; equal to the above where they are known.
        trades: what the image confuses it with: names, each the one that would tell most were it known besides those
            before it, and correlations of errors with those before it known. Priors are :data:`WIDER` times as wide.
            Last all unknown heights together, with their multiple correlation while the rest of the set-up is known.
        verdict: by what is left of the prior width.
    """

    parameter: Parameter
    value: float
    alone: float
    together: float
    with_heights: float
    trades: Trades
    verdict: Verdict

    @property
    def remaining(self) -> float:
        """What the image leaves of the prior width [1]."""
        return self.with_heights / self.parameter.prior


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What an image tells about a set-up.

    Attributes:
        parameters: one by one, in the order of the set-up's names, shape [P].
        directions: combinations of them, best determined first, unknown heights taken into account.
        information: of the image about the free parameters, without priors, shape [P, P]; unknown heights have
            been estimated along.
    """

    parameters: tuple[Known, ...]
    directions: tuple[Direction, ...]
    information: torch.Tensor


def knowledge(
    setup: SetUp,
    jacobian: SetUpJacobian,
    noise: torch.Tensor | float,
    heights: UnknownHeights | None = None,
    by_heights: torch.Tensor | None = None,
) -> Knowledge:
    """What an image with noise tells about parameters of a set-up.

    Args:
        setup: has their nominal values and prior widths.
        jacobian: derivatives by parameters, P of them, of the set-up's names.
        noise: standard deviation of each pixel [W/m^2], a number or of an image's shape.
        heights: what is not known about the relief; None knows it all.
        by_heights: derivatives of the image by that, shape [K, C, H, W].

    Raises:
        InputError: noise that is not above 0, or unknown heights without their derivatives.
    """
    if (heights is None) != (by_heights is None):
        raise InputError("unknown heights and their derivatives belong together; give both, or none")
    by_name = dict(zip(setup.names, setup.parameters, strict=True))
    parameters = [by_name[name] for name in jacobian.names]
    nominal = dict(zip(setup.names, setup.nominal.tolist(), strict=True))
    priors = torch.tensor([p.prior for p in parameters], dtype=torch.float64)
    count, columns = len(parameters), jacobian.values
    known = fisher_information(columns, noise)
    told = known
    if heights is not None and by_heights is not None and len(heights.priors):
        joint = fisher_information(torch.cat((columns, by_heights.to(columns.device))), noise)
        joint = with_priors(joint, torch.cat((torch.full((count,), torch.inf, dtype=torch.float64), heights.priors)))
        told = without(joint, torch.arange(len(joint)) >= count)
    alone = conditional_deviations(known)
    together = marginal_deviations(with_priors(known, priors))
    final = with_priors(told, priors)
    with_heights, wide = marginal_deviations(final), with_priors(told, WIDER * priors)
    lone = conditional_deviations(told)
    of_heights = (1 - (alone / lone) ** 2).clamp_min(0.0).sqrt().nan_to_num()

    def traded(k: int) -> Trades:
        names = tuple((jacobian.names[i], value) for i, value in partners(wide, k))
        return (*names, (HEIGHTS, float(of_heights[k]))) if float(of_heights[k]) >= WORTH else names

    found = [
        Known(
            parameter=parameter,
            value=nominal[parameter.name],
            alone=float(alone[k]),
            together=float(together[k]),
            with_heights=float(with_heights[k]),
            trades=traded(k),
            verdict=_verdict(parameter, nominal[parameter.name], float(with_heights[k]) / parameter.prior),
        )
        for k, parameter in enumerate(parameters)
    ]
    return Knowledge(tuple(found), tuple(directions(told, priors)), told)


def _verdict(parameter: Parameter, value: float, remaining: float) -> Verdict:
    if parameter.is_squared and value == 0:
        return "only its square"
    return "fixed" if remaining <= FIXED else "narrowed" if remaining <= TOLD else "not told"
