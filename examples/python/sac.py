"""Stable-Baselines3's SAC over a run's plant: the simulator in lockstep, or servos at the real 50 ms, gate included.

    target/python/bin/pip install stable-baselines3      # with PyTorch, some GB
    target/python/bin/python examples/python/sac.py --steps 5000
    target/python/bin/python examples/python/sac.py --scenario servo-emulated --steps 2000

In real time SAC trains between two ticks and misses those for which it is late; the gate then holds the last command.
"""

import argparse
import time

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC

from tectum.gym import TectumEnv

parser = argparse.ArgumentParser(description="Soft actor-critic over a run's plant")
parser.add_argument("--scenario", default="arm", help="the scenario whose plant is to be controlled")
parser.add_argument("--mode", choices=["lockstep", "realtime"], help="default: the scenario's own")
parser.add_argument("--steps", type=int, default=5000, help="ticks to learn for")
parser.add_argument("--seed", type=int, default=1, help="seed of run and learner")
arguments = parser.parse_args()


torch.set_num_threads(1)  # two threads wait for each other where plant and controller need the cores


class Counted(gymnasium.Wrapper):
    """Counts the ticks that were missed, and the loss of each episode."""

    missed, losses, loss = 0, (), 0.0

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.missed += info["withheld"] == "missed"
        self.loss -= reward
        if terminated or truncated:
            self.losses, self.loss = (*self.losses, self.loss), 0.0
        return observation, reward, terminated, truncated, info


plant = TectumEnv(arguments.scenario, mode=arguments.mode, seed=arguments.seed)
env = Counted(gymnasium.wrappers.RescaleAction(plant, np.float32(-1.0), np.float32(1.0)))
try:
    began = time.monotonic()
    SAC("MlpPolicy", env, seed=arguments.seed, learning_starts=200, device="cpu").learn(arguments.steps)
    seconds, losses = time.monotonic() - began, env.losses
finally:
    env.close()
tenth = max(len(losses) // 10, 1)
print(f"{arguments.steps} ticks in {seconds:.0f} s, {env.missed} missed; {len(losses)} episodes:")
first, last = np.mean(losses[:tenth]), np.mean(losses[-tenth:])
print(f"loss of an episode {first:.2f} in the first tenth, {last:.2f} in the last")
