"""The author's code, called so that each mistake in it becomes one sentence with file and line.

`Author` calls the methods of a plant or a controller. What the code raises, and what it returns and should not, becomes
a `Mistake`, or at the start, before any tick, a `Refused`. The table of mistakes is in docs/python.md.
"""

import inspect
import math
import re
import sys
import sysconfig
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

import numpy as np

from .errors import Ended, Mistake, Refused
from .facts import RunFacts

PACKAGE = str(Path(__file__).resolve().parent)
FOREIGN = tuple({PACKAGE, *(sysconfig.get_paths()[key] for key in ("stdlib", "platstdlib", "purelib", "platlib"))})


def where(method: Callable[..., Any]) -> str:
    """`plant.py:27`: file and line in which a method begins."""
    code = getattr(inspect.unwrap(getattr(method, "__func__", method)), "__code__", None)
    return f"{Path(code.co_filename).name}:{code.co_firstlineno}" if code else "a built-in"


def where_class(kind: Any) -> str:
    """File and line in which a class begins."""
    try:
        return f"{Path(inspect.getfile(kind)).name}:{inspect.getsourcelines(kind)[1]}"
    except (OSError, TypeError):
        return "a built-in"


def place(trace: TracebackType | None) -> str | None:
    """File and line of the innermost of the author's own frames; None where there is none."""
    frames = traceback.extract_tb(trace)
    own = [frame for frame in frames if not frame.filename.startswith((*FOREIGN, "<"))]
    return f"{own[-1].filename}:{own[-1].lineno}" if own else None


class Author:
    """The methods that the author wrote, with checks."""

    def __init__(self, body: Any, run: RunFacts, role: str) -> None:
        self.body, self.run, self.role = body, run, role
        self.name = type(body).__name__

    # --- calls -------------------------------------------------------------------------------------------------

    def requires(self, method: str, call: str, count: int) -> None:
        """Refuses a body that has no `method`, or one that cannot be called with `count` arguments, as in `call`."""
        found = getattr(self.body, method, None)
        if not callable(found) or getattr(found, "__isabstractmethod__", False):
            text = f"{self.name} ({where_class(type(self.body))}) has no method {call}; a {self.role} needs it"
            raise Refused(text)
        try:
            inspect.signature(found).bind(*range(count))
        except TypeError:
            theirs = f"{method}{inspect.signature(found)}"
            raise Refused(f"{self.name}.{method} ({where(found)}) is {theirs}; it is called as {call}") from None
        except ValueError:  # a built-in without a signature
            return

    def failed(self, method: str, tick: int, cause: Exception) -> NoReturn:
        """Turns an exception of the author's code into a mistake, and prints its traceback."""
        if isinstance(cause, (Refused, Ended)):
            raise cause
        at = place(cause.__traceback__) or where(getattr(self.body, method))
        told = re.fullmatch(r"could not broadcast input array from shape \((\d+),\) into shape \((\d+),\)", str(cause))
        if told and method == "sense" and int(told[2]) == len(self.run.inputs):
            names = f"{told[2]}: {', '.join(self.run.inputs)}"
            raise Mistake(f"{self.name}.sense sets {told[1]} inputs, at {at}; the scenario has {names}") from None
        traceback.print_exception(cause)
        seen = traceback_place(self.run, self.role)
        raise Mistake(f"{sentence(cause)}, at {at}, in {self.name}.{method}, tick {tick}; {seen}") from None

    def wrong(self, method: str, tick: int, text: str) -> NoReturn:
        """What a method returned, or left behind, is wrong."""
        raise Mistake(f"{self.name}.{method} ({where(getattr(self.body, method))}) {text}, at tick {tick}")

    # --- values ------------------------------------------------------------------------------------------------

    def check_inputs(self, tick: int, inputs: Any) -> None:
        """Requires a number in every input."""
        if not np.isfinite(inputs).all():
            names = [f"`{n}`" for n, value in zip(self.run.inputs, inputs.tolist()) if not math.isfinite(value)]
            if len(names) == len(self.run.inputs):
                text = "left all inputs unset, or not a number; it sets them in place: `inputs[:] = a, b`"
                self.wrong("sense", tick, f"{text} (`inputs = ..` or `return [..]` sets nothing)")
            self.wrong("sense", tick, f"left the input {' and '.join(names)} unset, or not a finite number")

    def number(self, method: str, tick: int, what: str, value: Any) -> float:
        """`value` as a finite number."""
        if isinstance(value, (str, bytes)) or value is None:
            self.wrong(method, tick, f"gave {short(value)} as {what}, which is no number")
        try:
            number = float(value)
        except (TypeError, ValueError):
            self.wrong(method, tick, f"gave {short(value)} as {what}, which is no number")
        if not math.isfinite(number):
            self.wrong(method, tick, f"gave {number} as {what}; it must be finite")
        return number

    def numbers(self, method: str, tick: int, what: str, values: Any, names: Sequence[str]) -> list[float]:
        """`values` as a finite number for each name."""
        if isinstance(values, np.ndarray):
            values = values.ravel().tolist()
        if isinstance(values, (str, bytes)) or not hasattr(values, "__len__"):
            if len(names) != 1 or values is None:
                text = f"gave {short(values)} as {what}; give a list of {len(names)}: {', '.join(names) or 'none'}"
                self.wrong(method, tick, text)
            values = [values]
        if len(values) != len(names):
            text = f"gave {len(values)} {what}; the scenario has {len(names)}: {', '.join(names) or 'none'}"
            self.wrong(method, tick, text)
        return [self.number(method, tick, f"`{name}`", value) for name, value in zip(names, values)]


def traceback_place(run: RunFacts, role: str) -> str:
    """Where the traceback is that this process has printed."""
    if run.folder is None or sys.stderr.isatty():
        return "the traceback is above"
    return f"the traceback is in {run.folder / f'{role}.stderr'}"


def sentence(cause: BaseException) -> str:
    """`ZeroDivisionError: division by zero`."""
    text = " ".join(str(cause).split())
    return f"{type(cause).__name__}: {text}" if text else type(cause).__name__


def short(value: Any) -> str:
    """A value as it can stand in a sentence."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else text[:57] + "..."
