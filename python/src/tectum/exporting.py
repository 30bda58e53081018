"""What the commands that export a run's log share: the need for pyarrow, and exit codes."""

import json
import sys
from collections.abc import Callable
from typing import Any

from .errors import Refused


def need_pyarrow() -> Any:
    """The package pyarrow, with its Parquet files."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise Refused("pyarrow is not installed; pip install pyarrow") from None
    return pyarrow


def run_command(usage: str, counts: tuple[int, ...], export: Callable[..., dict[str, Any]]) -> int:
    """Exports with the arguments of the command line, and prints what was written. Exit code 2 for bad input."""
    arguments = sys.argv[1:]
    if len(arguments) not in counts or arguments[0].startswith("-"):
        print(f"usage: {usage}", file=sys.stderr)
        return 2
    try:
        print(json.dumps(export(*arguments)))
    except (Refused, OSError) as error:
        print(f"tectum: {error}", file=sys.stderr)
        return 2
    return 0
