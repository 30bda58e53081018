"""A controller in Python: it learns the gain with which a cart follows its target.

    target/release/tectum run examples/python/controller.toml
    target/release/tectum run examples/python/controller.toml --mode realtime --ticks 400

The rule is REINFORCE with a running mean of the reward as baseline: a change of the gain that was followed by a better
reward than usual is made permanent, in part. Killed, it comes back with all that it had learned.
"""

import tectum

SIGMA = 0.1  # standard deviation of the exploration noise
STEP = 0.05


class Follow(tectum.Controller):
    """output = gain * (target - position) + noise"""

    def __init__(self, run):
        self.noise = run.generator("noise")
        self.gain, self.mean_reward, self.score = 0.0, 0.0, 0.0

    def act(self, percept):
        position, target = percept.inputs
        error, noise = float(target - position), SIGMA * float(self.noise.normal())
        self.score = noise * error / SIGMA**2
        mean = self.gain * error
        return tectum.Answer(drawn=[mean + noise], mean=[mean])

    def learn(self, transition):
        if transition.why_not or transition.limited or transition.new_target:
            return  # what was applied was not what it asked for, or the reward is another target's
        advantage = transition.reward - self.mean_reward
        self.mean_reward += 0.01 * advantage
        self.gain += STEP * advantage * self.score

    def state(self):
        return {"numbers": [self.gain, self.mean_reward, self.score], "noise": self.noise}

    def restore(self, state):
        self.gain, self.mean_reward, self.score = state["numbers"]
        tectum.restore_generator(self.noise, state["noise"])


if __name__ == "__main__":
    tectum.main(Follow, "Learns the gain with which a cart follows its target")
