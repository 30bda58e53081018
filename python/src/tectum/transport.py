"""A run's manifest and its iceoryx2 domain: how a Python process finds a run and opens its channels and boards.

This is the only module that names iceoryx2. Every service was created by the launcher; here they are only opened.
"""

import contextlib
import ctypes
import importlib.metadata
import json
import os
import select
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Generic, TypeVar

from .errors import Refused, error_text
from .facts import RunFacts
from .layouts import ICEORYX2, SCHEMA, Control, Observation, Phase, Role, Status
from .shared_memory import LogRing

Kind = TypeVar("Kind", bound=ctypes.Structure)


def load_iceoryx2(wanted: str = ICEORYX2) -> Any:
    """The package iceoryx2, in the version `wanted`."""
    install = f"{sys.executable} -m pip install iceoryx2=={wanted}"
    try:
        found = importlib.metadata.version("iceoryx2")
        import iceoryx2
    except ImportError:
        raise Refused(f"this Python has no iceoryx2; install it: {install}") from None
    if found != wanted:
        raise Refused(f"this Python has iceoryx2 {found}, and the run needs {wanted}; install it: {install}", 3)
    return iceoryx2


BOARD_PAGES = 256
"""Starts of a process that have their pages on one board; those after them are on another one."""


def board_of(name: str, start: int) -> str:
    """The board on which a start of the process with the board `name` has its page."""
    return name if start < BOARD_PAGES else f"{name}-{start // BOARD_PAGES}"


class Board(Generic[Kind]):
    """A status board to read from; `page` is the start number of the process that writes it."""

    def __init__(self, opened: Callable[[int], Any], kind: type[Kind], page: int = 0) -> None:
        self.opened, self.kind = opened, kind
        self.page: int | None = None
        self.awaited = False
        self.turn_to(page)

    def turn_to(self, page: int) -> bool:
        """Changes to another page. True if that was another one before."""
        if page == self.page:
            return False
        if self.page is None or page // BOARD_PAGES != self.page // BOARD_PAGES:
            self.reader = self.opened(page).reader_builder().create()
        self.page, self.entry = page, self.reader.entry(ctypes.c_uint64(page % BOARD_PAGES), self.kind)
        return True

    def get(self) -> Kind:
        """The value on the board."""
        value: Kind = self.entry.get().decode_as(self.kind)
        return value


class Reader(Generic[Kind]):
    """The reading end of a channel."""

    def __init__(self, factory: Any, kind: type[Kind], buffer: int) -> None:
        self.factory, self.kind, self.size = factory, kind, ctypes.sizeof(kind)
        self.port = factory.subscriber_builder().buffer_size(buffer).create()

    def receive(self) -> Kind | None:
        """A copy of the oldest sample not yet received, or None."""
        got = self.port.receive()
        if got is None:
            return None
        copy = self.kind.from_buffer_copy(ctypes.string_at(got.payload_ptr, self.size))
        got.delete()
        return copy


class Writer(Generic[Kind]):
    """The writing end of a channel, with the channel's log ring. It never waits for a reader."""

    def __init__(self, iox: Any, factory: Any, log: LogRing | None) -> None:
        self.ring = log
        self.readers = factory.dynamic_config
        self.port = (
            factory.publisher_builder()
            .backpressure_strategy(iox.BackpressureStrategy.DiscardData)
            .max_loaned_samples(1)
            .create()
        )

    def send(self, sample: Kind) -> None:
        """Sends a copy of the sample."""
        self.port.send_copy(sample)

    def append(self, sample: Kind) -> None:
        """Notes a sample that has been sent in the channel's log ring."""
        if self.ring is not None:
            self.ring.append(sample)

    def send_if_read(self, sample: Kind) -> None:
        """Sends a copy of the sample if there is any reader."""
        if self.readers.number_of_subscribers:
            self.port.send_copy(sample)

    def connected_readers(self) -> int:
        """Maps the readers' memory, and counts them."""
        self.port.update_connections()
        return int(self.readers.number_of_subscribers)


class JoinedRun(RunFacts):
    """A run that this process has found and joined: its facts and its channels.

    `run` is the run's folder, or its name under `runs/`.
    """

    folder: Path

    def __init__(self, run: str | os.PathLike[str]) -> None:
        named = Path("runs") / run
        folder = named if not (Path(run) / "run.json").exists() and (named / "run.json").exists() else Path(run)
        try:
            self.manifest: dict[str, Any] = json.loads((folder / "run.json").read_text())
        except (OSError, ValueError) as cause:
            raise Refused(f"there is no run to join in {folder}: {cause}") from None
        try:
            self.launcher = os.pidfd_open(self.manifest["launcher"])
        except OSError:
            raise Refused(f"there is no run to join in {folder}: the run is over") from None
        try:
            super().__init__(self.manifest["wire"], self.manifest["mode"], folder)
            self.id = int(self.manifest["run"], 16)
        except KeyError as cause:
            text = f"{folder / 'run.json'} has no key {cause}: the run is of another version than this package"
            raise Refused(f"{text}; install the package from the checkout that `tectum` was built from", 3) from None
        self._join(load_iceoryx2(self.wire["iceoryx2"]))

    def _join(self, iox: Any) -> None:
        self.iox = iox
        iox.set_log_level(iox.LogLevel.Fatal)
        config = iox.config.default()
        config.global_cfg.prefix = iox.FileName.new(self.wire["prefix"])
        config.global_cfg.root_path = iox.Path.new(self.wire["root"])
        # Only the launcher cleans up.
        config.global_cfg.node.cleanup_dead_nodes_on_creation = False
        config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
        config.global_cfg.service.cleanup_dead_nodes_on_open = False
        try:
            builder = iox.NodeBuilder.new().config(config).signal_handling_mode(iox.SignalHandlingMode.Disabled)
            self.node = builder.create(iox.ServiceType.Ipc)
            self.identity = self.service(self.wire["services"]["identity"]).event().open()
            self._check()
            self.control = self.board(self.wire["services"]["control"], Control)
        except Refused:
            raise
        except Exception as cause:
            raise Refused(f"the run's domain {self.wire['root']} cannot be used: {error_text(cause)}", 1) from None

    def _check(self) -> None:
        """Compares the attributes of `identity` with the manifest, before any typed service is opened."""
        for key in ("schema", "scenario", "build"):
            theirs = self.identity.attributes.key_values(self.iox.AttributeKey.new(key))
            if str(self.iox.AttributeValue.new(self.wire[key])) not in map(str, theirs):
                text = f"{self.folder} and the domain {self.wire['root']} are not of one run: their {key} differs"
                raise Refused(text, 3)
        if self.wire["schema"] != SCHEMA:
            text = f"this package has samples of another version than the run ({SCHEMA}, {self.wire['schema']})"
            raise Refused(f"{text}; install the package from the checkout that `tectum` was built from", 3)

    def service(self, name: str) -> Any:
        """A builder of the service `name`."""
        return self.node.service_builder(self.iox.ServiceName.new(name))

    def board(self, name: str, kind: type[Kind], page: int = 0) -> Board[Kind]:
        """A board to read from."""
        return Board(lambda start: self.opened_board(name, start), kind, page)

    def opened_board(self, name: str, start: int) -> Any:
        """The board on which a start of a process has its page."""
        return self.service(board_of(name, start)).blackboard_opener(ctypes.c_uint64).open()

    def peer(self, role: Role) -> Board[Status]:
        """The board of a process, at the page of its current start."""
        return self.board(self.wire["services"]["boards"][role], Status, self.control.get().incarnations[role])

    def board_writer(self, role: Role, page: int) -> tuple[Any, Any]:
        """The writer of the board of `role`."""
        writer = self.opened_board(self.wire["services"]["boards"][role], page).writer_builder().create()
        # The port is kept: the launcher uses it to find and free the place of a dead process.
        return writer, writer.entry(ctypes.c_uint64(page % BOARD_PAGES), Status)

    def channel(self, name: str, kind: type[Kind]) -> Any:
        """An opened channel."""
        return self.service(self.wire["services"][name]).publish_subscribe(kind).open()

    def reader(self, name: str, kind: type[Kind], buffer: int) -> Reader[Kind]:
        """The reading end of a channel, which holds the newest `buffer` samples. It never blocks the writer."""
        try:
            return Reader(self.channel(name, kind), kind, buffer)
        except Exception as cause:
            raise Refused(f"channel {name} has no place for another reader: {error_text(cause)}", 1) from None

    def writer(self, name: str, kind: type[Kind]) -> Writer[Kind]:
        """The writing end of a channel."""
        rings = dict(zip(("observation", "command", "learning"), self.wire["log_rings"]))
        log = LogRing(rings[name], kind) if name in rings else None
        return Writer(self.iox, self.channel(name, kind), log)

    def orphaned(self) -> bool:
        """Whether the launcher has ended. A killed launcher cannot announce its end."""
        return bool(select.select([self.launcher], [], [], 0)[0])

    def over(self) -> bool:
        """Whether the run has ended, or is about to."""
        return bool(self.control.get().phase >= Phase.STOP) or self.orphaned()

    def close(self) -> None:
        """Leaves the run: gives every port back."""
        for name in ("control", "identity", "node"):
            self.__dict__.pop(name, None)
        with contextlib.suppress(OSError):
            os.close(self.launcher)


def join(run: "str | os.PathLike[str] | JoinedRun") -> JoinedRun:
    """The run, joined."""
    return run if isinstance(run, JoinedRun) else JoinedRun(run)


__all__ = ["Board", "JoinedRun", "Observation", "Reader", "Writer", "join", "load_iceoryx2"]
