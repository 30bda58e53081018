"""A plant's body behind its gate, and its loop of ticks."""

import ctypes
import gc
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .checkpoint import Checkpoints
from .checks import Author
from .crash_store import CrashStore
from .errors import Refused, error_text
from .gate import CommandAhead, Gate
from .layouts import CREDIT, LOG_BUFFER, MAX_OUTPUTS, Ahead, Command, Flag, Observation, Role, State
from .participant import Backoff, Participant, TickLoop, program
from .reports import Spread, write
from .shared_memory import WakeWord
from .state import pack, unpack
from .transport import JoinedRun

MISSED, SKIPPED, UNHEARD, LATE, NEW_TARGET = (
    int(flag) for flag in (Flag.MISSED, Flag.SKIPPED, Flag.UNHEARD, Flag.LATE, Flag.NEW_TARGET)
)
ENDS = {"terminated": int(Flag.TERMINATED), "truncated": int(Flag.TRUNCATED)}
# How often a checkpoint is announced again. A controller may write none at all.
MOST_REPEATS = 8
EPISODE_END = int(Flag.TERMINATED | Flag.TRUNCATED)
COUNTED = {
    "missed": MISSED,
    "ahead": int(Flag.AHEAD),
    "clamped": int(Flag.CLAMPED),
    "step_limited": int(Flag.STEP_LIMITED),
    "ramped": int(Flag.RAMPED),
    "position_limited": int(Flag.POSITION_LIMITED),
    "non_finite": int(Flag.NON_FINITE),
}


class Outcome(NamedTuple):
    """What a tick came to. `measures` has a number for each measure of the scenario. `end` is `terminated` where an
    episode ended with this tick and the value after it is 0, and `truncated` where it was cut off; the inputs that
    follow are those of the next episode."""

    reward: float
    measures: Sequence[float] = ()
    end: str | None = None


class Plant(ABC):
    """What is controlled: a body with two methods. It is made with the run that it takes part in."""

    @abstractmethod
    def sense(self, tick: int, inputs: np.ndarray) -> bool | None:
        """Writes the inputs of `tick` into `inputs`, in place and in the scenario's order and units. True when a new
        target begins."""

    @abstractmethod
    def advance(self, tick: int, applied: list[float]) -> "Outcome | tuple[float, Sequence[float]]":
        """Goes through one tick with this command. Returns the reward, and the measures of the scenario."""

    # A plant may have three more methods:
    # joints() -> (positions, travel): for the gate's position limits: where each joint is, and how far a command of 1
    #     moves it in a tick.
    # state() -> dict, restore(state): what a killed plant needs to go on where it was, in lockstep bit for bit.


class PlantPorts(Participant):
    """The plant as a process of a run."""

    def __init__(self, run: JoinedRun) -> None:
        super().__init__(run, Role.PLANT)
        try:
            self.out = run.writer("observation", Observation)
            self.wake = WakeWord(run.wire["wake"])
            self.commands = run.reader("command", Command, 2)
            self.ahead = run.reader("ahead", Ahead, 2) if "ahead" in run.wire["services"] else None
        except Refused:
            raise
        except Exception as cause:
            raise Refused(f"the run has a plant already, or none is possible: {error_text(cause)}", 1) from None
        self.controller, self.logger = run.peer(Role.CONTROLLER), run.peer(Role.LOGGER)

    def connected(self) -> bool:
        """Maps the peers' memory, and counts them: a reader of observations, a writer of commands."""
        self.commands.port.has_samples()
        writers = self.commands.factory.dynamic_config.number_of_publishers
        return self.out.connected_readers() >= 1 and writers >= 1


class PlantLoop(TickLoop):
    """The loop of ticks."""

    def __init__(self, run: JoinedRun, body: Any) -> None:
        self.run, self.body, self.author = run, body, Author(body, run, "plant")
        self.author.requires("sense", "sense(tick, inputs)", 2)
        self.author.requires("advance", "advance(tick, applied)", 2)
        self.gate = Gate(run.settings["gate"], len(run.outputs))
        self._refuse_what_cannot_be()
        self.participant = PlantPorts(run)
        self.report: dict[str, Any] = dict.fromkeys(("ticks", "late", "skipped", *COUNTED, "checkpoints"), 0)
        self.observation, self.flags = Observation(), int(Flag.FIRST)
        self.observation.header.run = run.id
        self.observation.header.incarnation = self.participant.incarnation
        self.inputs = np.ctypeslib.as_array(self.observation.inputs)[: len(run.inputs)]
        self.expected, self.late = 0, 0
        self.found: Command | None = None
        # The newest commands ahead.
        self.ahead: Ahead | None = None
        self.answered = Spread()
        self.remembers = hasattr(body, "state") and hasattr(body, "restore")
        self.store: CrashStore | None = None
        self.checkpoints = Checkpoints(run, "plant")
        # Checkpoints that had been asked for when the last one was announced.
        self.asked = run.control.get().checkpoints
        # The last one that was written, as it is announced, and how often the announced one may be announced again.
        self.written, self.repeats = 0, 0

    @property
    def process(self) -> Participant:
        return self.participant

    def _refuse_what_cannot_be(self) -> None:
        """A plant that cannot do what the scenario asks for says so before it is ready."""
        name = program()
        if self.gate.positions:
            if not hasattr(self.body, "joints"):
                text = f"{self.author.name} has no method joints(), so that the gate cannot limit positions"
                raise Refused(f"{text}; add it, or take positions out of [gate]")
            self.author.requires("joints", "joints()", 0)
        if any(fault["channel"] == "command" for fault in self.run.settings.get("faults", {}).get("channel", [])):
            text = f"{name} cannot make faults on its commands; take them out of [faults]"
            raise Refused(f"{text}, or have observations faulty")

    # --- one tick ----------------------------------------------------------------------------------------------

    def receive_command(self, tick: int) -> bool:
        """Whether the command of `tick` has arrived. Counts older ones as late, and drops those sent twice."""
        while (command := self.participant.commands.receive()) is not None:
            header = command.header
            if header.sequence < self.expected:
                continue
            self.expected = header.sequence + 1
            if self.run.real:
                self.answered.add(max(header.published_ns - header.sensed_ns, 0))
            if header.tick == tick:
                self.found = command
            else:
                self.late += 1
        return self.found is not None

    def command_ahead(self, tick: int) -> CommandAhead | None:
        """What came ahead for `tick`, and its age. It is sent before the command that it belongs to."""
        reader = self.participant.ahead
        while reader is not None and (ahead := reader.receive()) is not None:
            self.ahead = ahead
        if self.ahead is None:
            return None
        age = tick - self.ahead.header.tick
        if not 1 <= age <= min(self.ahead.ticks, self.run.settings["link"]["ahead"]):
            return None
        first = (age - 1) * MAX_OUTPUTS
        return list(self.ahead.commands[first : first + MAX_OUTPUTS]), age

    def advance(self, tick: int, passed_over: bool = False) -> None:
        """Advances by `tick` with the command found for it. A command flagged UNHEARD counts as none. In a tick that is
        passed over, a command ahead would be for a time that is gone."""
        command, self.found, author = self.found, None, self.author
        drawn = None if command is None or command.header.flags & UNHEARD else list(command.drawn)
        # An episode that ended in a tick that the plant passed over is told with the next observation.
        ended = self.flags & EPISODE_END
        ahead = None if passed_over else self.command_ahead(tick)
        applied, self.flags = self.gate.go(drawn, self.joints(tick) if self.gate.positions else None, ahead)
        self.flags |= ended
        for key, bit in COUNTED.items():
            self.report[key] += bool(self.flags & bit)
        try:
            outcome = self.body.advance(tick, list(applied))
        except Exception as cause:
            author.failed("advance", tick, cause)
        reward, measures = self.outcome(tick, outcome)
        self.observation.applied = tuple(applied)
        self.observation.reward = reward
        self.observation.measures = tuple(measures)

    def outcome(self, tick: int, outcome: Any) -> tuple[float, list[float]]:
        """Reward and measures, checked."""
        author, names = self.author, self.run.measures
        if not isinstance(outcome, (tuple, list)):
            if names or outcome is None:
                pair = f"(reward, [{', '.join(names)}])"
                author.wrong("advance", tick, f"gave {outcome!r}; it returns a pair: {pair}")
            outcome = (outcome, ())
        if len(outcome) == 3 and outcome[2] in (None, *ENDS):
            self.flags |= ENDS.get(outcome[2], 0)
        elif len(outcome) != 2:
            text = "it returns reward, measures, and `terminated` or `truncated` where an episode ended"
            author.wrong("advance", tick, f"gave {len(outcome)} values; {text}")
        reward = author.number("advance", tick, "reward", outcome[0])
        return reward, author.numbers("advance", tick, "measures", outcome[1], names)

    def joints(self, tick: int) -> tuple[list[float], list[float]]:
        """Positions and travel of the joints, checked."""
        try:
            joints = self.body.joints()
        except Exception as cause:
            self.author.failed("joints", tick, cause)
        if not isinstance(joints, (tuple, list)) or len(joints) != 2:
            self.author.wrong("joints", tick, f"gave {joints!r}; it returns two lists: positions, travel")
        numbers = self.author.numbers
        positions, travel = (numbers("joints", tick, what, joints[i], self.run.outputs)
                             for i, what in enumerate(("positions", "travel")))  # fmt: skip
        return positions, travel

    def observe(self, tick: int, late: int, skipped: int) -> None:
        """Fills in the observation of `tick`."""
        # What is still not a number after the call was not set.
        self.inputs.fill(math.nan)
        try:
            fresh = self.body.sense(tick, self.inputs)
        except Exception as cause:
            self.author.failed("sense", tick, cause)
        self.author.check_inputs(tick, self.inputs)
        if fresh is not None and not isinstance(fresh, (bool, np.bool_)):
            self.author.wrong("sense", tick, f"gave {fresh!r}; it returns True when a new target begins, else False")
        self.observation.skipped = skipped
        header = self.observation.header
        header.tick = tick
        header.flags = self.flags | (LATE if late else 0) | (SKIPPED if skipped else 0) | (NEW_TARGET if fresh else 0)
        self.flags &= ~EPISODE_END
        self.report["ticks"] += 1

    # --- what outlives the process -----------------------------------------------------------------------------

    def remember(self, tick: int) -> None:
        """Keeps the whole state, with the observation that is about to be sent."""
        if self.store is not None:
            self.store.store(tick, self.whole_state(tick))

    def whole_state(self, tick: int) -> list[bytes]:
        """The whole state, with the last observation."""
        state = {
            "body": self.body_state(tick),
            "gate": self.gate.state(),
            "flags": self.flags,
            "report": self.report,
            "expected": self.expected,
            "observation": bytes(self.observation),
        }
        if self.ahead is not None:
            state["ahead"] = bytes(self.ahead)
        try:
            return pack(state)
        except Refused as cause:
            self.author.wrong("state", tick, str(cause))

    def body_state(self, tick: int) -> Any:
        try:
            return self.body.state()
        except Exception as cause:
            self.author.failed("state", tick, cause)

    def recall(self) -> bool:
        """Restores the state in which a killed plant died. False if there is none."""
        if not self.remembers:
            return False
        self.store = CrashStore(Path(self.run.wire["root"]), "plant.python")
        record = self.store.newest()
        if record is not None:
            self.restore_whole(*record)
        return record is not None

    def resume(self) -> bool:
        """Restores the state with which the run goes on. False if it begins anew."""
        resumed = self.checkpoints.resumed()
        if resumed is not None:
            self.participant.status.sent, data = resumed
            self.restore_whole(self.checkpoints.begin, data)
        return resumed is not None

    def restore_whole(self, tick: int, data: bytes) -> None:
        """Continues from a state that `whole_state` gave."""
        state = unpack(data)
        try:
            self.body.restore(state["body"])
        except Exception as cause:
            self.author.failed("restore", tick, cause)
        self.gate.restore(state["gate"])
        self.flags, self.report, self.expected = state["flags"], state["report"], state["expected"]
        if "ahead" in state:
            self.ahead = Ahead.from_buffer_copy(state["ahead"])
        ctypes.memmove(ctypes.addressof(self.observation), state["observation"], ctypes.sizeof(Observation))
        self.observation.header.incarnation = self.participant.incarnation
        self.observation.header.run = self.run.id

    def checkpoint(self, tick: int) -> None:
        """Writes the checkpoint that was announced for this tick, and announces the next one."""
        status, every = self.participant.status, self.checkpoints.every
        announced = status.checkpoint
        if self.remembers and announced == tick + 1:
            self.checkpoints.write(tick, status.sent, self.whole_state(tick))
            self.written = announced
        # One tick ahead, before the observation is sent: the controller takes its own after its command.
        asked = self.run.control.get().checkpoints
        if asked != self.asked or (every > 0 and (tick + 1) % every == 0):
            self.repeats = MOST_REPEATS if self.remembers and self.run.real else 0
        elif self.passed_over(announced, tick):
            self.repeats -= 1
        else:
            return
        self.asked, status.checkpoint = asked, tick + 2
        self.participant.publish_status()

    def passed_over(self, announced: int, tick: int) -> bool:
        """Whether plant or controller, in real time, have passed over the tick of the announced checkpoint. A run goes
        on from a pair only, so it is announced again."""
        if self.repeats == 0:
            return False
        self.participant.returned(self.participant.controller, Role.CONTROLLER)
        controller = self.participant.controller.get()
        ours, theirs = self.written == announced, controller.checkpoint == announced
        if ours and theirs:
            self.repeats = 0
        return (not ours and announced <= tick) or (not theirs and controller.ticks + 1 >= announced)

    # --- the loop ----------------------------------------------------------------------------------------------

    def wait(self, t0: int, tick: int, advanced: bool) -> bool:
        """Waits until `tick` begins: for its instant in real time, for the command of the tick before in lockstep.
        False when the run ends first."""
        participant, backoff = self.participant, Backoff()
        if self.run.real:
            due = t0 + tick * self.run.period_ns
            while (now := time.monotonic_ns()) < due:
                time.sleep(min(due - now, 50_000_000) / 1e9)
                if due - now > 50_000_000 and participant.heartbeat():
                    return False
            return not participant.heartbeat()
        while not (advanced or self.receive_command(tick - 1)):
            if backoff.pause():
                # The command is on its way, unless the controller was killed before it received the observation.
                if participant.returned(participant.controller, Role.CONTROLLER):
                    participant.out.send(self.observation)
                participant.heartbeat()
                if participant.is_gone(Role.CONTROLLER):
                    return False
        return True

    def credit(self, tick: int) -> bool:
        """In lockstep: waits until the logger's buffer has room. False when the run is to end first."""
        while self.participant.logger.get().consumed + LOG_BUFFER < tick + CREDIT:
            self.participant.returned(self.participant.logger, Role.LOGGER)
            if self.participant.heartbeat():
                return False
            time.sleep(0.0001)
        return True

    def start(self) -> tuple[int, int, bool]:
        """Joins the run, or rejoins it. Returns the start of tick 0, the tick to begin with, and whether the plant has
        advanced to it."""
        participant, run = self.participant, self.run
        recalled = self.recall()
        resumed = not recalled and self.resume()
        if participant.incarnation and not run.real and not (recalled or resumed):
            text = f"{program()} died and remembers nothing: in lockstep it cannot come back"
            raise Refused(f"{text}; give {self.author.name} the methods state() and restore(state)")
        t0 = participant.begin(participant.connected)
        if recalled:
            header = self.observation.header
            participant.status.sent = header.sequence + 1
            # It may have died before it sent it. Who has it already drops it.
            participant.out.send(self.observation)
            participant.out.append(self.observation)
            return t0, header.tick + 1, False
        if participant.before is not None and participant.before.sent:
            # The body stood still while no process drove it: the ticks in between are missed.
            participant.status.sent = participant.before.sent
            return t0, participant.before.ticks + 1, False
        return t0, self.checkpoints.begin, True

    def loop(self) -> None:
        participant, run, report = self.participant, self.run, self.report
        self.spreads = {"wake_up": Spread(), "observation_to_command": self.answered, "work": Spread()}
        t0, tick, advanced = self.start()
        report = self.report
        gc.freeze()
        clock, overruns, back = time.monotonic_ns, 0, bool(participant.incarnation)
        most = run.settings.get("overrun", {}).get("max_consecutive", 0)
        given_up = None
        while self.wait(t0, tick, advanced):
            woken = clock()
            if not advanced:
                self.receive_command(tick - 1)
                self.advance(tick - 1)
            late, self.late = self.late, 0
            report["late"] += late
            # A plant that wakes up a period late or more passes over those ticks. It never makes them up in a burst.
            due = max(min((woken - t0) // run.period_ns, run.ticks), tick) if run.real else tick
            if run.real:
                self.spreads["wake_up"].add(max(woken - t0 - tick * run.period_ns, 0))
            for passed in range(tick, due):
                self.advance(passed, passed_over=True)
            skipped, tick = due - tick, due
            report["skipped"] += skipped
            self.publish(tick)
            overruns = 0 if back or not skipped else overruns + skipped
            back = False
            if run.real and 0 < most < overruns:
                given_up = f"passed over {overruns} ticks in a row at tick {tick}; max_consecutive is {most}"
                break
            if tick >= run.ticks or participant.stopping():
                break
            if not run.real and tick % CREDIT == 0 and not self.credit(tick):
                break
            self.checkpoint(tick)
            self.observe(tick, late, skipped)
            self.send(t0, tick, woken)
            tick, advanced, self.done = tick + 1, False, self.done + 1
        participant.heartbeat()
        if self.remembers:
            self.checkpoints.write(tick, participant.status.sent, self.whole_state(tick), not participant.stopping())
        self.finish()
        if given_up:
            raise Refused(given_up, 4)

    def publish(self, tick: int) -> None:
        """Puts the counts on the plant's board."""
        status, report = self.participant.status, self.report
        status.ticks, status.missed, status.late, status.lost = (
            tick, report["missed"], report["late"], report["skipped"],
        )  # fmt: skip
        self.participant.publish_status()

    def send(self, t0: int, tick: int, woken: int) -> None:
        """Sends the observation, and wakes the controller."""
        participant, run, header = self.participant, self.run, self.observation.header
        header.sequence = participant.status.sent
        header.scheduled_ns = t0 + tick * run.period_ns if run.real else tick * run.period_ns
        header.sensed_ns = header.published_ns = time.monotonic_ns() if run.real else header.scheduled_ns
        self.remember(tick)
        participant.out.send(self.observation)
        if run.real:
            participant.wake.notify()
            self.spreads["work"].add(time.monotonic_ns() - woken)
        participant.out.append(self.observation)
        participant.status.sent += 1

    def finish(self) -> None:
        """Leaves the run in good order: the report first."""
        if self.participant.status.state == State.FINISHED:
            return
        self.report["checkpoints"], failure = self.checkpoints.finish()
        report = self.report | {"checkpoint_failure": failure}
        report |= {name: spread.percentiles() if self.run.real else None for name, spread in self.spreads.items()}
        write(self.run.folder / "plant.json", report)
        self.participant.enter(State.FINISHED)
        self.participant.wake.notify()
