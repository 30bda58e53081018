"""The loop of a controller: receives observations, sends commands and learning records, keeps its state.

As `runtime/controller_loop.rs` of tectum-runtime: every observation goes into a journal before it is answered, the
answer into another before it is sent, and the whole state is kept every `keep_every` observations. A process that
comes back restores the state, repeats the ticks since then, and sends its last answer again under the same sequence
number; who has it drops it. So no tick is learned twice, and none is lost.
"""

import contextlib
import ctypes
import gc
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from .checkpoint import Checkpoints
from .controller_core import ControllerCore
from .crash_store import CrashStore, Ring
from .errors import Mistake, Refused, error_text
from .layouts import Command, Learning, Observation, Role, State
from .participant import Backoff, Participant, TickLoop, program
from .reports import Spread, write
from .shared_memory import WakeWord
from .state import pack, unpack
from .transport import JoinedRun

WAKE_TIMEOUT_MS = 100  # the longest time until the end of a run is noticed


class ControllerPorts(Participant):
    """The controller as a process of a run."""

    def __init__(self, run: JoinedRun, handle_signals: bool = True) -> None:
        super().__init__(run, Role.CONTROLLER, handle_signals)
        try:
            self.wake = WakeWord(run.wire["wake"])
            self.observations = run.reader("observation", Observation, 2)
            self.command = run.writer("command", Command)
            self.learning = run.writer("learning", Learning)
        except Refused:
            raise
        except Exception as cause:
            text = f"the run has a controller already, or none is possible: {error_text(cause)}"
            raise Refused(text, 1) from None
        self.plant = run.peer(Role.PLANT)

    def connected(self) -> bool:
        """Maps the peers' memory, and counts them: a writer of observations, a reader of commands."""
        self.observations.port.has_samples()
        plants = self.observations.factory.dynamic_config.number_of_publishers
        return plants >= 1 and self.command.connected_readers() >= 1

    def await_observation(self) -> Observation | None:
        """Waits for the next observation; in real time for the newest. None when the plant has finished, or will not
        return."""
        backoff = Backoff()
        while True:
            # Read before the channel is, so that samples sent before the plant finished are still received.
            finished = self.plant.get().state == State.FINISHED or self.is_gone(Role.PLANT)
            if (newest := self.observations.receive()) is not None:
                while self.run.real and (newer := self.observations.receive()) is not None:
                    newest = newer
                return newest
            if finished:
                return None
            if self.run.real:
                self.wake.wait(WAKE_TIMEOUT_MS)
            elif not backoff.pause():
                continue
            self.heartbeat()
            self.returned(self.plant, Role.PLANT)


class ControllerLoop(ControllerCore, TickLoop):
    """The loop of ticks around a controller."""

    run: JoinedRun
    resumable = True
    """Whether checkpoints are written."""

    def __init__(self, run: JoinedRun, body: Any, handle_signals: bool = True) -> None:
        super().__init__(run, body)
        self.keep_every = max(int(getattr(body, "keep_every", 64)), 1)
        self.ports = ControllerPorts(run, handle_signals)
        self.incarnation = self.ports.incarnation
        if self.columns:
            write(run.folder / "controller.columns.json", self.columns)
        self.spreads = {"answer": Spread(), "learner": Spread(), "slack": Spread()}
        self.learner_ns = self.overruns = 0
        self.checkpoints = Checkpoints(run, "controller")

    @property
    def process(self) -> Participant:
        return self.ports

    # --- what outlives the process -----------------------------------------------------------------------------

    def open_journals(self) -> None:
        """The journals, in the run's part of shared memory. They reach back to the older of the two kept states."""
        root, entries = Path(self.run.wire["root"]), 4 * self.keep_every
        self.store = CrashStore(root, "controller.python")
        self.observed = Ring(root / "controller.python.observed", entries, ctypes.sizeof(Observation))
        answer = ctypes.sizeof(Command) + ctypes.sizeof(Learning)
        self.answers = Ring(root / "controller.python.answers", entries, answer)

    def whole_state(self) -> list[bytes]:
        """The whole state: what the package keeps, and the author's."""
        own = {
            "answered": bytes(self.answered) if self.answered is not None else None,
            "command": bytes(self.command),
            "learning": bytes(self.learning),
            "acted": self.acted,
            "age": self.age,
            "asked": self.asked,
            "before": self.before,
            "report": self.report,
            "windows": self.windows.state(),
            "counts": self.counts.state(),
        }
        parts = pack(own)
        size = sum(len(part) for part in parts)
        return [size.to_bytes(8, "little"), *parts, *self.packed_state(self.tick())]

    def restore_whole(self, count: int, data: bytes) -> None:
        """Continues from a state that `whole_state` gave after `count` observations."""
        self.count = count
        size = int.from_bytes(data[:8], "little")
        own = unpack(data[8 : 8 + size])
        self.command = Command.from_buffer_copy(own["command"])
        self.learning = Learning.from_buffer_copy(own["learning"])
        self.asked, self.before, self.report = own["asked"], own["before"], own["report"]
        self.acted, self.age = own["acted"], own["age"]
        self.windows.restore(own["windows"])
        self.counts.restore(own["counts"])
        if own["answered"] is not None:
            self.answered = Observation.from_buffer_copy(own["answered"])
        if self.keeps:
            self.call("restore", 0, unpack(data[8 + size :]))

    def recall(self) -> bool:
        """Restores the newest state that was kept, or else that with which the run resumes another one, and repeats the
        ticks since then. Whether a process before this one has answered observations of this run."""
        record = self.store.newest()
        begin = record or self.checkpoints.resumed()
        if begin is not None:
            self.restore_whole(*begin)
        start = self.run.manifest.get("started_from")
        if begin is None and start is not None:
            self.start_from(self.run.folder / "start.controller.safetensors")
        self.started_from = start["tick"] if start is not None else None
        self.frozen = bool(self.run.manifest.get("frozen", False))
        first = self.count
        differs = None
        while (entry := self.observed.entry(self.count)) is not None:
            observation, number = Observation.from_buffer_copy(entry), self.count
            self.respond(observation)
            self.after_command(observation)
            sent = self.answers.entry(number)
            if sent is not None and sent[: ctypes.sizeof(Command)] != self.unstamped():
                differs = observation.header.tick if differs is None else differs
                self.command = Command.from_buffer_copy(sent)
                self.learning = Learning.from_buffer_copy(sent, ctypes.sizeof(Command))
                self.asked = np.array(self.command.drawn[: len(self.run.outputs)], dtype=np.float32)
        if differs is not None:
            text = "answered otherwise than before it was killed, so state() leaves something out"
            print(f"{program()}: warning: {self.author.name} {text} (first at tick {differs})", file=sys.stderr)
        return record is not None or self.count > first

    def unstamped(self) -> bytes:
        """The command without what differs from start to start: instant and start number."""
        copy = Command.from_buffer_copy(self.command)
        copy.header.published_ns = copy.header.incarnation = 0
        return bytes(copy)

    def respond(self, observation: Observation) -> None:
        """Counts the observations that were lost on their way, too: over a pipe none can be."""
        self.report["unseen"] += observation.header.sequence - self.expected()
        super().respond(observation)

    def expected(self) -> int:
        """The sequence number of the next observation, if none is lost."""
        return int(self.answered.header.sequence) + 1 if self.answered is not None else 0

    # --- the loop ----------------------------------------------------------------------------------------------

    def loop(self) -> None:
        ports = self.ports
        self.open_journals()
        returned = self.recall()
        ports.begin(ports.connected)
        gc.freeze()
        if returned:
            self.send()
            self.learning_out()
            self.publish()
        while (observation := ports.await_observation()) is not None:
            if ports.signal:
                ports.heartbeat()
            if observation.header.sequence < self.expected():
                # A plant that came back sends its last observation again, and may not have received the command.
                self.send()
                continue
            self.go_through(observation, time.monotonic_ns())
        self.finish()

    def go_through(self, observation: Observation, arrived: int) -> None:
        """Answers an observation, then does the work for which the plant does not wait."""
        number, real = self.count, self.run.real
        self.observed.append(number, [bytes(observation)])
        # Read while the plant waits: it announces its next checkpoint together with the observation before it.
        checkpoint = self.resumable and self.ports.plant.get().checkpoint == observation.header.tick + 2
        self.respond(observation)
        self.answers.append(number, [self.unstamped(), bytes(self.learning)])
        self.send()
        answered = time.monotonic_ns()
        self.after_command(observation)
        improved = time.monotonic_ns()
        self.learning_out()
        if self.count % self.keep_every == 0:
            self.store.store(self.count, self.whole_state())
        if checkpoint:
            self.checkpoints.write(observation.header.tick + 1, self.count, self.whole_state())
            self.ports.status.checkpoint = observation.header.tick + 2
        if real:
            self.measure(observation.header.scheduled_ns, arrived, answered, improved)
        self.publish()
        self.done += 1

    def measure(self, scheduled: int, arrived: int, answered: int, improved: int) -> None:
        """In real time: how the tick's time was spent."""
        after = scheduled + self.run.period_ns
        self.spreads["answer"].add(answered - arrived)
        self.spreads["learner"].add(improved - answered)
        self.spreads["slack"].add(max(after - time.monotonic_ns(), 0))
        self.learner_ns += improved - answered
        self.overruns += improved > after
        self.ports.status.learner_ns = self.learner_ns

    def stamp(self, sample: "Command | Learning") -> None:
        header = sample.header
        header.published_ns = time.monotonic_ns() if self.run.real else header.scheduled_ns

    def send(self) -> None:
        """Sends the last command."""
        self.stamp(self.command)
        self.ports.command.send(self.command)

    def learning_out(self) -> None:
        """Sends the last learning record."""
        self.stamp(self.learning)
        self.ports.command.append(self.command)
        self.ports.learning.append(self.learning)
        self.ports.learning.send_if_read(self.learning)

    def publish(self) -> None:
        """Puts the counts on the controller's board."""
        status = self.ports.status
        status.ticks = self.tick() + 1 if self.answered is not None else 0
        status.sent, status.lost = self.count, self.report["unseen"]
        status.loss, status.end_error = self.windows.now()
        self.ports.publish_status()

    def finish(self) -> None:
        """Leaves the run in good order: the last checkpoint and the report first."""
        if self.ports.status.state == State.FINISHED:
            return
        with contextlib.suppress(Mistake):  # the mistake for which the controller ends
            end = self.tick() + 1 if self.answered is not None else self.checkpoints.begin
            self.checkpoints.write(end, self.count, self.whole_state(), sync=not self.ports.stopping())
        self.report["checkpoints"], self.failure = self.checkpoints.finish()
        self.write_report()
        self.ports.enter(State.FINISHED)

    def write_report(self) -> None:
        """Writes the report, when the last tick has been answered."""
        write(self.run.folder / "controller.json", self.full_report(self.budget()))

    def budget(self) -> dict[str, Any] | None:
        """In real time: the tick budget of the summary."""
        ticks, slack = sum(self.spreads["learner"].counts.values()), self.spreads["slack"]
        if not ticks:
            return None
        return {
            "period_us": self.run.period_ns / 1000,
            "plant_us": None,
            "answer_us": self.spreads["answer"].percentiles(),
            "learner_us": self.spreads["learner"].percentiles(),
            "learner_share": self.learner_ns / (ticks * self.run.period_ns),
            "learner_overruns": self.overruns,
            "slack_us": {"p50": slack.at(0.5), "p1": slack.at(0.01), "min": slack.at(0.0)},
        }
