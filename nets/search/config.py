"""What stays the same in all trials of a search, and the run that a trial makes of it."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, cast

from pydantic import Field, model_validator

from nets.config import NetworkConfig
from nets.search.space import SearchKind, described_ranges
from nets.training.config import RunConfig, Seconds
from warp_caustics.errors import MismatchError
from warp_caustics.strict import Strict

MIN_EPOCHS = 5
"""Before which no trial is pruned, as in the supplement."""

Sampler = Literal["tpe", "gp"]


class SearchConfig(Strict):
    """A search."""

    run: RunConfig
    """Of every trial, but for the numbers of Tab. 2."""
    max_epochs: Annotated[int, Field(ge=MIN_EPOCHS, le=10**5)] = 3 * MIN_EPOCHS
    """Epochs of a trial that is not pruned and does not stop early."""
    sampler: Sampler = "tpe"
    trial_time_s: Seconds | None = None
    """A trial is judged by its best epoch until then."""

    @model_validator(mode="after")
    def _searchable(self) -> "SearchConfig":
        if self.run.kind not in ("denoiser", "updater"):
            raise ValueError(f"a {self.run.kind} network has no numbers of Tab. 2; search denoiser or updater")
        if self.run.initial_weights is not None:
            raise ValueError("initial_weights fit one network only; leave them out of a search")
        if self.run.training.total_time_s is not None:
            raise ValueError("training.total_time_s would end trials of slow networks early; set trial_time_s instead")
        return self

    @property
    def kind(self) -> SearchKind:
        return cast(SearchKind, self.run.kind)


def trial_run(search: SearchConfig, values: Mapping[str, Any], total_steps: int) -> RunConfig:
    """The training of one trial.

    Args:
        search: everything but the values.
        values: numbers of Tab. 2, by name.
        total_steps: when it ends.
    """
    tree = search.run.model_dump(mode="json")
    tree["network"]["network"] = NetworkConfig(**values).model_dump(mode="json")
    tree["training"]["learning_rate"] = values["learning_rate"]
    tree["training"]["lambda_tv"] = values.get("lambda_tv", 0.0)
    tree["training"]["total_steps"] = total_steps
    return RunConfig.model_validate(tree)


def identity(search: SearchConfig) -> dict[str, Any]:
    """What must be equal for trials to compare, as dotted keys: all but sampler, time, and where the data lie."""
    tree = search.run.model_dump(mode="json") | {"scene": search.run.scene.record()}
    tree["network"].pop("network")
    for name in ("learning_rate", "lambda_tv", "total_steps", "data_workers", "log_every_steps"):
        tree["training"].pop(name)
    if search.run.data is not None:
        from nets.training.files import data_fingerprint

        tree["data"] = data_fingerprint(search.run.data)
    tree["max_epochs"] = search.max_epochs
    tree["ranges"] = described_ranges(search.kind)
    return dict(_flat(tree))


def check_same(stored: Mapping[str, Any], wanted: Mapping[str, Any], name: str) -> None:
    """Refuse to mix trials of two searches.

    Raises:
        MismatchError: with what differs.
    """
    missing = "nothing"
    found = [key for key in {**stored, **wanted} if stored.get(key, missing) != wanted.get(key, missing)]
    # The kind explains all that follows from it.
    found = ["kind"] if "kind" in found else found
    if found:
        told = [f"{key} {stored.get(key, missing)!r} there, {wanted.get(key, missing)!r} here" for key in found[:3]]
        more = f" and {len(found) - 3} more" if len(found) > 3 else ""
        raise MismatchError(
            f"study {name!r} is of another search: {'; '.join(told)}{more}; repeat its command, or begin another study"
        )


def _flat(tree: Mapping[str, Any], at: str = "") -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for key, value in tree.items():
        rows += _flat(value, f"{at}{key}.") if isinstance(value, dict) else [(f"{at}{key}", value)]
    return rows
