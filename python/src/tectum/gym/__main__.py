"""Environments as plants from the command line.

    python -m tectum.gym scenario Pendulum-v1 > pendulum.toml    a scenario to start from
    python -m tectum.gym plant Pendulum-v1 --run RUN             the plant; a launcher starts it by such a scenario
"""

import sys

from ..errors import Refused
from ..main import main
from .plant import GymPlant
from .scenario import scenario


def command(arguments: list[str]) -> None:
    if len(arguments) >= 2 and arguments[0] == "scenario":
        print(scenario(arguments[1], sys.executable), end="")
    elif len(arguments) >= 2 and arguments[0] == "plant":
        sys.argv[1:] = arguments[2:]
        main(GymPlant(arguments[1]), f"{arguments[1]} of Gymnasium as a plant")
    else:
        raise Refused(f"usage:\n{__doc__}")


try:
    command(sys.argv[1:])
except Refused as cause:
    print(f"tectum.gym: {cause}", file=sys.stderr)
    sys.exit(cause.code)
