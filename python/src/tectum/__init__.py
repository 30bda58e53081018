"""Plants, controllers, viewers and trackers of Tectum runs in Python; runs themselves, and their logs.

    class Cart(tectum.Plant): ...        # sense(tick, inputs), advance(tick, applied)
    class Follow(tectum.Controller): ... # act(percept), and if it learns: learn(experience), improve()
    tectum.main(Cart)

    tectum.run("arm", ticks=2000)        # launches a run and gives its summary
    tectum.read_log("runs/arm-1")        # its log as numpy arrays, or pandas frames

`tectum.gym` makes a Gymnasium environment a plant, and a run a Gymnasium environment. docs/python.md has the details.
"""

from .controller import Answer, Controller, Experience, Percept
from .errors import Ended, Mistake, Refused
from .gate import Gate, f32
from .launch import Failed, RunHandle, Summary, run, start
from .layouts import Command, Flag, Learning, Observation
from .log import Log, read_log
from .main import main
from .plant import Outcome, Plant
from .streams import Stream, generator, restore_generator, stream
from .transport import JoinedRun
from .watch import Tracker, Viewer

__version__ = "0.1.0"
__all__ = [
    "Answer",
    "Command",
    "Controller",
    "Ended",
    "Experience",
    "Failed",
    "Flag",
    "Gate",
    "JoinedRun",
    "Learning",
    "Log",
    "Mistake",
    "Observation",
    "Outcome",
    "Percept",
    "Plant",
    "Refused",
    "RunHandle",
    "Stream",
    "Summary",
    "Tracker",
    "Viewer",
    "f32",
    "generator",
    "main",
    "read_log",
    "restore_generator",
    "run",
    "start",
    "stream",
]
