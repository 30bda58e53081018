"""Runs `TectumEnv` through Gymnasium's checker and through some episodes. Prints what came of it as JSON.

    gym_env.py SCENARIO TICKS MODE
"""

import json
import sys
import warnings

import numpy as np
from gymnasium.utils.env_checker import check_env

from tectum.gym import TectumEnv

scenario, ticks, mode = sys.argv[1], int(sys.argv[2]), sys.argv[3]


def steps(env, seed, count):
    draw, rows = np.random.default_rng(7), []
    inputs, _ = env.reset(seed=seed)
    reasons, ends = {}, 0
    for _ in range(count):
        action = draw.uniform(env.action_space.low, env.action_space.high).astype(np.float32)
        inputs, reward, terminated, truncated, info = env.step(0.05 * action)
        rows.append([*inputs, reward])
        reasons[str(info["withheld"])] = reasons.get(str(info["withheld"]), 0) + 1
        if terminated or truncated:
            ends += 1
            inputs, _ = env.reset()
    return np.array(rows), reasons, ends


env = TectumEnv(scenario, ticks=ticks, mode=mode, out="env")
result = {"checked": False}
try:
    if mode == "lockstep":
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # what the checker only advises counts, too
            check_env(env, skip_render_check=True)
        result["checked"] = True
        # More ticks than a run has: the episodes go on in the next run.
        (first, *_), (again, *_), (other, reasons, ends) = (steps(env, seed, 2 * ticks) for seed in (5, 5, 6))
        result |= {"same": bool((first == again).all()), "other": bool((first == other).all())}
    else:
        for attempt in range(5):
            try:
                _, reasons, ends = steps(env, 5, ticks - 2)
                break
            except RuntimeError as cause:  # on a busy machine emulated servos may be too slow to be armed
                if attempt == 4 or "not armed" not in str(cause):
                    raise
    result |= {"reasons": reasons, "ends": ends}
    for action in (np.zeros(9), np.full(env.action_space.shape, np.nan)):
        try:
            env.step(action)
        except ValueError as cause:
            result.setdefault("mistakes", []).append(str(cause))
finally:
    env.close()
summary = env.summary
print(json.dumps(result | {"lost": summary["lost"], "code": summary.code, "ticks": summary["ticks"]}))
