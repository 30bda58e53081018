"""Writes a scenario for an environment, to start from."""

import math
import re
from typing import Any

import numpy as np

from .spaces import Signals, flat, make, signals, step_seconds

STEPS = 5_000  # of random actions, from which ranges are taken that the environment does not give
UNBOUNDED = 10.0  # the range on both sides of an input that never moved in them


def scenario(environment: Any, interpreter: str = "python3", **arguments: Any) -> str:
    """A scenario (TOML) that runs `environment` as a plant, with the default learner.

    Ranges come from the spaces. Where a range is unbounded, it is what was seen in 5,000 random steps and a tenth more
    on both sides; a comment says so.
    """
    made = make(environment, arguments)
    name = made.spec.id if made.spec else type(made.unwrapped).__name__
    inputs, outputs = signals(made.observation_space, "observation"), signals(made.action_space, "action")
    measured = inputs.unbounded
    if measured:
        inputs = measure(made, inputs, measured)
    seconds, size = step_seconds(made), len(inputs.names)
    limits = [min(abs(low), abs(high)) for low, high in zip(outputs.low, outputs.high)]
    lines = [
        f"# {name} of Gymnasium as a plant.",
        f'name = "{re.sub("[^a-z0-9]+", "-", name.lower()).strip("-")}"',
        "ticks = 20_000",
        f"period_ms = {number(1000 * (seconds or 0.05))}" + ("" if seconds else "  # the environment does not say"),
        "[plant]",
        f'program = "{interpreter}"',
        f'args = ["-m", "tectum.gym", "plant", "{name}"]',
        'measures = ["return"]',
        "inputs = [",
        *(signal(inputs, i, "  # as seen in random steps" if i in measured else "") for i in range(size)),
        "]",
        f"outputs = [{', '.join(signal(outputs, i).strip(' ,') for i in range(len(outputs.names)))}]",
        "[encoder]",
        "maps = [",
        *(f'    {{ inputs = ["{inputs.names[i]}"], units = [16], radius = {number(width(inputs, i) / 8)} }},'
          for i in range(size)),
        "]",
        "[policy]",
        f"sigma = {number(0.2 * min(limits))}",
        "[gate]",
        f"max_command = {number(limits[0]) if len(set(limits)) == 1 else [float(number(x)) for x in limits]}",
    ]  # fmt: skip
    made.close()
    return "\n".join(lines) + "\n"


def measure(made: Any, inputs: Signals, which: list[int]) -> Signals:
    """The inputs with ranges for `which`, from random steps."""
    made.action_space.seed(0)
    observation, _ = made.reset(seed=0)
    seen = [flat(made.observation_space, observation)]
    for _ in range(STEPS):
        observation, _, terminated, truncated, _ = made.step(made.action_space.sample())
        seen.append(flat(made.observation_space, observation))
        if terminated or truncated:
            made.reset()
    low, high = inputs.low.copy(), inputs.high.copy()
    least, most = np.min(seen, axis=0), np.max(seen, axis=0)
    for i in which:
        margin = 0.1 * (most[i] - least[i])
        low[i], high[i] = (least[i] - margin, most[i] + margin) if margin > 1e-9 else (-UNBOUNDED, UNBOUNDED)
    return Signals(inputs.names, low, high)


def width(inputs: Signals, i: int) -> float:
    return float(inputs.high[i] - inputs.low[i])


def number(value: float) -> str:
    """Three digits, as TOML."""
    digits = 2 - math.floor(math.log10(abs(value))) if value else 0
    return repr(float(round(value, digits)))


def signal(of: Signals, i: int, comment: str = "") -> str:
    # Outwards, so that the range holds what was seen.
    return f'    {{ name = "{of.names[i]}", min = {number(of.low[i])}, max = {number(of.high[i])} }},{comment}'
