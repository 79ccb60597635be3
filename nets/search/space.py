"""What a search varies: the numbers of Tab. 2, within its ranges."""

from typing import Any, Literal, get_args

import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)

from nets.config import BEST_DENOISER, BEST_UPDATER, RANGES, Choice, NetworkConfig

SearchKind = Literal["denoiser", "updater"]
BEST: dict[SearchKind, NetworkConfig] = {"denoiser": BEST_DENOISER, "updater": BEST_UPDATER}


def keys(kind: SearchKind) -> list[str]:
    """Names of the numbers that a kind of network has: those that its column of Tab. 2 fills."""
    return [name for name, value in BEST[kind] if value is not None]


def distributions(kind: SearchKind) -> dict[str, BaseDistribution]:
    """What Optuna draws from, by name."""
    return {name: _distribution(name) for name in keys(kind)}


def suggested(trial: optuna.Trial, kind: SearchKind) -> dict[str, Any]:
    """Values of a trial, by name."""
    values: dict[str, Any] = {}
    for name, found in distributions(kind).items():
        if isinstance(found, CategoricalDistribution):
            values[name] = trial.suggest_categorical(name, found.choices)
        elif isinstance(found, IntDistribution):
            values[name] = trial.suggest_int(name, found.low, found.high)
        elif isinstance(found, FloatDistribution):
            values[name] = trial.suggest_float(name, found.low, found.high, log=found.log)
    return values


def best_of_paper(kind: SearchKind) -> dict[str, Any]:
    """Tab. 2's best member as values of a trial."""
    return {name: getattr(BEST[kind], name) for name in keys(kind)}


def described_ranges(kind: SearchKind) -> dict[str, str]:
    """Ranges as text; two searches are the same only if these are equal."""
    return {name: f"{RANGES[name]}{' (log)' if getattr(RANGES[name], 'is_log', False) else ''}" for name in keys(kind)}


def _distribution(name: str) -> BaseDistribution:
    limits = RANGES[name]
    if isinstance(limits, Choice):
        return CategoricalDistribution(limits.values)
    annotation = NetworkConfig.model_fields[name].annotation
    if float in (annotation, *get_args(annotation)):
        return FloatDistribution(limits.low, limits.high, log=limits.is_log)
    return IntDistribution(int(limits.low), int(limits.high), log=limits.is_log)
