"""Viewers, which watch a run from outside, and trackers, which tell a run with `sight = "vision"` what they see.

Both may come and go at any time. Neither slows the loop.
"""

import os
import time
from collections.abc import Iterator, Sequence
from typing import Generic, TypeVar, cast

from .errors import Refused, error_text
from .layouts import Command, Learning, Observation, Vision
from .transport import JoinedRun, join

Sample = TypeVar("Sample", Observation, Command, Learning)
KINDS = {"observation": Observation, "command": Command, "learning": Learning}


class Viewer(Generic[Sample]):
    """Reads one channel of a run: `for observation in tectum.Viewer("arm-1")` until the run is over.

    A viewer that is behind by more than `buffer` samples loses the oldest. `lost` counts them.
    """

    def __init__(
        self, run: "str | os.PathLike[str] | JoinedRun", channel: str = "observation", buffer: int = 64
    ) -> None:
        if channel not in KINDS:
            raise Refused(f"there is no channel {channel!r} to view; the channels are {', '.join(KINDS)}")
        self.run = join(run)
        self.samples = self.run.reader(channel, KINDS[channel], buffer)
        self.lost, self.expected = 0, -1

    def receive(self) -> Sample | None:
        """The oldest sample not yet received, or None."""
        sample = cast("Sample | None", self.samples.receive())
        if sample is not None:
            sequence = sample.header.sequence
            self.lost += max(sequence - self.expected, 0) if self.expected >= 0 else 0
            self.expected = sequence + 1
        return sample

    def newest(self) -> Sample | None:
        """The newest sample, if one has come since the last call."""
        newest = None
        while (sample := self.receive()) is not None:
            newest = sample
        return newest

    def __iter__(self) -> Iterator[Sample]:
        over = False
        while not over:
            over = self.run.over()  # checked before the channel, so that everything sent until then is still received
            while (sample := self.receive()) is not None:
                yield sample
            time.sleep(0.005)


class Tracker:
    """Publishes target and end-effector, in a run with `sight = "vision"`."""

    def __init__(self, run: "str | os.PathLike[str] | JoinedRun") -> None:
        self.run = join(run)
        if "vision" not in self.run.wire["services"]:
            raise Refused(f"the run in {self.run.folder} takes no tracker: its scenario has no sight = \"vision\"")
        self.sample = Vision()
        self.sample.header.run = self.run.id
        try:
            self.out = self.run.writer("vision", Vision)
        except Exception as cause:
            raise Refused(f"the run has no place for another tracker: {error_text(cause)}", 1) from None

    def publish(self, sensed_ns: int, target: Sequence[float], end: Sequence[float]) -> None:
        """Publishes their positions, m, in a picture taken at `sensed_ns` (`time.monotonic_ns()`: CLOCK_MONOTONIC)."""
        self.sample.target, self.sample.end = tuple(target), tuple(end)
        header = self.sample.header
        header.sensed_ns, header.published_ns = sensed_ns, time.monotonic_ns()
        self.out.send(self.sample)
        header.sequence += 1
