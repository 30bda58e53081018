"""A Gymnasium environment in the simulator's place."""

from typing import Any

import gymnasium
import numpy as np

from ..errors import Refused
from ..plant import Outcome, Plant
from ..xxh3 import xxh3_64
from ..transport import JoinedRun
from .spaces import flat, make, signals

REPLAYED = 10_000  # longest episode that a plant which was killed can repeat, steps


class GymPlant:
    """Makes a plant of an environment: `tectum.main(GymPlant("Pendulum-v1"))`.

    `environment` is a name for `gymnasium.make`, an environment, or a function that makes one; `arguments` go with it.
    Names and ranges of inputs and outputs are the scenario's, in the order of the spaces' numbers; `scenario` writes
    one for an environment.
    """

    def __init__(self, environment: Any, **arguments: Any) -> None:
        self.environment, self.arguments = environment, arguments
        self.__name__ = f"GymPlant({environment!r})"

    def __call__(self, run: JoinedRun) -> "GymBody":
        return GymBody(make(self.environment, self.arguments), run)


class GymBody(Plant):
    """The environment, step by step: a tick is a step.

    An episode that ends is followed by the next one at once: the reward of its last step, with `terminated` or
    `truncated`, comes with the first inputs of the next. Each episode has a seed of its own, from the run's seed and
    the episode's number. Measures of the scenario are `return` and `steps`, of the episode so far, or numbers that the
    environment gives in `info` under that name.
    """

    def __init__(self, environment: "gymnasium.Env[Any, Any]", run: JoinedRun) -> None:
        self.environment, self.run = environment, run
        self.name = environment.spec.id if environment.spec else type(environment.unwrapped).__name__
        self.space, actions = environment.observation_space, environment.action_space
        self._check("inputs", run.inputs, signals(self.space, "observation").names)
        limits = signals(actions, "action")
        self._check("outputs", run.outputs, limits.names)
        for name, low, high, (least, most) in zip(run.outputs, limits.low, limits.high, run.output_ranges):
            if least < low - 1e-6 or most > high + 1e-6:
                text = f"{self.name} takes actions from {low:g} to {high:g} there; give that range, and max_command"
                ours = f"the output `{name}` of the scenario goes from {least:g} to {most:g}"
                raise Refused(f"{ours}; {text} under [gate]")
        self.shape, self.kind = actions.shape, actions.dtype
        self.episode, self.fresh = -1, False
        self.totals = {"return": 0.0, "steps": 0.0}
        self.reset()

    def _check(self, what: str, ours: list[str], theirs: list[str]) -> None:
        if len(ours) != len(theirs):
            text = f"the scenario has {len(ours)} {what} ({', '.join(ours)}), and {self.name} has {len(theirs)}"
            raise Refused(f"{text} ({', '.join(theirs)}); list as many under [[plant.{what}]]")

    def reset(self) -> None:
        """Begins the next episode."""
        self.episode += 1
        seed = xxh3_64(f"gymnasium/{self.episode}".encode(), self.run.seed) & 0x7FFF_FFFF
        observation, self.info = self.environment.reset(seed=seed)
        self.inputs = flat(self.space, observation)
        self.actions: list[list[float]] = []
        self.totals = {"return": 0.0, "steps": 0.0}
        self.fresh = True

    def step(self, applied: list[float]) -> tuple[float, bool, bool]:
        """One step of the environment."""
        self.actions.append(applied)
        action = np.asarray(applied, dtype=self.kind).reshape(self.shape)
        observation, reward, terminated, truncated, self.info = self.environment.step(action)
        self.inputs = flat(self.space, observation)
        self.totals["return"] += float(reward)
        self.totals["steps"] += 1.0
        return float(reward), bool(terminated), bool(truncated)

    def sense(self, tick: int, inputs: np.ndarray) -> bool:
        inputs[:] = self.inputs
        fresh, self.fresh = self.fresh, False
        return fresh

    def advance(self, tick: int, applied: list[float]) -> Outcome:
        reward, terminated, truncated = self.step(applied)
        measures = [float(self.totals.get(name, self.info.get(name, 0.0))) for name in self.run.measures]
        if terminated or truncated:
            self.reset()
        return Outcome(reward, measures, "terminated" if terminated else "truncated" if truncated else None)

    def state(self) -> dict[str, Any]:
        """The episode and its actions so far: enough to repeat it. Nothing for an episode that is too long for that."""
        if len(self.actions) > REPLAYED:
            raise Refused(f"{self.name} has episodes of more than {REPLAYED:,} steps, too many to keep", 4)
        return {"episode": self.episode, "actions": np.array(self.actions, dtype=np.float32), "fresh": self.fresh}

    def restore(self, state: dict[str, Any]) -> None:
        self.episode = state["episode"] - 1
        self.reset()
        for action in state["actions"].tolist():
            self.step(action)
        self.fresh = state["fresh"]
