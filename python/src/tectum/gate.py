"""The last check between a command and the actuators.

Limits of rate, step and position, a ramp, and the hold policy for missing commands. Whatever arrives, what the gate
lets through is finite and within limits. It matches `runtime/gate.rs` of tectum-runtime bit for bit, so that `tectum
replay` can check every applied command.
"""

import math
import struct
from collections.abc import Sequence
from ctypes import c_float
from typing import Any

from .layouts import MAX_OUTPUTS, Flag

AHEAD, CLAMPED, DECAYED, HELD, MISSED = map(int, (Flag.AHEAD, Flag.CLAMPED, Flag.DECAYED, Flag.HELD, Flag.MISSED))
NON_FINITE, POSITION_LIMITED, RAMPED = int(Flag.NON_FINITE), int(Flag.POSITION_LIMITED), int(Flag.RAMPED)
STEP_LIMITED, STOPPED = int(Flag.STEP_LIMITED), int(Flag.STOPPED)
LARGEST = 3.4028234663852886e38  # the largest number of single precision


def f32(x: float) -> float:
    """The nearest single-precision number. A sum, product or quotient of two such numbers, computed in double precision
    and rounded by this function, equals the single-precision result."""
    return c_float(x).value


def nudge(x: float, up: bool) -> float:
    """The next single-precision number above or below."""
    if x == 0.0:
        return f32(1e-45) if up else f32(-1e-45)
    bits = struct.unpack("<i", struct.pack("<f", x))[0] + (1 if (x > 0.0) == up else -1)
    return float(struct.unpack("<f", struct.pack("<i", bits))[0])


def toward_zero(x: float) -> float:
    near = f32(max(min(x, LARGEST), -LARGEST))
    return near if abs(near) <= abs(x) else nudge(near, near < 0.0)


def each(value: Any) -> list[float]:
    """A number for each output: one for all, or a list."""
    return [f32(value[min(i, len(value) - 1)] if isinstance(value, list) else value) for i in range(MAX_OUTPUTS)]


Joints = tuple[Sequence[float], Sequence[float]]
CommandAhead = tuple[Sequence[float], int]


class Gate:
    """The gate of a plant with `outputs` outputs. `table` is `[gate]` of the scenario."""

    def __init__(self, table: dict[str, Any], outputs: int) -> None:
        self.limit, self.outputs = each(table["max_command"]), outputs
        self.step = each(table["max_step"]) if table.get("max_step") is not None else None
        self.positions: list[tuple[float, float]] | None = table.get("positions") or None
        self.hold, self.decay, self.ramp = table["hold_ticks"], table["decay_ticks"], table.get("ramp_ticks", 0)
        self.last, self.applied = [0.0] * outputs, [0.0] * outputs
        self.missing = self.joined = 0

    def go(
        self, command: Sequence[float] | None, joints: Joints | None = None, ahead: CommandAhead | None = None
    ) -> tuple[list[float], int]:
        """One tick. `command`: the command that arrived, or None. `joints`: positions, and travel for a command of 1,
        rad. `ahead`: the command that an earlier one brought for this tick, and its age in ticks. Returns the command
        to apply, and flags."""
        came = command if command is not None and self.finite(command) else None
        if came is None and ahead is not None and ahead[1] <= self.hold and self.finite(ahead[0]):
            came = ahead[0]
            wanted, flags = self.limited(came, ahead[1])
            flags |= MISSED | AHEAD
        else:
            ahead = None
            wanted, flags = self.without() if came is None else self.limited(came)
        if command is not None and (came is None or ahead is not None):
            flags |= NON_FINITE
        for i in range(self.outputs):
            u = wanted[i]
            if self.step:
                u, flags = narrow(u, reach(self.applied[i], self.step[i]), flags, STEP_LIMITED)
            if self.positions:
                u, flags = narrow(u, self.span(i, joints), flags, POSITION_LIMITED)
            self.applied[i] = u
        if came is not None:
            self.last = list(self.applied)
        return list(self.applied), flags

    def finite(self, command: Sequence[float]) -> bool:
        return all(map(math.isfinite, command[: self.outputs]))

    def limited(self, command: Sequence[float], age: int = 0) -> tuple[list[float], int]:
        back = self.joined == 0 or self.missing > self.hold
        self.joined = 1 if back else min(self.joined + 1, self.ramp + 1)
        self.missing, flags, wanted = age, 0, []
        share = f32(self.joined / (self.ramp + 1))
        for u, limit in zip(command[: self.outputs], self.limit):
            u, flags = narrow(u, (-limit, limit), flags, 0)
            if share < 1.0:
                u, flags = narrow(u, (f32(-limit * share), f32(limit * share)), flags, RAMPED)
            wanted.append(u)
        return wanted, flags

    def without(self) -> tuple[list[float], int]:
        self.missing += 1
        if self.missing <= self.hold:
            share, flags = 1.0, HELD
        elif self.missing - self.hold <= self.decay:
            share, flags = f32(1.0 - f32((self.missing - self.hold) / (self.decay + 1))), DECAYED
        else:
            share, flags = 0.0, STOPPED
        return [f32(u * share) for u in self.last], flags | MISSED

    def span(self, i: int, joints: Joints | None) -> tuple[float, float]:
        """The range of commands that carry joint `i` over no limit; it contains 0."""
        if joints is None or self.positions is None:
            return 0.0, 0.0
        (low, high), p, k = self.positions[i], f32(joints[0][i]), f32(joints[1][i])
        if not (math.isfinite(p) and math.isfinite(k)):
            return 0.0, 0.0
        if k == 0.0:
            return -LARGEST, LARGEST
        hair = 1e-6 * max(abs(p), abs(low), abs(high), 1.0)
        a, b = (min(low + hair, p) - p) / k, (max(high - hair, p) - p) / k
        return toward_zero(min(a, b)), toward_zero(max(a, b))

    def state(self) -> dict[str, Any]:
        """What the gate remembers from tick to tick."""
        return {"last": self.last, "applied": self.applied, "missing": self.missing, "joined": self.joined}

    def restore(self, state: dict[str, Any]) -> None:
        """Continues where the gate was whose `state` this is."""
        self.last, self.applied = list(state["last"]), list(state["applied"])
        self.missing, self.joined = state["missing"], state["joined"]


def narrow(u: float, span: tuple[float, float], flags: int, reason: int) -> tuple[float, int]:
    low, high = span
    v = low if u < low else high if u > high else u
    return v, flags if v == u else flags | CLAMPED | reason


def reach(centre: float, by: float) -> tuple[float, float]:
    low, high = f32(centre - by), f32(centre + by)
    return (nudge(low, True) if centre - low > by else low), (nudge(high, False) if high - centre > by else high)
