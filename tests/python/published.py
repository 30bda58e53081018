"""Steps the published environments along trajectories of Tectum's plants, and prints the largest differences.

    published.py TRAJECTORIES.json

Each trajectory has a task, a start state, the commands, and the plant's states and rewards after each of them. The
result is one JSON object: for each trajectory the largest difference of a state and of a reward.
"""

import json
import os
import sys

import numpy as np

# No picture is drawn, so no display is needed.
os.environ.setdefault("MUJOCO_GL", "disable")


def angle(difference):
    """A difference of angles without whole turns."""
    return (difference + np.pi) % (2 * np.pi) - np.pi


def pendulum(start, commands):
    import gymnasium

    env = gymnasium.make("Pendulum-v1").unwrapped
    env.reset(seed=0)
    env.state = np.array(start)
    for command in commands:
        _, reward, *_ = env.step(np.array([2.0 * command[0]]))
        yield env.state, reward


def reacher(start, commands):
    import gymnasium

    env = gymnasium.make("Reacher-v5").unwrapped
    env.reset(seed=0)
    q, v, target = start[0:2], start[2:4], start[4:6]
    env.set_state(np.concatenate([q, target]), np.concatenate([v, [0.0, 0.0]]))
    for command in commands:
        observation, reward, *_ = env.step(np.array(command))
        tip = observation[8:10] + np.array(target)
        yield np.concatenate([env.data.qpos[:2], env.data.qvel[:2], target, tip]), reward


def cart_pole(start, commands, period, exact):
    from dm_control import suite

    env = suite.load("cartpole", "swingup", environment_kwargs={"control_timestep": period})
    env.reset()
    if exact:
        # MuJoCo's solver stops where an iteration gains less than 1e-8, which shows in the forces at the rail's ends.
        env.physics.model.opt.tolerance = 0.0
    with env.physics.reset_context():
        env.physics.data.qpos[:] = start[0:2]
        env.physics.data.qvel[:] = start[2:4]
    for command in commands:
        step = env.step(np.array(command))
        yield np.concatenate([env.physics.data.qpos, env.physics.data.qvel]), step.reward


# For each task: its environment, and which numbers of the state are angles.
TASKS = {
    "pendulum": (pendulum, [0]),
    "reacher": (reacher, [0, 1]),
    "cart-pole": (lambda start, commands: cart_pole(start, commands, 0.05, False), [1]),
    "cart-pole-exact": (lambda start, commands: cart_pole(start, commands, 0.05, True), [1]),
    "cart-pole-10ms": (lambda start, commands: cart_pole(start, commands, 0.01, False), [1]),
    "cart-pole-10ms-exact": (lambda start, commands: cart_pole(start, commands, 0.01, True), [1]),
}


def compare(trajectory):
    environment, angles = TASKS[trajectory["task"]]
    states, rewards = [], []
    published = environment(trajectory["start"], trajectory["commands"])
    for (state, reward), ours, our_reward in zip(published, trajectory["states"], trajectory["rewards"]):
        difference = np.array(state) - np.array(ours)
        difference[angles] = angle(difference[angles])
        states.append(float(np.abs(difference).max()))
        rewards.append(abs(float(reward) - our_reward))
    return {"task": trajectory["task"], "steps": len(states), "state": max(states), "reward": max(rewards)}


if __name__ == "__main__":
    with open(sys.argv[1]) as file:
        print(json.dumps([compare(trajectory) for trajectory in json.load(file)]))
