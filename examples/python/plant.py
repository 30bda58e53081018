"""A plant in Python: a point with mass on a line that is to follow a target.

    target/release/tectum run examples/python/plant.toml
    target/release/tectum run examples/python/plant.toml --mode realtime --ticks 400

Only the body has to be written. Handshake, time, lockstep, hold policy and limits come with the package `tectum`.
Controller and logger are the usual programs, and do not notice the difference.
"""

import tectum

TARGET_EVERY = 40  # ticks
REACH = 1.0  # m: the line ends there, on both sides


class Cart(tectum.Plant):
    """A point with position, speed and target. It accelerates towards the commanded speed."""

    def __init__(self, run):
        self.period = run.period
        # A stream of its own, from the run's seed alone: the same targets in every run of that seed.
        self.targets = run.stream("targets")
        self.position, self.speed, self.target, self.shown = 0.0, 0.0, 0.0, 0

    def sense(self, tick, inputs):
        # Ticks may jump when the machine stalls; the sequence of targets stays the same.
        due = tick // TARGET_EVERY + 1
        fresh = due > self.shown
        while self.shown < due:
            self.target = REACH * (2.0 * self.targets.single() - 1.0)
            self.shown += 1
        inputs[:] = self.position, self.target
        return fresh

    def advance(self, tick, applied):
        # In each tick the speed closes half of its distance to the commanded speed.
        self.speed += 0.5 * (2.0 * applied[0] - self.speed)
        self.position += self.period * self.speed
        if abs(self.position) > REACH:
            self.position, self.speed = max(-REACH, min(REACH, self.position)), 0.0
        error = self.position - self.target
        return -error * error, [abs(error)]

    def state(self):
        """What a cart that was killed goes on with when it comes back."""
        numbers = [self.position, self.speed, self.target, self.shown]
        return {"numbers": numbers, "targets": self.targets.words}

    def restore(self, state):
        self.position, self.speed, self.target, self.shown = state["numbers"]
        self.targets.words = state["targets"]

    def joints(self):
        """For the gate's position limits: the joint's position, and how far a command of 1 moves it in a tick."""
        return [self.position], [2.0 * self.period]


if __name__ == "__main__":
    tectum.main(Cart, "A point with mass on a line that is to follow a target")
