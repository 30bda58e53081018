"""Finds the Rust programs of Tectum, which launch a run and are its other processes."""

import os
import shutil
from pathlib import Path

from .errors import Refused


def find(name: str = "tectum") -> Path:
    """The program `name`: in the folder that TECTUM_BIN names, in PATH, or in `target/release` or `target/debug` of the
    checkout that holds the current folder or this package.

    Raises `Refused`, with the way to get the programs, where there is none.
    """
    given = os.environ.get("TECTUM_BIN")
    if given:
        program = Path(given) / name if Path(given).is_dir() else Path(given).parent / name
        if program.is_file():
            return program.resolve()
        raise Refused(f"TECTUM_BIN is {given}, and there is no program {name} there; name the folder that holds it")
    if (found := shutil.which(name)) is not None:
        return Path(found)
    for start in (Path.cwd(), Path(__file__).resolve()):
        for folder in (start, *start.parents):
            for build in ("release", "debug"):
                program = folder / "target" / build / name
                if (folder / "Cargo.toml").is_file() and program.is_file():
                    return program
    raise Refused(
        f"there is no program {name}: neither in TECTUM_BIN nor in PATH nor in a checkout's target folder; build it in "
        "a checkout of Tectum (`cargo build --release --locked`) or install it (`cargo install --path . --locked`)"
    )
