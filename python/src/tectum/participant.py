"""A process of a run: its status board, the phases of the run, heartbeats, signals, and real-time settings."""

import ctypes
import math
import os
import signal
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .errors import Ended, Mistake, Refused, error_text
from .layouts import Phase, Role, State, Status
from .reports import write
from .transport import Board, JoinedRun


YIELDS_NS = 2_000_000  # how long a wait in lockstep yields the processor before it naps


class Backoff:
    """The pauses of a wait in lockstep: first it yields the processor, then it naps."""

    def __init__(self) -> None:
        self.began, self.turns, self.naps = time.monotonic_ns(), 0, False

    def pause(self) -> bool:
        """Pauses. True if it is time to look at the run's phase."""
        self.turns += 1
        if self.naps:
            time.sleep(0.00005)
            return True
        os.sched_yield()
        look = self.turns % 64 == 0
        # On a busy machine a yield takes long, so the time counts, not the turns.
        self.naps = time.monotonic_ns() - self.began > YIELDS_NS
        return look


def program() -> str:
    """The name of the script that is running."""
    return Path(sys.argv[0]).name or "python"


class Participant:
    """The process in `role` of a run. Where it cannot be, `Refused` says why."""

    def __init__(self, run: JoinedRun, role: Role, handle_signals: bool = True) -> None:
        self.run, self.role, self.name = run, role, role.name.lower()
        self.incarnation: int = run.control.get().incarnations[role]
        try:
            self.port, self.board = run.board_writer(role, self.incarnation)
        except Exception as cause:
            raise Refused(f"the run has a {self.name} already, or none is possible: {error_text(cause)}", 1) from None
        wire = run.wire
        self.status = Status(
            pid=os.getpid(),
            loss=math.nan,
            end_error=math.nan,
            schema=int(wire["schema"], 16),
            scenario=int(wire["scenario"], 16),
            build=int(wire["build_hash"], 16),
        )
        self.before: Status | None = None
        if self.incarnation:
            self.before = run.board(wire["services"]["boards"][role], Status, self.incarnation - 1).get()
        self.signal = 0
        if handle_signals:
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
                # A SIGHUP that this process was started to ignore, as by nohup, stays ignored.
                if signal.getsignal(number) != signal.SIG_IGN or number != signal.SIGHUP:
                    signal.signal(number, self.interrupt)

    def interrupt(self, number: int, _frame: Any) -> None:
        self.signal = number

    def publish_status(self) -> None:
        """Writes a heartbeat and the progress to the status board."""
        self.status.beat += 1
        self.board.update_with_copy(self.status)

    def enter(self, state: State) -> None:
        """Enters a state and publishes it."""
        self.status.state = state
        self.publish_status()

    def heartbeat(self) -> bool:
        """Writes a heartbeat. True when the run is to end in good order; raises when it ends at once."""
        self.publish_status()
        if self.signal:
            raise Refused(f"was ended by signal {self.signal}", 128 + self.signal)
        phase = self.run.control.get().phase
        if phase == Phase.ABORT:
            raise Ended("the run was ended")
        if self.run.orphaned():
            raise Ended("the launcher is gone")
        return bool(phase == Phase.STOP)

    def stopping(self) -> bool:
        """Whether the run is ending; cheap enough for every tick."""
        return bool(self.signal or self.run.control.get().phase >= Phase.STOP)

    def is_gone(self, role: Role) -> bool:
        """Whether the process in `role` has ended without finishing and will not return."""
        return bool(self.run.control.get().gone >> role & 1)

    def begin(self, connected: Callable[[], bool]) -> int:
        """Ready, Connect, Connected, Run. Gives the start of tick 0, ns."""
        if self.run.real:
            self.realtime()
        self.enter(State.READY)
        self.until(lambda: bool(self.run.control.get().phase >= Phase.CONNECT))
        # A process that comes back connects once: its peers may be coming back themselves.
        self.until(lambda: connected() or self.incarnation > 0)
        self.enter(State.CONNECTED)
        self.until(lambda: bool(self.run.control.get().phase >= Phase.RUN))
        self.enter(State.RUNNING)
        return int(self.run.control.get().t0_ns)

    def until(self, ready: Callable[[], bool]) -> None:
        """Waits until `ready()`."""
        while not ready():
            self.heartbeat()
            time.sleep(0.0005)

    def returned(self, board: Board[Status], role: Role) -> bool:
        """True once for each restart of `role`, when its ports are there."""
        board.awaited = board.turn_to(self.run.control.get().incarnations[role]) or board.awaited
        back = board.awaited and bool(board.get().state >= State.RUNNING)
        board.awaited = board.awaited and not back
        return back

    def realtime(self) -> None:
        """Asks the operating system for what `[realtime]` wants, and writes what it granted. What this package does not
        ask for is reported as refused."""
        asked = self.run.settings.get("realtime", {}).get(self.name, {})
        asked = {
            "priority": asked.get("priority"),
            "cores": asked.get("cores", []),
            "timer_slack_ns": 1,
            "lock_memory": asked.get("lock_memory", False),
            "prefault_stack_kib": asked.get("prefault_stack_kib", 0),
        }
        ctypes.CDLL(None).prctl(29, 1, 0, 0, 0)  # PR_SET_TIMERSLACK
        refused = []
        for key, ask in (("cores", self._cores), ("priority", self._priority)):
            try:
                if asked[key]:
                    ask(asked[key])
            except OSError as cause:
                remedy = f"allow it (see `tectum doctor`), or take it out of [realtime.{self.name}]"
                refused.append({"what": f"{key} {asked[key]}", "why": error_text(cause), "remedy": remedy})
        remedy = f"take it out of [realtime.{self.name}]"
        for key in ("lock_memory", "prefault_stack_kib"):
            if asked[key]:
                refused.append({"what": f"{key} {asked[key]}", "why": "Python does not ask for it", "remedy": remedy})
        fifo = os.sched_getscheduler(0) == os.SCHED_FIFO
        held = {
            "scheduler": "fifo" if fifo else "other",
            "priority": os.sched_getparam(0).sched_priority if fifo else 0,
            "cores": sorted(os.sched_getaffinity(0)),
            "locked_kib": 0,
            "stack_kib": 0,
            "timer_slack_ns": 1,
        }
        path = self.run.folder / f"{self.name}.realtime.json"
        write(path, {"asked": asked, "held": held, "refused": refused})

    @staticmethod
    def _cores(cores: list[int]) -> None:
        os.sched_setaffinity(0, cores)

    @staticmethod
    def _priority(priority: int) -> None:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))

    def fail(self) -> None:
        """Publishes that the process has failed, unless it has finished: nobody is to wait for it in vain."""
        if self.status.state != State.FINISHED:
            self.enter(State.FAILED)


class TickLoop(ABC):
    """The loop of ticks of a plant or a controller, as a process of a run."""

    run: JoinedRun
    done = 0
    """Ticks since this process started."""

    @property
    @abstractmethod
    def process(self) -> Participant:
        """The process that it is."""

    @abstractmethod
    def loop(self) -> None:
        """Goes through the ticks, and finishes."""

    @abstractmethod
    def finish(self) -> None:
        """Leaves the run in good order."""

    def go(self) -> None:
        """Takes part in the run, until it is over."""
        try:
            self.loop()
        except Mistake:
            # In lockstep, and in the first tick since the start, the next start would meet the same mistake: the
            # process has finished its part of the run, and so is not started again.
            if not self.run.real or self.done == 0:
                self.finish()
            raise
        finally:
            self.process.fail()
