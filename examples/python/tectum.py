"""A plant, a viewer or a tracker of a Tectum run in Python: handshake, samples, gate, and the loop of ticks.

A plant is an object with two methods and one call:

    class Body:
        def sense(self, tick, inputs): ...    # fill in the inputs; True when a new target begins
        def advance(self, tick, applied): ... # one tick with this command: (reward, measures)

    tectum.main(lambda run: Body(run), "What it is")

This module does what the Rust plant does (docs/wire.md). Its gate matches the Rust gate bit for bit, so that
`tectum replay` can check it. It keeps no state across its own death: killed in real time, it comes back with its
gate at zero; in lockstep the run ends. It writes no checkpoints. Needs Linux, Python 3.11 and iceoryx2 in the
version of the run.
"""

import argparse, ctypes, gc, json, math, os, select, signal, struct, sys, time
from ctypes import Structure, c_float, c_uint32, c_uint64
from pathlib import Path

MAX_INPUTS, MAX_OUTPUTS, MAX_MEASURES, MAX_COLUMNS = 32, 16, 6, 8
LOG_BUFFER, CREDIT = 1024, 256
# Bits of a header's flags that matter to a plant or a viewer.
FIRST, MISSED, HELD, DECAYED, STOPPED, CLAMPED, NON_FINITE, SKIPPED, NEW_TARGET, LATE = (1 << bit for bit in range(10))
STEP_LIMITED, POSITION_LIMITED, RAMPED, UNHEARD = (1 << bit for bit in range(12, 16))
UNARMED, TRIPPED, BLIND, TERMINATED, TRUNCATED = (1 << bit for bit in range(19, 24))
# What a plant's `advance` may return behind reward and measures: how an episode ended with the tick.
END = {None: 0, "terminated": TERMINATED, "truncated": TRUNCATED}
# Phases of a run, states of a process, and the indices of the processes on the control board.
SET_UP, CONNECT, RUN, STOP, ABORT = range(5)
ABSENT, READY, CONNECTED, RUNNING, FINISHED, FAILED = range(6)
PLANT, CONTROLLER, LOGGER = range(3)


class Refused(Exception):
    """The process cannot take part; `code` is its exit code."""

    def __init__(self, text, code=2):
        super().__init__(text)
        self.code = code


class Ended(Exception):
    """The run is over before its last tick."""


# --- samples ------------------------------------------------------------------------------------------------


def sample(name, fields):
    """A payload: its type name, by which iceoryx2 knows it, and its fields. There is no padding."""
    return type(name.split(".")[1], (Structure,), {"_fields_": fields, "type_name": staticmethod(lambda: name)})


Header = sample("tectum.Header.v1", [
    ("run", c_uint64), ("tick", c_uint64), ("sequence", c_uint64), ("scheduled_ns", c_uint64), ("sensed_ns", c_uint64),
    ("published_ns", c_uint64), ("incarnation", c_uint32), ("flags", c_uint32)])
Observation = sample("tectum.Observation.v2", [
    ("header", Header), ("inputs", c_float * MAX_INPUTS), ("applied", c_float * MAX_OUTPUTS), ("reward", c_float),
    ("skipped", c_uint32), ("measures", c_float * MAX_MEASURES)])
Command = sample("tectum.Command.v2", [
    ("header", Header), ("mean", c_float * MAX_OUTPUTS), ("drawn", c_float * MAX_OUTPUTS)])
Learning = sample("tectum.Learning.v2", [
    ("header", Header), ("noise", c_float * MAX_OUTPUTS), ("reward", c_float), ("step", c_float),
    ("weights_norm", c_float), ("trace_norm", c_float), ("columns", c_float * MAX_COLUMNS),
    ("weights_hash", c_uint64)])
Vision = sample("tectum.Vision.v1", [("header", Header), ("target", c_float * 2), ("end", c_float * 2)])
Control = sample("tectum.Control.v2", [
    ("phase", c_uint32), ("checkpoints", c_uint32), ("t0_ns", c_uint64), ("incarnations", c_uint32 * 4)])
Status = sample("tectum.Status.v3", [
    ("state", c_uint32), ("pid", c_uint32), ("beat", c_uint64), ("checkpoint", c_uint64), ("ticks", c_uint64),
    ("sent", c_uint64), ("missed", c_uint64), ("late", c_uint64), ("lost", c_uint64), ("consumed", c_uint64),
    ("learner_ns", c_uint64), ("loss", c_float), ("end_error", c_float), ("schema", c_uint64), ("scenario", c_uint64),
    ("build", c_uint64)])


# --- a run and its services ---------------------------------------------------------------------------------


class Board:
    """A status board to read from; `page` is the start number of the process that writes it."""

    def __init__(self, factory, kind, page=0):
        self.reader, self.kind, self.page = factory.reader_builder().create(), kind, None
        self.turn_to(page)

    def turn_to(self, page):
        """Changes to another page. True if that was another one before."""
        if page == self.page:
            return False
        self.page, self.entry = page, self.reader.entry(c_uint64(page), self.kind)
        return True

    def get(self):
        return self.entry.get().decode_as(self.kind)


class Reader:
    """The reading end of a channel."""

    def __init__(self, factory, kind, buffer):
        self.factory, self.kind = factory, kind
        self.port = factory.subscriber_builder().buffer_size(buffer).create()

    def receive(self):
        """A copy of the oldest sample not yet received, or None."""
        got = self.port.receive()
        if got is None:
            return None
        copy = self.kind.from_buffer_copy(ctypes.string_at(got.payload_ptr, ctypes.sizeof(self.kind)))
        got.delete()
        return copy


class Run:
    """A run's manifest and its iceoryx2 domain."""

    def __init__(self, run):
        import iceoryx2 as iox

        self.iox = iox
        named = Path("runs") / run
        self.folder = named if not (Path(run) / "run.json").exists() and (named / "run.json").exists() else Path(run)
        try:
            self.manifest = json.loads((self.folder / "run.json").read_text())
            self.wire, self.mode = self.manifest["wire"], self.manifest["mode"]
            self.launcher = os.pidfd_open(self.manifest["launcher"])
        except (OSError, ValueError, KeyError) as cause:
            raise Refused(f"there is no run to join in {self.folder}: {cause}") from None
        self.settings, self.period_ns = self.wire["settings"], self.wire["period_ns"]
        self.seed, self.ticks = self.settings["seed"], self.settings["ticks"]
        self.inputs, self.outputs, self.measures = (self.wire[key] for key in ("inputs", "outputs", "measures"))
        self.real = self.mode == "realtime"
        iox.set_log_level(iox.LogLevel.Fatal)
        config = iox.config.default()
        config.global_cfg.prefix = iox.FileName.new(self.wire["prefix"])
        config.global_cfg.root_path = iox.Path.new(self.wire["root"])
        # Only the launcher cleans up.
        config.global_cfg.node.cleanup_dead_nodes_on_creation = False
        config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
        config.global_cfg.service.cleanup_dead_nodes_on_open = False
        services = self.wire["services"]
        try:
            builder = iox.NodeBuilder.new().config(config).signal_handling_mode(iox.SignalHandlingMode.Disabled)
            self.node = builder.create(iox.ServiceType.Ipc)
            self.wake = self._service(services["wake"]).event().open()
            self.check()
            self.control = self.board(services["control"], Control)
        except Refused:
            raise
        except Exception as cause:
            raise Refused(f"the run's domain {self.wire['root']} cannot be used: {error_text(cause)}", 1) from None

    def check(self):
        """Compares the attributes of `wake` with the manifest, before any typed service is opened."""
        for key in ("schema", "scenario", "build"):
            theirs = self.wake.attributes.key_values(self.iox.AttributeKey.new(key))
            if str(self.iox.AttributeValue.new(self.wire[key])) not in map(str, theirs):
                text = f"{self.folder} and the domain {self.wire['root']} are not of one run: their {key} differs"
                raise Refused(text, 3)

    def _service(self, name):
        return self.node.service_builder(self.iox.ServiceName.new(name))

    def board(self, name, kind, page=0):
        return Board(self._service(name).blackboard_opener(c_uint64).open(), kind, page)

    def peer(self, role):
        """The board of a process, at the page of its current start."""
        return self.board(self.wire["services"]["boards"][role], Status, self.control.get().incarnations[role])

    def board_writer(self, role, page):
        """The writer of the board of `role`."""
        factory = self._service(self.wire["services"]["boards"][role]).blackboard_opener(c_uint64).open()
        writer = factory.writer_builder().create()
        # The port is kept: the launcher uses it to find and free the place of a dead process.
        return writer, writer.entry(c_uint64(page), Status)

    def channel(self, name, kind):
        return self._service(self.wire["services"][name]).publish_subscribe(kind).open()

    def reader(self, name, kind, buffer):
        """The reading end of a channel, which holds the newest `buffer` samples. It never blocks the writer."""
        try:
            return Reader(self.channel(name, kind), kind, buffer)
        except Exception as cause:
            raise Refused(f"channel {name} has no place for another reader: {error_text(cause)}", 1) from None

    def orphaned(self):
        """Whether the launcher has ended. A killed launcher cannot announce its end."""
        return bool(select.select([self.launcher], [], [], 0)[0])

    def run_ended(self):
        return self.control.get().phase >= STOP or self.orphaned()


class Tracker:
    """Publishes target and end-effector, in a run with `sight = "vision"`. May come and go at any time."""

    def __init__(self, run):
        if "vision" not in run.wire["services"]:
            raise Refused(f"the run in {run.folder} takes no tracker: its scenario has no sight = \"vision\"")
        self.sample, iox = Vision(), run.iox
        self.sample.header.run = int(run.manifest["run"], 16)
        try:
            self.out = run.channel("vision", Vision).publisher_builder().backpressure_strategy(
                iox.BackpressureStrategy.DiscardData).max_loaned_samples(1).create()
        except Exception as cause:
            raise Refused(f"the run has no place for another tracker: {error_text(cause)}", 1) from None

    def publish(self, sensed_ns, target, end):
        """Publishes their positions, m, in a picture taken at `sensed_ns` (`time.monotonic_ns()`: CLOCK_MONOTONIC)."""
        self.sample.target, self.sample.end = tuple(target), tuple(end)
        header = self.sample.header
        header.sensed_ns, header.published_ns = sensed_ns, time.monotonic_ns()
        self.out.send_copy(self.sample)
        header.sequence += 1


def error_text(cause):
    return f"{type(cause).__name__} {cause}".strip()


# --- the gate -----------------------------------------------------------------------------------------------


def f32(x):
    """The nearest single-precision number. A sum, product or quotient of two such numbers, computed in double precision
    and rounded by this function, equals the single-precision result."""
    return c_float(x).value


def nudge(x, up):
    """The next single-precision number above or below."""
    if x == 0.0:
        return f32(1e-45) if up else f32(-1e-45)
    bits = struct.unpack("<i", struct.pack("<f", x))[0] + (1 if (x > 0.0) == up else -1)
    return struct.unpack("<f", struct.pack("<i", bits))[0]


def toward_zero(x):
    near = f32(max(min(x, 3.4028234663852886e38), -3.4028234663852886e38))
    return near if abs(near) <= abs(x) else nudge(near, near < 0.0)


def each(value):
    return [f32(value[min(i, len(value) - 1)] if isinstance(value, list) else value) for i in range(MAX_OUTPUTS)]


class Gate:
    """The last check between a command and the actuators: limits of rate, step and position, a ramp, and the hold
    policy for missing commands. Whatever arrives, what it lets through is finite and within limits. It matches
    `src/runtime/gate.rs` bit for bit."""

    def __init__(self, table, outputs):
        self.limit, self.outputs = each(table["max_command"]), outputs
        self.step = each(table["max_step"]) if table.get("max_step") is not None else None
        self.positions = table.get("positions") or None
        self.hold, self.decay, self.ramp = table["hold_ticks"], table["decay_ticks"], table.get("ramp_ticks", 0)
        self.last, self.applied = [0.0] * outputs, [0.0] * outputs
        self.missing = self.joined = 0

    def go(self, command, joints=None):
        """One tick. `command`: the command that arrived, or None. `joints`: positions, and travel for a command of 1,
        rad. Returns the command to apply, and flags."""
        came = command if command is not None and all(map(math.isfinite, command[: self.outputs])) else None
        wanted, flags = self.without() if came is None else self.limited(came)
        if came is None and command is not None:
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

    def limited(self, command):
        back = self.joined == 0 or self.missing > self.hold
        self.joined = 1 if back else min(self.joined + 1, self.ramp + 1)
        self.missing, flags, wanted = 0, 0, []
        share = f32(self.joined / (self.ramp + 1))
        for u, limit in zip(command[: self.outputs], self.limit):
            u, flags = narrow(u, (-limit, limit), flags, 0)
            if share < 1.0:
                u, flags = narrow(u, (f32(-limit * share), f32(limit * share)), flags, RAMPED)
            wanted.append(u)
        return wanted, flags

    def without(self):
        self.missing += 1
        if self.missing <= self.hold:
            share, flags = 1.0, HELD
        elif self.missing - self.hold <= self.decay:
            share, flags = f32(1.0 - f32((self.missing - self.hold) / (self.decay + 1))), DECAYED
        else:
            share, flags = 0.0, STOPPED
        return [f32(u * share) for u in self.last], flags | MISSED

    def span(self, i, joints):
        """The range of commands that carry joint `i` over no limit; it contains 0."""
        if joints is None:
            return 0.0, 0.0
        (low, high), p, k = self.positions[i], f32(joints[0][i]), f32(joints[1][i])
        if not (math.isfinite(p) and math.isfinite(k)):
            return 0.0, 0.0
        if k == 0.0:
            return -3.4028234663852886e38, 3.4028234663852886e38
        hair = 1e-6 * max(abs(p), abs(low), abs(high), 1.0)
        a, b = (min(low + hair, p) - p) / k, (max(high - hair, p) - p) / k
        return toward_zero(min(a, b)), toward_zero(max(a, b))


def narrow(u, span, flags, reason):
    low, high = span
    v = low if u < low else high if u > high else u
    return v, flags if v == u else flags | CLAMPED | reason


def reach(centre, by):
    low, high = f32(centre - by), f32(centre + by)
    return (nudge(low, True) if centre - low > by else low), (nudge(high, False) if high - centre > by else high)


# --- random streams -----------------------------------------------------------------------------------------


class Stream:
    """Xoshiro256++, as in the Rust processes."""

    def __init__(self, seed):
        self.words = []
        for _ in range(4):  # SplitMix64
            seed = (seed + 0x9E3779B97F4A7C15) & MASK
            z = ((seed ^ seed >> 30) * 0xBF58476D1CE4E5B9) & MASK
            z = ((z ^ z >> 27) * 0x94D049BB133111EB) & MASK
            self.words.append(z ^ z >> 31)

    def next(self):
        a, b, c, d = self.words
        total = (a + d) & MASK
        drawn = ((total << 23 | total >> 41) + a) & MASK
        c, d = c ^ a, d ^ b
        self.words = [a ^ d, b ^ c, c ^ (b << 17 & MASK), (d << 45 | d >> 19) & MASK]
        return drawn

    def single(self):
        """Uniform in [0, 1), a number of single precision."""
        return (self.next() >> 40) / (1 << 24)


MASK = (1 << 64) - 1


def stream(seed, name):
    """The random stream `name` of a run with `seed`. It yields the same numbers as in a Rust plant."""
    import xxhash

    return Stream(xxhash.xxh3_64_intdigest(name.encode(), seed))


# --- the plant's loop ---------------------------------------------------------------------------------------


class Spread:
    """Counts of durations, to three digits, in bounded memory."""

    def __init__(self):
        self.counts = {}

    def add(self, ns):
        unit = 10 ** max(len(str(ns)) - 3, 0)
        self.counts[ns // unit * unit] = self.counts.get(ns // unit * unit, 0) + 1

    def percentiles(self):
        total, values = sum(self.counts.values()), sorted(self.counts.items())
        if not total:
            return None

        def at(share):
            left = share * total
            for value, count in values:
                left -= count
                if left <= 0:
                    return value / 1000
        names = {"p50": 0.5, "p90": 0.9, "p99": 0.99, "p999": 0.999, "max": 1.0}
        return {"count": total} | {name: at(share) for name, share in names.items()}


class Participant:
    """The plant as a process of a run: its ports, its status board, and the phases of the run."""

    def __init__(self, run, body):
        self.run, self.gate = run, Gate(run.settings["gate"], len(run.outputs))
        name = run.settings["plant"]["program"]
        if self.gate.positions and not hasattr(body, "joints"):
            raise Refused(f"{name} does not tell where its joints are, so that the gate cannot limit positions; take "
                          "positions out of [gate]")
        if any(fault["channel"] == "command" for fault in run.settings.get("faults", {}).get("channel", [])):
            raise Refused(
                f"{name} cannot make faults on its commands; take them out of [faults], or have observations faulty")
        if "resumed" in run.manifest:
            raise Refused(f"{name} writes no checkpoints and cannot go on with another run")
        self.incarnation = run.control.get().incarnations[PLANT]
        if self.incarnation and not run.real:
            raise Refused(f"{name} died and remembers nothing: in lockstep it cannot come back")
        iox, publisher = run.iox, run.channel("observation", Observation)
        try:
            self.readers = publisher.dynamic_config
            self.out = publisher.publisher_builder().backpressure_strategy(
                iox.BackpressureStrategy.DiscardData).max_loaned_samples(1).create()
            self.wake = run.wake.notifier_builder().create()
            self.commands = run.reader("command", Command, 2)
            self.port, self.board = run.board_writer(PLANT, self.incarnation)
        except Refused:
            raise
        except Exception as cause:
            raise Refused(f"the run has a plant already, or none is possible: {error_text(cause)}", 1) from None
        self.controller, self.logger = run.peer(CONTROLLER), run.peer(LOGGER)
        self.before = None
        if self.incarnation:
            self.before = run.board(run.wire["services"]["boards"][PLANT], Status, self.incarnation - 1).get()
        wire = run.wire
        self.status = Status(pid=os.getpid(), loss=math.nan, end_error=math.nan, schema=int(wire["schema"], 16),
                             scenario=int(wire["scenario"], 16), build=int(wire["build_hash"], 16))
        self.signal = 0
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self.interrupt)

    def interrupt(self, number, _frame):
        self.signal = number

    def publish_status(self):
        """Writes a heartbeat and the progress to the status board."""
        self.status.beat += 1
        self.board.update_with_copy(self.status)

    def enter(self, state):
        self.status.state = state
        self.publish_status()

    def heartbeat(self):
        """Writes a heartbeat. True when the run is to end in good order; raises when it ends at once."""
        self.publish_status()
        if self.signal:
            raise Refused(f"was ended by signal {self.signal}", 128 + self.signal)
        phase = self.run.control.get().phase
        if phase == ABORT:
            raise Ended("the run was ended")
        if self.run.orphaned():
            raise Ended("the launcher is gone")
        return phase == STOP

    def stopping(self):
        return self.signal or self.run.control.get().phase >= STOP

    def begin(self):
        """Ready, Connect, Connected, Run. Gives the start of tick 0, ns."""
        if self.run.real:
            self.realtime()
        self.enter(READY)
        self.until(lambda: self.run.control.get().phase >= CONNECT)
        self.until(lambda: self.connected() or self.incarnation)
        self.enter(CONNECTED)
        self.until(lambda: self.run.control.get().phase >= RUN)
        self.enter(RUNNING)
        return self.run.control.get().t0_ns

    def connected(self):
        """Maps the peers' memory, and counts them: two readers of observations, one writer of commands."""
        self.out.update_connections()
        self.commands.port.has_samples()
        writers = self.commands.factory.dynamic_config.number_of_publishers
        return self.readers.number_of_subscribers >= 2 and writers >= 1

    def until(self, ready):
        while not ready():
            self.heartbeat()
            time.sleep(0.0005)

    def realtime(self):
        """Writes the real-time report. Requests that this module does not make are reported as refused."""
        asked = self.run.settings.get("realtime", {}).get("plant", {})
        asked = {"priority": asked.get("priority"), "cores": asked.get("cores", []), "timer_slack_ns": 1,
                 "lock_memory": asked.get("lock_memory", False),
                 "prefault_stack_kib": asked.get("prefault_stack_kib", 0)}
        ctypes.CDLL(None).prctl(29, 1, 0, 0, 0)  # PR_SET_TIMERSLACK
        if asked["cores"]:
            os.sched_setaffinity(0, asked["cores"])
        remedy = "start it by hand under `chrt` or take it out of [realtime.plant]"
        refused = [{"what": f"{key} {asked[key]}", "why": "tectum.py does not ask for it", "remedy": remedy}
                   for key in ("priority", "lock_memory", "prefault_stack_kib") if asked[key]]
        held = {"scheduler": "other", "priority": 0, "cores": sorted(os.sched_getaffinity(0)), "locked_kib": 0,
                "stack_kib": 0, "timer_slack_ns": 1}
        write(self.run.folder / "plant.realtime.json", {"asked": asked, "held": held, "refused": refused})

    def returned(self, board, role):
        """True once for each restart of `role`, when its ports are there."""
        board.awaited = board.turn_to(self.run.control.get().incarnations[role]) or getattr(board, "awaited", False)
        back = board.awaited and board.get().state >= RUNNING
        board.awaited = board.awaited and not back
        return back

    def send(self, observation):
        self.out.send_copy(observation)


def write(path, value):
    """Writes a file atomically."""
    draft = path.with_name(path.name + ".part")
    draft.write_text(json.dumps(value, indent=2))
    draft.rename(path)


class Plant:
    """A plant's body behind its gate, and its loop of ticks."""

    def __init__(self, participant, body):
        self.participant, self.run, self.body, self.gate = participant, participant.run, body, participant.gate
        counts = ("ticks", "missed", "late", "skipped", "clamped", "step_limited", "position_limited", "ramped",
                  "non_finite", "checkpoints")
        self.report = dict.fromkeys(counts, 0) | {"checkpoint_failure": None}
        self.observation, self.flags = Observation(), FIRST
        self.observation.header.run = int(self.run.manifest["run"], 16)
        self.observation.header.incarnation = participant.incarnation
        self.expected, self.found, self.late = 0, None, 0
        self.answered = Spread()

    def receive_command(self, tick):
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

    def advance(self, tick):
        """Advances by `tick` with the command found for it. A command flagged UNHEARD counts as none."""
        command, self.found = self.found, None
        drawn = None if command is None or command.header.flags & UNHEARD else list(command.drawn)
        joints = self.body.joints() if self.gate.positions else None
        ended = self.flags & (TERMINATED | TRUNCATED)
        applied, self.flags = self.gate.go(drawn, joints)
        for key, bit in (("missed", MISSED), ("clamped", CLAMPED), ("step_limited", STEP_LIMITED), ("ramped", RAMPED),
                         ("position_limited", POSITION_LIMITED), ("non_finite", NON_FINITE)):
            self.report[key] += bool(self.flags & bit)
        reward, measures, *end = self.body.advance(tick, list(applied))
        self.flags |= ended | (END[end[0]] if end else 0)
        self.observation.applied = tuple(applied)
        self.observation.reward = reward
        self.observation.measures = tuple(measures)

    def observe(self, tick, late, skipped):
        inputs = [0.0] * len(self.run.inputs)
        fresh = self.body.sense(tick, inputs)
        self.observation.inputs = tuple(inputs)
        self.observation.skipped = skipped
        header = self.observation.header
        header.tick = tick
        header.flags = self.flags | (LATE if late else 0) | (SKIPPED if skipped else 0) | (NEW_TARGET if fresh else 0)
        self.flags &= ~(TERMINATED | TRUNCATED)
        self.report["ticks"] += 1

    def wait(self, t0, tick, advanced):
        """Waits until `tick` begins: for its instant in real time, for the command of the tick before in lockstep.
        False when the run ends first."""
        participant, turns = self.participant, 0
        if self.run.real:
            due = t0 + tick * self.run.period_ns
            while (now := time.monotonic_ns()) < due:
                time.sleep(min(due - now, 50_000_000) / 1e9)
                if due - now > 50_000_000 and participant.heartbeat():
                    return False
            return not participant.heartbeat()
        while not (advanced or self.receive_command(tick - 1)):
            turns += 1
            if turns < 4096:
                os.sched_yield()
            else:
                time.sleep(0.00005)
            if turns % 64 == 0 or turns >= 4096:
                # The command is on its way, unless the controller was killed before it received the observation.
                if participant.returned(participant.controller, CONTROLLER):
                    participant.send(self.observation)
                participant.heartbeat()
        return True

    def credit(self, tick):
        """In lockstep: waits until the logger's buffer has room. False when the run is to end first."""
        while self.participant.logger.get().consumed + LOG_BUFFER < tick + CREDIT:
            self.participant.returned(self.participant.logger, LOGGER)
            if self.participant.heartbeat():
                return False
            time.sleep(0.0001)
        return True

    def loop(self):
        participant, run, report = self.participant, self.run, self.report
        t0 = participant.begin()
        gc.freeze()
        clock = time.monotonic_ns
        wake_up, work = Spread(), Spread()
        most = run.settings.get("overrun", {}).get("max_consecutive", 0)
        tick, advanced, overruns, given_up, back = 0, True, 0, None, bool(participant.incarnation)
        if back and participant.before.sent:
            # The body stood still while no process drove it: the ticks in between are missed.
            participant.status.sent, tick, advanced = participant.before.sent, participant.before.ticks + 1, False
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
                wake_up.add(max(woken - t0 - tick * run.period_ns, 0))
            for passed in range(tick, due):
                self.advance(passed)
            skipped, tick = due - tick, due
            report["skipped"] += skipped
            participant.status.ticks, participant.status.missed = tick, report["missed"]
            participant.status.late, participant.status.lost = report["late"], report["skipped"]
            participant.publish_status()
            overruns = 0 if back or not skipped else overruns + skipped
            back = False
            if run.real and 0 < most < overruns:
                given_up = f"passed over {overruns} ticks in a row at tick {tick}; max_consecutive is {most}"
                break
            if tick >= run.ticks or participant.stopping():
                break
            if not run.real and tick % CREDIT == 0 and not self.credit(tick):
                break
            self.observe(tick, late, skipped)
            header = self.observation.header
            header.sequence = participant.status.sent
            header.scheduled_ns = t0 + tick * run.period_ns if run.real else tick * run.period_ns
            header.sensed_ns = header.published_ns = clock() if run.real else header.scheduled_ns
            participant.send(self.observation)
            if run.real:
                participant.wake.notify()
                work.add(clock() - woken)
            participant.status.sent += 1
            tick, advanced = tick + 1, False
        participant.heartbeat()
        spreads = {"wake_up": wake_up, "observation_to_command": self.answered, "work": work}
        report |= {name: spread.percentiles() if run.real else None for name, spread in spreads.items()}
        write(run.folder / "plant.json", report)
        participant.enter(FINISHED)
        participant.wake.notify()
        if given_up:
            raise Refused(given_up, 4)


def main(build, about, options=lambda parser: None):
    """Runs the plant of the run that the command line names, with the body that `build(run)` returns, and ends the
    process. `options(parser)` adds arguments, which the body finds in `run.arguments`. Every failure is one sentence on
    standard error; the exit codes are those of all processes of a run."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--run", required=True, help="the run to join: its folder, or its name under runs/")
    options(parser)
    arguments, participant = parser.parse_args(), None
    try:
        run = Run(arguments.run)
        run.arguments = arguments
        body = build(run)
        participant = Participant(run, body)
        Plant(participant, body).loop()
        code = 0
    except (Refused, Ended) as cause:
        print(f"{Path(sys.argv[0]).name}: {cause}", file=sys.stderr)
        code = getattr(cause, "code", 4)
    finally:
        # Also when the body raised an exception: the other processes must not wait for this one in vain.
        if participant and participant.status.state != FINISHED:
            participant.enter(FAILED)
    sys.stdout.flush()
    sys.exit(code)
