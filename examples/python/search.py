"""Random search over a run's plant through Gymnasium's interface: ten lines that learn to reach with the arm.

    target/python/bin/python examples/python/search.py                              # the simulator, as fast as it goes
    target/python/bin/python examples/python/search.py --scenario servo-emulated    # servos, in real time

The policy is linear in the inputs and in the sines and cosines of the angles. In each episode it is tried with a random
change, which is kept if the episode's reward is better (Mania et al. 2018 call a near relative of it ARS).
"""

import argparse

import numpy as np

import tectum
from tectum.gym import TectumEnv

parser = argparse.ArgumentParser(description="Random search over a run's plant")
parser.add_argument("--scenario", default="arm", help="the scenario whose plant is to be controlled")
parser.add_argument("--episodes", type=int, default=200, help="number of episodes")
parser.add_argument("--seed", type=int, default=1, help="seed of the run and of the search")
arguments = parser.parse_args()


def features(inputs):
    return np.concatenate([[1.0], inputs[:2], np.sin(inputs[2:]), np.cos(inputs[2:])])


def episode(weights):
    inputs, total, over = env.reset()[0], 0.0, False
    while not over:
        action = np.clip(weights @ features(inputs), env.action_space.low, env.action_space.high)
        inputs, reward, terminated, truncated, info = env.step(action.astype(np.float32))
        total, over = total + reward, terminated or truncated
    return total


env, draw = TectumEnv(arguments.scenario, seed=arguments.seed), np.random.default_rng(arguments.seed)
size = env.action_space.shape[0], len(features(env.observation_space.low))
try:
    best, weights, scale = -np.inf, np.zeros(size), 0.05 * env.action_space.high[:, None]
    for n in range(arguments.episodes):
        tried = weights + scale * draw.normal(size=size)
        reward = np.mean([episode(tried) for _ in range(4)])  # targets differ
        if reward > best:
            best, weights = reward, tried
            print(f"after {n + 1} tries: reward of an episode {best:.2f}", flush=True)
except tectum.Refused as cause:
    parser.exit(cause.code, f"search.py: {cause}\n")
finally:
    env.close()
