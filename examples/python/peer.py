"""Stable-Baselines3's SAC, or sb3-contrib's CrossQ, as a controller: peers beside the learners of this package.

    target/python/bin/pip install stable-baselines3 sb3-contrib      # with PyTorch, some GB
    target/release/tectum tasks --task pendulum --learner model-predictive \\
        --learner examples/python/sac.toml --learner examples/python/crossq.toml

One update a tick, as both were published; networks, batch and buffer are the libraries' defaults, with a step of 0.001
as RL Baselines3 Zoo tunes SAC for the pendulum. Inputs are scaled to their ranges; angles come as cosine and sine.
"""

import io

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.logger import Logger

import tectum

torch.set_num_threads(1)  # a study runs a child on every core
LEARNING_STARTS = 100  # ticks of random commands


def wraps(signal):
    """Whether an input goes on at the other end of its range: as it says, or as a direction does."""
    full_turn = abs((signal["max"] - signal["min"]) / (2.0 * np.pi) - 1.0) < 1e-6
    return signal.get("wraps", signal["unit"] == "rad" and full_turn)


class Spaces(gymnasium.Env):
    """What the libraries ask of an environment before they learn: its spaces."""

    def __init__(self, inputs, outputs):
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (inputs,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (outputs,), np.float32)


class Peer(tectum.Controller):
    """An off-policy learner with a replay buffer."""

    def __init__(self, run):
        signals = run.wire["signals"]["inputs"]
        self.wraps = np.array([wraps(signal) for signal in signals])
        self.low, self.high = np.array(run.input_ranges, dtype=np.float32).T
        limit = run.settings["gate"]["max_command"]
        self.limit = np.broadcast_to(np.array(limit, dtype=np.float32), len(run.outputs))
        self.seen = len(signals) + int(self.wraps.sum())
        self.noise = run.generator("noise")
        rule = run.settings["learner"]["rule"]
        self.learner = self.made(rule, run)
        self.ticks = 0

    def made(self, rule, run):
        env = Spaces(self.seen, len(run.outputs))
        settings = {"seed": run.seed % 2**32, "device": "cpu", "buffer_size": max(run.ticks, 1), "learning_rate": 1e-3}
        if rule == "sac":
            learner = SAC("MlpPolicy", env, **settings)
        elif rule == "crossq":
            from sb3_contrib import CrossQ

            learner = CrossQ("MlpPolicy", env, **settings)
        else:
            raise tectum.Refused(f'learner.rule is {rule!r}; peer.py has "sac" and "crossq"')
        learner.set_logger(Logger(None, []))
        return learner

    def scaled(self, inputs):
        """The inputs as the networks see them."""
        across = 2.0 * (inputs - self.low) / (self.high - self.low) - 1.0
        angles = np.pi * across[self.wraps]
        return np.concatenate([across[~self.wraps], np.cos(angles), np.sin(angles)]).astype(np.float32)

    def act(self, percept):
        seen = self.scaled(percept.inputs)
        mean, _ = self.learner.predict(seen, deterministic=True)
        if self.ticks < LEARNING_STARTS:
            drawn = self.noise.uniform(-1.0, 1.0, len(self.limit))
        else:
            drawn, _ = self.learner.predict(seen, deterministic=False)
        return tectum.Answer(command=self.limit * drawn, mean=self.limit * mean)

    def learn(self, experience):
        self.ticks += 1
        # The inputs after a cut are those of another episode.
        if experience.withheld or experience.boundary == "truncated":
            return False
        before, after = self.scaled(experience.inputs)[None], self.scaled(experience.next_inputs)[None]
        action = (experience.applied / self.limit)[None].astype(np.float32)
        ended = np.array([experience.boundary == "terminated"])
        self.learner.replay_buffer.add(before, after, action, np.array([experience.reward]), ended, [{}])
        return True

    def improve(self):
        if self.ticks >= LEARNING_STARTS and self.learner.replay_buffer.size() > 0:
            self.learner.train(gradient_steps=1, batch_size=self.learner.batch_size)

    # Everything that a test, or the end of the process, must not change.

    def state(self):
        buffer, stored = self.learner.replay_buffer, io.BytesIO()
        torch.save(self.learner.get_parameters() | {"entropy": self.learner.log_ent_coef.data}, stored)
        count = buffer.size()
        arrays = (buffer.observations, buffer.next_observations, buffer.actions, buffer.rewards, buffer.dones)
        return {
            "learner": stored.getvalue(),
            "buffer": [array[:count] for array in arrays],
            "pos": [buffer.pos, buffer.full],
            "counts": [self.ticks, self.learner._n_updates],
            "torch": torch.get_rng_state().numpy(),
            "numpy": list(np.random.get_state(legacy=True)),
            "noise": self.noise,
        }

    def restore(self, state):
        learner, buffer = self.learner, self.learner.replay_buffer
        stored = torch.load(io.BytesIO(state["learner"]), weights_only=True)
        learner.log_ent_coef.data.copy_(stored.pop("entropy"))
        learner.set_parameters(stored, exact_match=True)
        arrays = (buffer.observations, buffer.next_observations, buffer.actions, buffer.rewards, buffer.dones)
        for array, kept in zip(arrays, state["buffer"], strict=True):
            array[: len(kept)] = kept
        buffer.pos, buffer.full = state["pos"]
        self.ticks, learner._n_updates = state["counts"]
        torch.set_rng_state(torch.from_numpy(state["torch"]))
        np.random.set_state(tuple(state["numpy"]))
        tectum.restore_generator(self.noise, state["noise"])


if __name__ == "__main__":
    tectum.main(Peer, "SAC or CrossQ, one update a tick")
