"""A controller in Python: it learns the gain with which a cart follows its target.

    target/release/tectum run examples/python/controller.toml
    target/release/tectum run examples/python/controller.toml --mode realtime --ticks 400

The rule is REINFORCE with the last reward as baseline: noise after which the reward rose makes the gain follow it, in
part. Killed, it comes back with all that it had learned.
"""

import tectum

SIGMA = 0.3  # standard deviation of the exploration noise
STEP = 0.2


class Follow(tectum.Controller):
    """output = gain * (target - position) + noise"""

    def __init__(self, run):
        self.noise = run.generator("noise")
        self.gain, self.last_reward, self.score = 0.0, 0.0, 0.0
        self.fresh = True

    def act(self, percept):
        position, target = percept.inputs
        error, noise = float(target - position), SIGMA * float(self.noise.normal())
        self.score, self.fresh = noise * error / SIGMA**2, percept.boundary == "new target"
        mean = self.gain * error
        return tectum.Answer(command=[mean + noise], mean=[mean])

    def learn(self, experience):
        rise, self.last_reward = experience.reward - self.last_reward, experience.reward
        if experience.withheld or experience.limited or self.fresh:
            return False  # not what it asked for was applied, or the last reward was another target's
        self.gain += STEP * rise * self.score
        return True

    columns = ("gain",)  # in the log's learning record

    def record(self):
        return [self.gain]

    def state(self):
        return {"numbers": [self.gain, self.last_reward, self.score, self.fresh], "noise": self.noise}

    def restore(self, state):
        self.gain, self.last_reward, self.score, self.fresh = state["numbers"]
        tectum.restore_generator(self.noise, state["noise"])


if __name__ == "__main__":
    tectum.main(Follow, "Learns the gain with which a cart follows its target")
