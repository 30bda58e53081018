"""Observation and action spaces as lists of named numbers with ranges."""

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from ..errors import Refused


@dataclass(frozen=True)
class Signals:
    """The numbers of a space, in order."""

    names: list[str]
    low: np.ndarray
    high: np.ndarray

    @property
    def unbounded(self) -> list[int]:
        """Those without a finite range."""
        return [i for i in range(len(self.names)) if not np.isfinite([self.low[i], self.high[i]]).all()]


def signals(space: spaces.Space[Any], prefix: str) -> Signals:
    """A `Box`, or a `Dict` of boxes, as a list of numbers. Names are `prefix_1`, ..; for a `Dict`, its keys."""
    if isinstance(space, spaces.Dict):
        parts = [signals(inner, str(key)) for key, inner in space.spaces.items()]
        low, high = (np.concatenate([getattr(part, end) for part in parts]) for end in ("low", "high"))
        return Signals([name for part in parts for name in part.names], low, high)
    if not isinstance(space, spaces.Box):
        raise Refused(f"its space {prefix} is a {type(space).__name__}; a plant has boxes of numbers (Box) alone")
    size = int(np.prod(space.shape))
    names = [prefix] if size == 1 else [f"{prefix}_{i + 1}" for i in range(size)]
    return Signals(names, space.low.astype(float).ravel(), space.high.astype(float).ravel())


def flat(space: spaces.Space[Any], value: Any) -> np.ndarray:
    """An element of a space as the list of its numbers."""
    if isinstance(space, spaces.Dict):
        return np.concatenate([flat(inner, value[key]) for key, inner in space.spaces.items()])
    return np.asarray(value, dtype=float).ravel()


def make(environment: Any, arguments: dict[str, Any]) -> "gymnasium.Env[Any, Any]":
    """The environment that a name, an environment or a function stands for."""
    if isinstance(environment, gymnasium.Env):
        return environment
    if callable(environment):
        made: gymnasium.Env[Any, Any] = environment(**arguments)
        return made
    if str(environment).startswith("dm_control/"):
        try:
            import shimmy
        except ImportError as cause:
            text = f"dm_control's environments need shimmy ({cause})"
            raise Refused(f"{text}: pip install 'shimmy[dm-control]' packaging") from None
        gymnasium.register_envs(shimmy)
    try:
        return gymnasium.make(environment, **arguments)
    except gymnasium.error.Error as cause:
        text = " ".join(str(cause).split())
        raise Refused(f"Gymnasium cannot make {environment}: {text}") from None


def step_seconds(environment: "gymnasium.Env[Any, Any]") -> float | None:
    """Seconds of a step of the environment's own time, where it says so."""
    bare = environment.unwrapped
    seconds = getattr(bare, "dt", None)
    if not isinstance(seconds, (int, float)) and (control := getattr(bare, "_env", None)) is not None:
        step = getattr(control, "control_timestep", None)  # dm_control
        seconds = step() if callable(step) else None
    return float(seconds) if isinstance(seconds, (int, float)) and seconds > 0 else None
