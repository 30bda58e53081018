"""A controller in the place of Tectum's own: what its author writes, and what it is told.

As in Rust (docs/controllers.md): an `Agent` with `act`, `learn` and `improve`. `controller_core.py` calls it.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .layouts import Flag

NEW_TARGET, TERMINATED, TRUNCATED = int(Flag.NEW_TARGET), int(Flag.TERMINATED), int(Flag.TRUNCATED)
# Why nothing may be learned from a tick, by the flags that say so; the first that fits.
WITHHELD = (
    (int(Flag.FIRST), "first"),
    (int(Flag.UNARMED | Flag.TRIPPED), "not driven"),
    (int(Flag.BLIND), "blind"),
    (int(Flag.SKIPPED), "skipped"),
    (int(Flag.MISSED), "missed"),
)


def boundary(flags: int) -> str | None:
    """What begins with the inputs of an observation with these flags."""
    if flags & TERMINATED:
        return "terminated"
    if flags & TRUNCATED:
        return "truncated"
    return "new target" if flags & NEW_TARGET else None


class Percept(NamedTuple):
    """What the controller perceives at the beginning of a tick."""

    tick: int
    inputs: np.ndarray
    """The inputs, in the scenario's order and units. All are finite."""
    age: int
    """Age of the inputs, ticks: 0 unless the plant could not be read and repeats what it sensed before."""
    flags: int
    """Bits of `Flag`: what happened in the tick before."""

    @property
    def boundary(self) -> str | None:
        """What begins with these inputs: `terminated`, `truncated` (another episode), `new target`, or None."""
        return boundary(self.flags)


class Answer(NamedTuple):
    """The outputs of a controller that says what part of them is exploration. The plant applies `command`; `mean` is
    for viewers and the log."""

    command: Sequence[float]
    mean: Sequence[float]


@dataclass(frozen=True)
class Experience:
    """What became of the last command."""

    tick: int
    inputs: np.ndarray
    """The inputs that it answered."""
    asked: np.ndarray
    """The command as the controller gave it."""
    applied: np.ndarray
    """The command as it was applied, after hold policy and gate."""
    limited: bool
    """Whether the gate limited it; `applied` then differs from `asked`."""
    reward: float
    next_inputs: np.ndarray
    """The inputs of the next tick. Those of another episode where `boundary` is `terminated` or `truncated`."""
    boundary: str | None
    """`terminated`: the episode has ended, and the value after it is zero. `truncated`: it was cut off, and the value
    after it is unknown. `new target`: the reward still belongs to the target before. None: the next inputs follow."""
    withheld: str | None
    """Why nothing may be learned from it: `first`, `missed`, `skipped`, `lost`, `not driven`, `blind`, `corrupted` or
    `invalid`; None if it may."""


class Controller(ABC):
    """Answers every observation with outputs, and may learn. It is made with the run that it takes part in.

    A controller that is killed comes back as it was: with what `state` last gave, and the observations since then,
    which it answers and learns from once more without sending anything. So its answers may depend on its observations,
    on its state and on the run's seed alone: not on a clock, and not on an unseeded generator (`run.generator(name)` is
    a seeded one, which belongs into the state).
    """

    keep_every = 64
    """Observations between two calls of `state`."""
    columns: Sequence[str] = ()
    """Names of at most 8 numbers of the controller's own in the learning record and the log; `record` gives them."""

    @abstractmethod
    def act(self, percept: Percept) -> "Answer | Sequence[float] | np.ndarray | float":
        """The outputs for these inputs, one for each output of the scenario."""

    # For a controller that learns:

    def learn(self, experience: Experience) -> bool | None:
        """Learns from the tick before. Called before `act`, so the command waits for it, and also where nothing may be
        learned. Returns whether something was learned; None stands for whatever may be."""

    def improve(self) -> None:
        """The work for which no command waits. Called after the command has been sent, once a tick, or as often as the
        scenario's `[controller] updates` says."""

    def record(self) -> Sequence[float]:
        """The numbers of `columns`."""
        return ()

    # For a controller with a state; give both, or neither for one that depends on the percept alone.

    def state(self) -> Any:
        """What must outlive the process: a dict of numbers, texts, numpy arrays and generators; dicts may be nested."""
        return {}

    def restore(self, state: Any) -> None:
        """Continues from a state that `state` gave."""
