"""A controller in the place of Tectum's own: what its author writes, and what it is told.

The loop around it is in `controller_loop.py`.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .layouts import Flag, Observation

TERMINATED = int(getattr(Flag, "TERMINATED", 0))
TRUNCATED = int(getattr(Flag, "TRUNCATED", 0))
# Why nothing may be learned from a tick, in the order in which the reasons are given.
REASONS = (
    (Flag.FIRST, "first"),
    (Flag.SKIPPED, "skipped"),
    (Flag.NON_FINITE, "non-finite"),
    (Flag.MISSED, "missed"),
    (Flag.UNARMED, "unarmed"),
    (Flag.TRIPPED, "tripped"),
    (Flag.BLIND, "blind"),
)
NOT_THE_CONTROLLERS = int(
    Flag.FIRST | Flag.MISSED | Flag.SKIPPED | Flag.UNARMED | Flag.TRIPPED | Flag.BLIND | Flag.NON_FINITE
)


class Percept(NamedTuple):
    """What the controller sees at a tick."""

    tick: int
    inputs: np.ndarray
    """The inputs, in the scenario's order and units."""
    age: float
    """Seconds since the plant sensed them; 0 in lockstep."""
    flags: int
    """Bits of `Flag`: what happened in the tick before."""

    @property
    def new_target(self) -> bool:
        """Whether a new target (or trial) begins with these inputs."""
        return bool(self.flags & Flag.NEW_TARGET)


class Answer(NamedTuple):
    """The outputs of a controller that says what part of them is exploration. The plant applies `drawn`; `mean` is for
    viewers and the log."""

    drawn: Sequence[float]
    mean: Sequence[float]


@dataclass(frozen=True)
class Transition:
    """What came of one tick."""

    tick: int
    inputs: np.ndarray
    """The inputs that the controller answered."""
    asked: np.ndarray
    """What it asked for."""
    applied: np.ndarray
    """What was applied, after hold policy and gate."""
    reward: float
    next_inputs: np.ndarray
    """The inputs now. Where `terminated` or `truncated` is set they are those of the next episode."""
    flags: int
    """Bits of `Flag`."""
    why_not: str | None
    """Why nothing may be learned from this tick: `missed`, `skipped`, `lost`, ..; None if it may."""

    @property
    def limited(self) -> bool:
        """Whether the gate limited the command; `applied` is what it let through."""
        return bool(self.flags & Flag.CLAMPED)

    @property
    def new_target(self) -> bool:
        """Whether a new target begins with `next_inputs`: no credit may cross."""
        return bool(self.flags & Flag.NEW_TARGET)

    @property
    def terminated(self) -> bool:
        """Whether the episode ended, and the value after it is 0."""
        return bool(self.flags & TERMINATED)

    @property
    def truncated(self) -> bool:
        """Whether the episode was cut off: the value after it is not 0, but no credit may cross."""
        return bool(self.flags & TRUNCATED)


class Controller(ABC):
    """Answers every observation with outputs, and may learn. It is made with the run that it takes part in.

    A controller that is killed comes back as it was: with what `state` last gave, and the observations since then, which
    it answers and learns from once more without sending anything. So its answers may depend on its observations, on its
    state and on the run's seed alone: not on a clock, and not on an unseeded generator (`run.generator(name)` is a
    seeded one, which belongs into the state).
    """

    keep_every = 64
    """Observations between two calls of `state`."""

    @abstractmethod
    def act(self, percept: Percept) -> "Answer | Sequence[float] | np.ndarray | float":
        """The outputs for these inputs, one for each output of the scenario."""

    # For a controller that learns:

    def learn(self, transition: Transition) -> None:
        """Learns from the tick before. Called before `act`, so the command waits for it."""

    def improve(self) -> None:
        """The work for which no command waits. Called after the command has been sent, once a tick."""

    # For a controller with a state; give both, or neither for one that depends on the percept alone.

    def state(self) -> Any:
        """What must outlive the process: a dict of numbers, texts, numpy arrays and generators; dicts may be nested."""
        return {}

    def restore(self, state: Any) -> None:
        """Continues from a state that `state` gave."""


def why_not(observation: Observation, expected: int | None) -> str | None:
    """Why nothing may be learned from the tick before an observation; `expected` is the tick after the last answer."""
    flags = observation.header.flags
    if expected is None:
        return "first"
    if flags & NOT_THE_CONTROLLERS:
        return next(word for flag, word in REASONS if flags & flag)
    return None if observation.header.tick == expected else "lost"
