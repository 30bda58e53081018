"""What a run is: its names, ranges, settings and seed, without any channel."""

from pathlib import Path
from typing import Any

from .streams import Stream, generator, stream


class RunFacts:
    """The facts of a run. `wire` is the table of that name in the run manifest."""

    def __init__(self, wire: dict[str, Any], mode: str, folder: Path | None) -> None:
        self.wire, self.mode, self.folder = wire, mode, folder
        self.settings: dict[str, Any] = wire["settings"]
        """The scenario, every default filled in."""
        self.period_ns: int = wire["period_ns"]
        self.period: float = self.period_ns / 1e9
        """Seconds from tick to tick."""
        self.seed: int = self.settings["seed"]
        self.ticks: int = self.settings["ticks"]
        self.inputs: list[str] = wire["inputs"]
        self.outputs: list[str] = wire["outputs"]
        self.measures: list[str] = wire["measures"]
        signals = wire["signals"]
        self.input_ranges: list[tuple[float, float]] = [(s["min"], s["max"]) for s in signals["inputs"]]
        self.output_ranges: list[tuple[float, float]] = [(s["min"], s["max"]) for s in signals["outputs"]]
        self.error: int | None = signals["error"]
        """The measure with the role `error`."""
        self.real = mode == "realtime"
        self.id = 0
        self.arguments: Any = None
        """The program's own arguments."""

    def stream(self, name: str) -> Stream:
        """The random stream `name` of this run; the numbers of a Rust plant's stream of that name."""
        return stream(self.seed, name)

    def generator(self, name: str) -> Any:
        """A numpy generator that depends on the run's seed and `name` alone."""
        return generator(self.seed, name)
