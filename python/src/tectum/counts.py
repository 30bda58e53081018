"""What a controller counts of a run, by which the summary judges it: `runtime/run_counts.rs` of tectum-runtime."""

import math
from typing import Any

import numpy as np

from .facts import RunFacts
from .layouts import Flag, Observation

FIRST, LIMITED = int(Flag.FIRST), int(Flag.CLAMPED)
CLAMPED_OR_MISSED = int(Flag.CLAMPED | Flag.MISSED)
# Why nothing was learned from a tick, in the order of the counts. Not among them are 2 and 3, "unarmed" and "tripped".
CAUSES = {"first": 0, "skipped": 1, "blind": 4, "missed": 5, "invalid": 6, "lost": 7, "reward": 8, "corrupted": 9}
TOLERANCE = 1e-6  # how far beyond its range an input may be, as a fraction of the range: rounding is no fault
LARGEST = float(np.finfo(np.float32).max)


class Counts:
    """The counts of a run."""

    def __init__(self, run: RunFacts) -> None:
        low, high = np.array(run.input_ranges, dtype=float).reshape(-1, 2).T
        self.low = (low - TOLERANCE * (high - low)).astype(np.float32)
        self.high = (high + TOLERANCE * (high - low)).astype(np.float32)
        self.least, self.greatest = np.full_like(self.low, np.inf), np.full_like(self.low, -np.inf)
        self.outside = np.zeros(len(run.inputs), dtype=np.int64)
        self.limited = np.zeros(len(run.outputs), dtype=np.int64)
        self.observations = self.rewards = self.rewards_not_finite = 0
        self.reward_range = [math.inf, -math.inf]
        self.not_learned = [0] * 10

    def add(self, observation: Observation, inputs: np.ndarray, asked: np.ndarray, withheld: str | None) -> None:
        """Counts an observation. `asked` is the command of the tick before, and `withheld` why nothing may be
        learned from that tick."""
        flags, reward = observation.header.flags, float(observation.reward)
        np.fmin(self.least, inputs, out=self.least)
        np.fmax(self.greatest, inputs, out=self.greatest)
        self.outside += (inputs < self.low) | (inputs > self.high)
        if not flags & FIRST:
            if math.isfinite(reward):
                self.rewards += 1
                self.reward_range = [min(self.reward_range[0], reward), max(self.reward_range[1], reward)]
            else:
                self.rewards_not_finite += 1
        # A command that was missed is the hold policy's.
        if flags & CLAMPED_OR_MISSED == LIMITED:
            self.limited += np.array(observation.applied[: len(asked)], dtype=np.float32) != asked
        if withheld == "not driven":
            self.not_learned[2 if flags & Flag.UNARMED else 3] += 1
        elif withheld is not None:
            no_reward = withheld == "invalid" and not math.isfinite(reward)
            self.not_learned[CAUSES["reward" if no_reward else withheld]] += 1
        self.observations += 1

    def report(self) -> dict[str, Any]:
        """The counts, as the launcher reads them."""
        seen = self.least <= self.greatest
        ends = (np.where(seen, np.clip(x, -LARGEST, LARGEST), 0.0).tolist() for x in (self.least, self.greatest))
        inputs = zip(*ends, self.outside.tolist())
        return {
            "observations": self.observations,
            "inputs": [{"least": a, "greatest": b, "outside": n} for a, b, n in inputs],
            "limited": self.limited.tolist(),
            "rewards": self.rewards,
            "rewards_not_finite": self.rewards_not_finite,
            "rewards_differed": self.reward_range[0] < self.reward_range[1],
            "not_learned": self.not_learned,
            "outliers": 0,
            "weights_zero": False,
        }

    def state(self) -> dict[str, Any]:
        """All counts."""
        return dict(self.__dict__)

    def restore(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
