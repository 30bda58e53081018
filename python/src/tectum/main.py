"""The entry point of a program that is a plant or a controller of a run."""

import argparse
import inspect
import sys
import traceback
from collections.abc import Callable
from typing import Any, NoReturn

from .checks import place, sentence, traceback_place, where_class
from .controller_loop import ControllerLoop
from .errors import Ended, Mistake, Refused
from .facts import RunFacts
from .participant import program
from .pipe import serve
from .plant import PlantLoop
from .transport import JoinedRun


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{program()}: {message}\n")


def main(
    build: Callable[[Any], Any],
    about: str | None = None,
    options: Callable[[argparse.ArgumentParser], None] | None = None,
) -> NoReturn:
    """Takes part in the run that the command line names, as the plant or controller that `build(run)` returns, and
    ends the process. `options(parser)` adds arguments, which the body finds in `run.arguments`.

    Every failure is one sentence on standard error, after the traceback where the author's own code raised it. The exit
    codes are those of all processes of a run: 2 for bad input, 3 where process and run do not fit, 4 for a failure.
    """
    parser = Parser(description=about or inspect.getdoc(build))
    parser.add_argument("--run", help="the run to join: its folder, or its name under runs/")
    parser.add_argument("--pipe", action="store_true", help="serve a run in one process, or a replay, on a pipe")
    if options is not None:
        options(parser)
    arguments = parser.parse_args()
    if arguments.run is None and not arguments.pipe:
        text = f"is one process of a run and was given none; start the run: `tectum run SCENARIO`, where {program()}"
        parser.error(f"{text} stands under [plant] or [controller], or join one with --run RUN (--by-hand)")
    if arguments.pipe:
        sys.exit(serve(lambda run: made(build, run), arguments))
    code = 0
    try:
        joined = JoinedRun(arguments.run)
        joined.arguments = arguments
        body = made(build, joined)
        of: type[ControllerLoop | PlantLoop] = ControllerLoop if hasattr(body, "act") else PlantLoop
        of(joined, body).go()
    except (Refused, Ended) as cause:
        print(f"{program()}: {cause}", file=sys.stderr)
        code = cause.code
    sys.stdout.flush()
    sys.exit(code)


def made(build: Callable[[Any], Any], run: RunFacts) -> Any:
    """The body that the author's code makes."""
    name = getattr(build, "__name__", "the body")
    try:
        return build(run)
    except (Refused, Ended):
        raise
    except TypeError as cause:
        missing = sorted(getattr(build, "__abstractmethods__", ()))
        if missing:
            methods = " and no method ".join(f"{method}()" for method in missing)
            raise Refused(f"{name} ({where_class(build)}) has no method {methods}; add it") from None
        raise failed(name, run, cause) from None
    except Exception as cause:
        raise failed(name, run, cause) from None


def failed(name: str, run: RunFacts, cause: Exception) -> Refused:
    """What the author's code raised while the body was made, as a sentence."""
    # With one frame it was raised by the call itself.
    if isinstance(cause, TypeError) and len(traceback.extract_tb(cause.__traceback__)) == 1:
        return Refused(f"{name} is made with one argument, the run: {cause}")
    traceback.print_exception(cause)
    # A program that failed before it took a role: the scenario says which one it was to take.
    table = run.settings.get("controller", {})
    mine = any(program() in word for word in (table.get("program", ""), *table.get("args", ())))
    seen = traceback_place(run, "controller" if mine else "plant")
    return Mistake(f"{sentence(cause)}, at {place(cause.__traceback__)}, in {name}, before the first tick; {seen}")
