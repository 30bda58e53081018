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
from .participant import program
from .plant import PlantLoop
from .transport import JoinedRun


class Parser(argparse.ArgumentParser):
    """A parser that explains why `--run` is needed."""

    def error(self, message: str) -> NoReturn:
        if "--run" in message:
            name = program()
            text = f"is one process of a run and was given none; start the run: `tectum run SCENARIO`, where {name}"
            message = f"{text} stands under [plant] or [controller], or join one with --run RUN (--by-hand)"
        self.exit(2, f"{program()}: {message}\n")


def main(
    build: Callable[[JoinedRun], Any],
    about: str | None = None,
    options: Callable[[argparse.ArgumentParser], None] | None = None,
) -> NoReturn:
    """Takes part in the run that the command line names, as the plant or controller that `build(run)` returns, and
    ends the process. `options(parser)` adds arguments, which the body finds in `run.arguments`.

    Every failure is one sentence on standard error, after the traceback where the author's own code raised it. The exit
    codes are those of all processes of a run: 2 for bad input, 3 where process and run do not fit, 4 for a failure.
    """
    parser = Parser(description=about or inspect.getdoc(build))
    parser.add_argument("--run", required=True, help="the run to join: its folder, or its name under runs/")
    if options is not None:
        options(parser)
    arguments = parser.parse_args()
    code, run = 0, None
    try:
        run = JoinedRun(arguments.run)
        run.arguments = arguments
        body = made(build, run)
        loop: PlantLoop | ControllerLoop = ControllerLoop(run, body) if hasattr(body, "act") else PlantLoop(run, body)
        loop.go()
    except (Refused, Ended) as cause:
        print(f"{program()}: {cause}", file=sys.stderr)
        code = cause.code
    sys.stdout.flush()
    sys.exit(code)


def made(build: Callable[[JoinedRun], Any], run: JoinedRun) -> Any:
    """The body that the author's code makes."""
    name = getattr(build, "__name__", "the body")
    try:
        return build(run)
    except (Refused, Ended):
        raise
    except TypeError as cause:
        missing = sorted(getattr(build, "__abstractmethods__", ()))
        if missing:
            raise Refused(f"{name} ({where_class(build)}) has no method {' and no method '.join(f'{m}()' for m in missing)}; add it") from None
        raise failed(build, run, cause) from None
    except Exception as cause:
        raise failed(build, run, cause) from None


def failed(build: Callable[[JoinedRun], Any], run: JoinedRun, cause: Exception) -> Refused:
    name, at = getattr(build, "__name__", "the body"), place(cause.__traceback__)
    if isinstance(cause, TypeError) and len(traceback.extract_tb(cause.__traceback__)) == 1:  # raised by the call itself
        return Refused(f"{name} is made with one argument, the run: {cause}")
    traceback.print_exception(cause)
    # A program that failed before it took a role: the scenario says which one it was to take.
    controller = run.settings.get("controller", {})
    mine = any(program() in argument for argument in (controller.get("program", ""), *controller.get("args", ())))
    seen = traceback_place(run, "controller" if mine else "plant")
    return Mistake(f"{sentence(cause)}, at {at}, in {name}, before the first tick; {seen}")
