"""When to stop: no progress for some epochs."""

import math
from dataclasses import asdict, dataclass
from typing import Any


@dataclass
class EarlyStopping:
    """Stops after ``patience`` epochs without progress, not before ``min_epochs`` epochs.

    Progress is a loss strictly below the best so far; NaN and infinity never are.

    Attributes:
        patience: None never stops.
        min_epochs: least number of epochs.
        best: lowest loss so far.
        best_epoch: its epoch, from 1; 0 for none.
        epoch: epochs seen.
        waited: epochs since the best, or since the start.
    """

    patience: int | None
    min_epochs: int
    best: float = math.inf
    best_epoch: int = 0
    epoch: int = 0
    waited: int = 0

    def saw(self, loss: float) -> bool:
        """Take in the loss of one more epoch; True if it is the best so far."""
        self.epoch += 1
        is_best = math.isfinite(loss) and loss < self.best
        if is_best:
            self.best, self.best_epoch, self.waited = loss, self.epoch, 0
        else:
            self.waited += 1
        return is_best

    @property
    def should_stop(self) -> bool:
        return self.patience is not None and self.epoch >= self.min_epochs and self.waited >= self.patience

    def state(self) -> dict[str, Any]:
        """Plain values for a checkpoint."""
        return {name: value for name, value in asdict(self).items() if name not in ("patience", "min_epochs")}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from :meth:`state`."""
        self.best, self.best_epoch = float(state["best"]), int(state["best_epoch"])
        self.epoch, self.waited = int(state["epoch"]), int(state["waited"])
