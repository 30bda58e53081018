"""A run as a Gymnasium environment: the program that makes it takes the controller's place."""

import contextlib
import math
import os
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import gymnasium
import numpy as np
from gymnasium import spaces

from ..controller import NEW_TARGET, TERMINATED, TRUNCATED, Controller, Percept
from ..controller_loop import ControllerLoop
from ..errors import Ended, Refused
from ..launch import Failed, RunHandle, Summary, start
from ..layouts import Flag, Observation, Phase, Role, State
from ..transport import JoinedRun


class Asked(Controller):
    """Answers with the action of the step in progress."""

    def __init__(self) -> None:
        self.outputs: Sequence[float] = ()

    def act(self, percept: Percept) -> Sequence[float]:
        return self.outputs


class TectumEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """The plant of a run, with its gate, as an environment.

    A step is a tick: it answers the newest observation with the action and waits for the next one; in real time that is
    the scenario's period later, and an action that comes too late is missed (`info["withheld"]`). Observations are the
    inputs and actions the outputs, in the scenario's units and ranges.

    An episode ends when the plant says so, when a new target begins (truncated; `info["new_target"]`), after
    `episode_ticks`, and with the run's last tick. `reset()` goes on with the same run from where the plant is: an arm
    cannot be put anywhere else. `reset(seed=..)`, and a reset after the run's last tick, start a new run; in lockstep
    the same seed and actions give the same numbers.

    Runs lie in a folder of their own, which is removed at the end; `out` names one to keep.
    """

    def __init__(
        self,
        scenario: str | os.PathLike[str] = "arm",
        *,
        mode: str | None = None,
        seed: int | None = None,
        ticks: float | None = None,
        episode_ticks: int | None = None,
        end_at_targets: bool = True,
        out: str | os.PathLike[str] | None = None,
        arguments: Sequence[str] = (),
    ) -> None:
        self.scenario, self.mode, self.ticks, self.arguments = scenario, mode, ticks, arguments
        self.episode_ticks, self.end_at_targets = episode_ticks, end_at_targets
        self.temporary = tempfile.TemporaryDirectory(prefix="tectum-env-") if out is None else None
        self.out = Path(self.temporary.name if self.temporary else out)  # type: ignore[arg-type]
        self.runs, self.seed, self.begun, self.steps = 0, seed, False, 0
        self.handle: RunHandle | None = None
        self.loop: ControllerLoop | None = None
        self.last: Observation | None = None
        self.summary: Summary | None = None
        """The summary of the last run that has ended."""
        self.said: str | None = None
        self._start()

    # --- Gymnasium's methods -----------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        over = self.last is not None and self.last.header.tick + 1 >= self.run.ticks
        if seed is not None and (self.begun or seed != self.run.seed) or over or self.loop is None:
            if seed is not None:
                self.seed = seed
            elif self.seed is not None:
                self.seed += 1
            self._end()
            self._start()
        self.steps = 0
        if not self.begun:
            self._begin()
        assert self.last is not None
        return self._inputs(self.last), self._info(self.last, None)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        if not self.begun or self.last is None or self.last.header.tick + 1 >= self.run.ticks:
            raise gymnasium.error.ResetNeeded("call reset() before step(): no episode is going on")
        assert self.loop is not None
        self._answer(self.loop, np.asarray(action, dtype=np.float32).ravel().tolist())
        observation = self._next()
        self.last, self.steps = observation, self.steps + 1
        flags = observation.header.flags
        terminated = bool(flags & TERMINATED)
        ends = (
            flags & TRUNCATED,
            self.end_at_targets and flags & NEW_TARGET and not terminated,
            self.episode_ticks is not None and self.steps >= self.episode_ticks,
            observation.header.tick + 1 >= self.run.ticks,
        )
        info = self._info(observation, self.loop.withheld(observation, True))
        return self._inputs(observation), float(observation.reward), terminated, any(map(bool, ends)), info

    def close(self) -> None:
        """Ends the run in good order."""
        self._end()
        if self.temporary is not None:
            self.temporary.cleanup()

    def __del__(self) -> None:
        with contextlib.suppress(Exception):
            self._end()

    # --- the run -----------------------------------------------------------------------------------------------

    def _start(self) -> None:
        """Starts a run, which waits for this program to take the controller's place."""
        self.runs += 1
        folder = self.out / f"run-{self.runs}"
        while folder.exists():
            self.runs += 1
            folder = self.out / f"run-{self.runs}"
        self.handle = start(
            self.scenario,
            mode=self.mode,
            seed=self.seed,
            ticks=self.ticks,
            out=folder,
            by_hand=["controller"],
            arguments=self.arguments,
        )
        self.run: JoinedRun = self.handle.join()
        self.loop, self.last, self.begun = ControllerLoop(self.run, Asked(), handle_signals=False), None, False
        # With 0 the launcher does not wait for this program to end, or end it: it goes on after the run.
        self.loop.ports.status.pid = 0
        # Whoever gives the actions keeps no state here with which another run could continue.
        self.loop.resumable = False
        ranges = np.array(self.run.input_ranges, dtype=np.float32), np.array(self.run.output_ranges, dtype=np.float32)
        self.observation_space, self.action_space = (spaces.Box(r[:, 0], r[:, 1], dtype=np.float32) for r in ranges)
        self.ranges = ranges[0].T

    def _begin(self) -> None:
        """Takes the controller's place, and waits for the first observation."""
        assert self.loop is not None
        try:
            self.loop.ports.begin(self.loop.ports.connected)
        except (Ended, Refused) as cause:
            self._failed(cause)
        self.begun = True
        self.last = self._next()

    def _answer(self, loop: ControllerLoop, outputs: list[float]) -> None:
        """Answers the newest observation."""
        assert self.last is not None and isinstance(loop.body, Asked)
        if len(outputs) != len(self.run.outputs):
            names = ", ".join(self.run.outputs)
            raise ValueError(f"the action has {len(outputs)} numbers; the plant has {len(self.run.outputs)}: {names}")
        if not all(map(math.isfinite, outputs)):
            raise ValueError(f"the action {outputs} has a value that is not finite")
        loop.body.outputs = outputs
        loop.respond(self.last)
        loop.send()
        loop.after_command(self.last)
        loop.learning_out()
        loop.publish()

    def _next(self) -> Observation:
        """The next observation."""
        assert self.loop is not None
        try:
            observation = self.loop.ports.await_observation()
        except (Ended, Refused) as cause:
            self._failed(cause)
        if observation is None:
            self._failed(Ended("the plant has ended"))
        return observation

    def _failed(self, cause: Exception) -> NoReturn:
        """Raises what the launcher says of a run that ended before its time."""
        handle, loop = self.handle, self.loop
        self.handle = self.loop = self.summary = None
        text = str(cause)
        if handle is not None and loop is not None:
            self._report(loop)
            self._leave(handle, loop)
            text = self.said or text
        raise RuntimeError(f"the run has ended: {text}; reset() starts another") from None

    def _end(self) -> None:
        """Ends the run, and keeps its summary."""
        handle, loop = self.handle, self.loop
        self.handle = self.loop = None
        if handle is None or loop is None:
            return
        if self.begun:
            self._last_tick(handle, loop)
        else:
            handle.process.terminate()
        self._leave(handle, loop)

    def _leave(self, handle: RunHandle, loop: ControllerLoop) -> None:
        """Gives the controller's place up, and waits for the launcher's summary."""
        loop.ports.enter(State.FINISHED)
        loop.ports.__dict__.clear()
        try:
            self.summary = handle.wait(check=False)
            self.said = self.summary.facts.get("failure")
        except Failed as cause:
            self.said = str(cause)
        self.run.close()
        self.begun = False

    def _last_tick(self, handle: RunHandle, loop: ControllerLoop) -> None:
        """Answers the last observation of a run that has come to its end; stops one that has not."""
        try:
            if self.last is None or self.last.header.tick + 1 < self.run.ticks:
                handle.process.terminate()
                while not self.run.over():
                    loop.ports.heartbeat()
                    time.sleep(0.0005)
            if self.last is not None:
                # In lockstep the plant waits for this before it ends.
                self._answer(loop, [0.0] * len(self.run.outputs))
            self._report(loop)
            done = (State.FINISHED, State.FAILED)
            while loop.ports.plant.get().state not in done and self.run.control.get().phase < Phase.ABORT:
                if loop.ports.is_gone(Role.PLANT):
                    break
                loop.ports.heartbeat()
                loop.ports.observations.receive()
                time.sleep(0.0005)
        except (Ended, Refused):
            pass

    @staticmethod
    def _report(loop: ControllerLoop) -> None:
        with contextlib.suppress(OSError):  # the launcher has tidied up already
            loop.write_report()

    # --- what a step gives -------------------------------------------------------------------------------------

    def _inputs(self, observation: Observation) -> np.ndarray:
        inputs = np.array(observation.inputs[: len(self.run.inputs)], dtype=np.float32)
        return np.clip(inputs, *self.ranges)

    def _info(self, observation: Observation, reason: str | None) -> dict[str, Any]:
        """Tick, flags, what was applied, measures, and why nothing may be learned from the step (None if it may)."""
        flags = observation.header.flags
        return {
            "tick": observation.header.tick,
            "flags": flags,
            "applied": np.array(observation.applied[: len(self.run.outputs)], dtype=np.float32),
            "limited": bool(flags & Flag.CLAMPED),
            "new_target": bool(flags & NEW_TARGET),
            "withheld": reason,
            **dict(zip(self.run.measures, observation.measures)),
        }
