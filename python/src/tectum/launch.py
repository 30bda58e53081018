"""Starts a run, watches it, stops it, and gives its summary."""

import contextlib
import ctypes
import json
import os
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from .errors import Refused
from .log import Log, read_log
from .programs import find
from .transport import JoinedRun


class Summary(Mapping[str, Any]):
    """What `tectum run --json` says of a run that is over: a mapping with its keys."""

    def __init__(self, facts: dict[str, Any], code: int, said: str) -> None:
        self.facts, self.code, self.said = facts, code, said

    def __getitem__(self, key: str) -> Any:
        return self.facts[key]

    def __iter__(self) -> Any:
        return iter(self.facts)

    def __len__(self) -> int:
        return len(self.facts)

    def __repr__(self) -> str:
        keys = ("scenario", "mode", "seed", "ticks", "missed", "lost", "failure")
        shown = ", ".join(f"{key}={self.facts[key]!r}" for key in keys if self.facts.get(key) is not None)
        return f"Summary(code={self.code}, {shown})"


class Failed(Refused):
    """A run that could not start, or that failed. `summary` is there if it had started."""

    def __init__(self, text: str, code: int, summary: Summary | None = None) -> None:
        super().__init__(text, code)
        self.summary = summary


class RunHandle:
    """A run in progress. In a `with` block it is stopped at the block's end."""

    def __init__(self, process: "subprocess.Popen[str]", folder: Path) -> None:
        self.process, self.folder = process, folder

    def join(self) -> JoinedRun:
        """Joins the run, for example to view it, as soon as it can be joined."""
        self.await_manifest()
        return JoinedRun(self.folder)

    def await_manifest(self) -> None:
        """Waits until processes can join."""
        while not whole(self.folder / "run.json"):
            if self.process.poll() is not None:
                self.wait()
            time.sleep(0.002)

    def running(self) -> bool:
        """Whether it goes on."""
        return self.process.poll() is None

    def stop(self) -> Summary:
        """Ends the run in good order, as Ctrl-C does, and gives its summary."""
        with contextlib.suppress(ProcessLookupError):
            self.process.send_signal(signal.SIGINT)
        return self.wait(check=False)

    def wait(self, timeout: float | None = None, check: bool = True) -> Summary:
        """Waits until the run is over. Raises `Failed` for a run that failed, unless `check` is False, and
        `subprocess.TimeoutExpired` after `timeout` seconds."""
        out, said = self.process.communicate(timeout=timeout)
        code = self.process.returncode
        try:
            summary = Summary(json.loads(out), code, said)
        except ValueError:
            lines = said.strip().splitlines() or [f"tectum run ended with exit code {code}"]
            text = next((line for line in lines if line.startswith("error: ")), lines[-1])
            raise Failed(text.removeprefix("tectum: "), code) from None
        if check and code not in (0, 130, 143):
            text = summary.facts.get("failure") or f"the run failed with exit code {code}"
            raise Failed(text, code, summary)
        return summary

    def log(self) -> Log:
        """The run's log."""
        return read_log(self.folder)

    def __enter__(self) -> "RunHandle":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.running():
            self.stop()


def start(
    scenario: str | os.PathLike[str] = "arm",
    *,
    mode: str | None = None,
    seed: int | None = None,
    ticks: float | None = None,
    out: str | os.PathLike[str] | None = None,
    checkpoint_every: float | None = None,
    keep_checkpoints: int | None = None,
    by_hand: Sequence[str] = (),
    arguments: Sequence[str] = (),
) -> RunHandle:
    """Starts a run of a scenario file, or of a built-in scenario, and returns at once.

    `mode` is `lockstep` or `realtime`, by default the scenario's. `out` is the run's folder, by default
    `runs/<scenario>-<n>`. `checkpoint_every` is a number of ticks; of the checkpoints, the newest `keep_checkpoints`
    stay, by default all. `by_hand` names processes that join by themselves. `arguments` are further arguments of
    `tectum run`.
    """
    command = [str(find()), "run", str(scenario), "--json", *arguments]
    folder = Path(out) if out is not None else next_folder(scenario)
    command += ["--out", str(folder)]
    numbers = {
        "--seed": seed,
        "--ticks": ticks,
        "--checkpoint-every": checkpoint_every,
        "--keep-checkpoints": keep_checkpoints,
    }
    command += ["--mode", mode] if mode is not None else []
    for option, value in numbers.items():
        if value is not None:
            command += [option, str(int(value))]
    for role in by_hand:
        command += ["--by-hand", role]
    # In a session of its own: Ctrl-C reaches this program alone, which stops the run.
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        command, stdout=pipe, stderr=pipe, text=True, start_new_session=True, preexec_fn=end_with_parent
    )
    return RunHandle(process, folder)


def whole(manifest: Path) -> bool:
    """Whether the manifest is there, all of it."""
    try:
        return bool(json.loads(manifest.read_text()))
    except (OSError, ValueError):
        return False


def end_with_parent() -> None:
    """Lets the launcher end the run, as by Ctrl-C, when this program is killed (PR_SET_PDEATHSIG)."""
    ctypes.CDLL(None).prctl(1, signal.SIGINT)


def run(scenario: str | os.PathLike[str] = "arm", **options: Any) -> Summary:
    """Runs a scenario to its end and gives its summary. The options are those of `start`.

    Raises `Failed` for a run that failed. Ctrl-C stops the run in good order.
    """
    with start(scenario, **options) as handle:
        return handle.wait()


def next_folder(scenario: str | os.PathLike[str]) -> Path:
    """`runs/<scenario>-<n>`, the first that is free."""
    name, n = Path(scenario).stem or "run", 1
    while (folder := Path("runs") / f"{name}-{n}").exists():
        n += 1
    return folder
