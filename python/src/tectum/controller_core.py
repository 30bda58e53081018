"""The controller's half of every tick, without clock and transport: as `runtime/controller.rs` of tectum-runtime."""

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np

from .checkpoint import decode
from .checks import Author
from .controller import WITHHELD, Answer, Controller, Experience, Percept, boundary
from .counts import Counts
from .errors import Mistake, Refused
from .facts import RunFacts
from .layouts import MAX_COLUMNS, Command, Flag, Learning, Observation
from .participant import program
from .reports import Windows
from .state import pack, unpack

FIRST, CLAMPED, BLIND, NEW_TARGET = (int(flag) for flag in (Flag.FIRST, Flag.CLAMPED, Flag.BLIND, Flag.NEW_TARGET))
LEARNED, TRACE_CUT, HASHED, INVALID = (int(flag) for flag in (Flag.LEARNED, Flag.TRACE_CUT, Flag.HASHED, Flag.INVALID))


class ControllerCore:
    """A controller behind its checks: answers observations and fills in the samples of both channels."""

    def __init__(self, run: RunFacts, body: Any) -> None:
        self.run, self.body, self.author = run, body, Author(body, run, "controller")
        self.author.requires("act", "act(percept)", 1)
        self._refuse_what_cannot_be()
        kind = type(body)
        self.learns, self.improves, self.keeps = (
            getattr(kind, name, None) not in (None, getattr(Controller, name)) for name in ("learn", "improve", "state")
        )
        self.updates: int = run.settings.get("controller", {}).get("updates", 1)
        self.columns = [str(name) for name in getattr(body, "columns", ())]
        if len(self.columns) > MAX_COLUMNS:
            raise Refused(f"{self.author.name} has {len(self.columns)} columns; a learning record has room for 8")
        self.command, self.learning = Command(), Learning()
        # Observations answered, and the last of them.
        self.count, self.incarnation = 0, 0
        self.answered: Observation | None = None
        self.acted, self.age = False, 0
        self.asked = np.zeros(len(run.outputs), dtype=np.float32)
        self.before = np.zeros(len(run.outputs), dtype=np.float32)
        counts = ("ticks", "unseen", "unheard", "stale", "learned", "cuts", "invalid", "checkpoints")
        self.report: dict[str, Any] = dict.fromkeys(counts, 0)
        self.windows, self.counts = Windows(run.ticks, run.error), Counts(run)
        # The author's state before the test that goes on.
        self.kept = b""
        self.failure: str | None = None
        """Why not all checkpoints were written."""
        self.started_from: int | None = None
        """The tick of the checkpoint with whose learner it began."""
        self.frozen = False
        """Whether the author is only asked to act, and the mean is sent."""

    def _refuse_what_cannot_be(self) -> None:
        faults = self.run.settings.get("faults", {}).get("channel", [])
        if any(fault["channel"] == "observation" for fault in faults):
            text = f"{program()} cannot make faults on its observations; take them out of [faults]"
            raise Refused(f"{text}, or have commands faulty")
        kind = type(self.body)
        own = [getattr(kind, name, None) not in (None, getattr(Controller, name)) for name in ("state", "restore")]
        if own[0] != own[1]:
            given, missing = ("state", "restore") if own[0] else ("restore", "state")
            raise Refused(f"{self.author.name} has {given}() and no {missing}(); give both, or neither")

    def start_from(self, file: Path) -> None:
        """Begins with what the author had learned in another run. Nothing is learned from the step between the two."""
        facts, state = decode(file)
        if not self.keeps:
            raise Refused(f"{self.author.name} has no state() and restore(), so it cannot begin with what it learned")
        size = int.from_bytes(state[:8], "little")
        self.call("restore", 0, unpack(state[8 + size :]))
        self.started_from = facts["tick"]
        if self.learns:
            inputs, outputs = (np.zeros(len(names), dtype=np.float32) for names in (self.run.inputs, self.run.outputs))
            self.call("learn", 0, Experience(0, inputs, outputs, outputs, False, 0.0, inputs, "truncated", "first"))

    def call(self, method: str, tick: int, *arguments: Any) -> Any:
        """Calls a method of the author's."""
        try:
            return getattr(self.body, method)(*arguments)
        except Exception as cause:
            self.author.failed(method, tick, cause)

    # --- one tick ----------------------------------------------------------------------------------------------

    def respond(self, observation: Observation) -> None:
        """Learns from the tick before, and computes command and learning record."""
        header, tick = observation.header, observation.header.tick
        inputs = np.array(observation.inputs[: len(self.run.inputs)], dtype=np.float32)
        valid = bool(np.isfinite(inputs).all())
        self.age = self.age + 1 if header.flags & BLIND else 0
        withheld = self.withheld(observation, valid)
        flags = self.learn(observation, inputs, withheld) if self.acted and self.answered is not None else 0
        self.counts.add(observation, inputs, self.asked, withheld)
        self.before = np.array(observation.applied[: len(self.run.outputs)], dtype=np.float32)
        command, m = self.command, len(self.run.outputs)
        command.header.flags = 0 if valid else INVALID
        if valid:
            outputs, means = self.act(Percept(tick, inputs, self.age, header.flags))
            outputs = means if self.frozen else outputs
        else:  # a plant in another language sent a number that is none
            outputs = means = [0.0] * m
            self.report["invalid"] += 1
        command.drawn[:m] = outputs
        command.mean[:m] = means
        self.asked, self.acted, self.answered = np.array(outputs, dtype=np.float32), valid, observation
        self.record(observation, flags)

    def act(self, percept: Percept) -> tuple[list[float], list[float]]:
        """Command and mean for a percept."""
        answer, names, numbers = self.call("act", percept.tick, percept), self.run.outputs, self.author.numbers
        drawn, mean = (answer.command, answer.mean) if isinstance(answer, Answer) else (answer, answer)
        outputs = numbers("act", percept.tick, "outputs", drawn, names)
        return outputs, outputs if mean is drawn else numbers("act", percept.tick, "means", mean, names)

    def learn(self, observation: Observation, inputs: np.ndarray, withheld: str | None) -> int:
        """Hands over what became of the last command. Returns the flags of the learning record."""
        if not self.learns or self.frozen or self.answered is None:
            return 0
        answered, n, m = self.answered, len(self.run.inputs), len(self.run.outputs)
        experience = Experience(
            tick=answered.header.tick,
            inputs=np.array(answered.inputs[:n], dtype=np.float32),
            asked=self.asked,
            applied=np.array(observation.applied[:m], dtype=np.float32),
            limited=bool(observation.header.flags & CLAMPED),
            reward=float(observation.reward),
            next_inputs=inputs,
            boundary=boundary(observation.header.flags),
            withheld=withheld,
        )
        learned = self.call("learn", observation.header.tick, experience)
        if experience.withheld is None if learned is None else learned:
            self.report["learned"] += 1
            return LEARNED
        cut = experience.withheld is not None or experience.boundary in ("terminated", "truncated")
        self.report["cuts"] += cut
        return TRACE_CUT if cut else 0

    def withheld(self, observation: Observation, valid: bool) -> str | None:
        """Why nothing may be learned from the tick before an observation."""
        flags = observation.header.flags
        for bits, word in WITHHELD:
            if flags & bits:
                return word
        if self.answered is None or observation.header.tick != self.answered.header.tick + 1:
            return "lost"
        if flags & CLAMPED and not self.gate_could_apply(observation):
            return "corrupted"
        return None if valid and self.acted and math.isfinite(observation.reward) else "invalid"

    def gate_could_apply(self, observation: Observation) -> bool:
        """Whether a gate could have made what was applied: it moves a command to zero, or to the one before."""
        applied = np.array(observation.applied[: len(self.asked)], dtype=np.float32)
        low, high = (f(f(self.asked, self.before), np.float32(0.0)) for f in (np.minimum, np.maximum))
        return bool(((low <= applied) & (applied <= high)).all())

    def record(self, observation: Observation, flags: int) -> None:
        """Fills the learning record, and the headers of both samples."""
        learning, command, tick = self.learning, self.command, observation.header.tick
        for i in range(len(self.run.outputs)):
            learning.noise[i] = command.drawn[i] - command.mean[i]
        if self.columns:
            numbers = self.author.numbers("record", tick, "columns", self.call("record", tick), self.columns)
            learning.columns[: len(numbers)] = numbers
        hashed = self.keeps and (tick % self.run.settings["log"]["hash_every"] == 0 or tick + 1 == self.run.ticks)
        learning.weights_hash = self.state_hash(tick) if hashed else 0
        learning.header.flags = flags | (HASHED if hashed else 0)
        learning.reward = observation.reward if flags & LEARNED else 0.0
        for header in (command.header, learning.header):
            header.run, header.incarnation = self.run.id, self.incarnation
            header.tick, header.sequence = tick, self.count
            header.scheduled_ns = observation.header.scheduled_ns
            header.sensed_ns = observation.header.sensed_ns

    def after_command(self, observation: Observation) -> None:
        """The work for which the plant does not wait."""
        for _ in range(self.updates if self.improves and not self.frozen else 0):
            self.call("improve", observation.header.tick)
        flags = observation.header.flags
        if not flags & FIRST:
            error = self.windows.error
            measured = float(observation.measures[error]) if error is not None else math.nan
            self.windows.add(observation.header.tick - 1, observation.reward, measured, bool(flags & NEW_TARGET))
        self.report["ticks"] += 1
        self.count += 1

    # --- a test of what was learned ----------------------------------------------------------------------------

    def begin_test(self) -> None:
        """Keeps the author's state: a test must not change it."""
        self.kept = b"".join(self.packed_state(self.tick()))

    def answer_test(self, observation: Observation) -> Command:
        """The author's mean for an observation of a test. Nothing is learned or counted."""
        header = observation.header
        inputs = np.array(observation.inputs[: len(self.run.inputs)], dtype=np.float32)
        _, means = self.act(Percept(header.tick, inputs, 0, header.flags))
        command = Command()
        command.header.tick = header.tick
        command.drawn[: len(means)] = command.mean[: len(means)] = means
        return command

    def end_test(self) -> None:
        """Continues from the state that was kept."""
        if self.keeps:
            self.call("restore", self.tick(), unpack(self.kept))

    # --- state and report --------------------------------------------------------------------------------------

    def packed_state(self, tick: int) -> list[bytes]:
        """The author's state as bytes."""
        try:
            return pack(self.call("state", tick) if self.keeps else {})
        except Refused as cause:
            if isinstance(cause, Mistake):
                raise
            self.author.wrong("state", tick, str(cause).replace("state()", "gave a state in which it", 1))

    def state_hash(self, tick: int) -> int:
        """A hash of the author's state."""
        digest = hashlib.blake2b(digest_size=8)
        for part in self.packed_state(tick):
            digest.update(part)
        return int.from_bytes(digest.digest(), "little")

    def tick(self) -> int:
        """The tick that was answered last."""
        return self.answered.header.tick if self.answered is not None else 0

    def full_report(self, budget: dict[str, Any] | None) -> dict[str, Any]:
        """The report, when the last tick has been answered."""
        self.windows.close()
        try:
            hashed = f"{self.state_hash(self.tick()):016x}"
        except Refused:  # the mistake for which the controller ends
            hashed = ""
        nothing: dict[str, Any] = {name: [] for name in ("first_switch", "last_switch", "targets")}
        return self.report | nothing | {
            "started_from": self.started_from,
            "frozen": self.frozen,
            "diverged_at": None,
            "checkpoint_failure": self.failure,
            "tick_budget": budget,
            "weights_hash": hashed,
            "windows": self.windows.windows,
            "counts": self.counts.report(),
        }  # fmt: skip
