"""What a process reports of itself: counts of durations, and files that are whole or not there."""

import json
from pathlib import Path
from typing import Any


class Spread:
    """Counts of durations in ns, to three digits, in bounded memory."""

    def __init__(self) -> None:
        self.counts: dict[int, int] = {}

    def add(self, ns: int) -> None:
        unit = 10 ** max(len(str(ns)) - 3, 0)
        self.counts[ns // unit * unit] = self.counts.get(ns // unit * unit, 0) + 1

    def at(self, share: float) -> float:
        """The duration below which `share` of all lie, us."""
        left, value = share * sum(self.counts.values()), 0
        for value, count in sorted(self.counts.items()):
            left -= count
            if left <= 0:
                break
        return value / 1000

    def percentiles(self) -> dict[str, float] | None:
        """Their number, and percentiles in us; None if there is none."""
        if not self.counts:
            return None
        names = {"p50": 0.5, "p90": 0.9, "p99": 0.99, "p999": 0.999, "max": 1.0}
        return {"count": sum(self.counts.values())} | {name: self.at(share) for name, share in names.items()}


class Windows:
    """Mean loss and errors over at most 400 windows of a run's ticks: what its figure and its summary show."""

    def __init__(self, ticks: int, error: int | None) -> None:
        self.length, self.error = max(-(-ticks // 400), 1), error
        self.windows: list[dict[str, Any]] = []
        self.start(0)

    def start(self, tick: int) -> None:
        self.origin, self.until = tick, (tick // self.length + 1) * self.length
        self.ticks = self.ends = 0
        self.loss = self.squares = self.end_error = 0.0

    def add(self, tick: int, reward: float, error: float, ended: bool) -> None:
        """Adds the result of `tick`; `ended` if a target ended with it."""
        if tick >= self.until:
            self.close()
            self.start(tick)
        self.ticks += 1
        self.loss -= reward
        if self.error is not None:
            self.squares += error * error
            if ended:
                self.ends += 1
                self.end_error += error

    def now(self) -> tuple[float, float]:
        """Mean loss a tick and mean error at the end of a target, lately; NaN where there is none."""
        nan = float("nan")
        if self.windows and self.ticks < self.length / 2:
            last = self.windows[-1]
            return last["loss"], nan if last["end_error"] is None else last["end_error"]
        return self.loss / self.ticks if self.ticks else nan, self.end_error / self.ends if self.ends else nan

    def close(self) -> None:
        if self.ticks:
            known = self.error is not None
            self.windows.append({
                "from": self.origin,
                "ticks": self.ticks,
                "loss": self.loss / self.ticks,
                "noise_share": 0.0,
                "mean_squared_error": self.squares / self.ticks if known else None,
                "end_error": self.end_error / self.ends if self.ends else None,
                "ends": self.ends,
            })  # fmt: skip

    def state(self) -> dict[str, Any]:
        """The windows and the sums of the one in progress."""
        return dict(self.__dict__)

    def restore(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)


def write(path: Path, value: Any) -> None:
    """Writes a JSON file atomically."""
    draft = path.with_name(path.name + ".part")
    draft.write_text(json.dumps(value, indent=2))
    draft.rename(path)
