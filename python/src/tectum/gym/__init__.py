"""Gymnasium both ways: an environment as a plant, and a run as an environment.

    tectum.main(tectum.gym.GymPlant("Pendulum-v1"))   # a plant of a run
    env = tectum.gym.TectumEnv("arm")                 # a gymnasium.Env over a run's plant

Needs the package gymnasium: `pip install './python[gym]'`.
"""

from ..errors import Refused

try:
    import gymnasium as _gymnasium  # noqa: F401
except ImportError:
    raise Refused("this Python has no gymnasium; install it: pip install gymnasium") from None

from .env import TectumEnv
from .plant import GymBody, GymPlant
from .scenario import scenario

__all__ = ["GymBody", "GymPlant", "TectumEnv", "scenario"]
