#!/usr/bin/env python3
"""Repeats the controller's learning from its log alone, with the paper's rule in double precision.

    recompute_means.py LOG TOLERANCE

The log must be of the arm (4 segments, 16 x 16 units for the target, 16 for each angle, radius 0.5 throughout, unit
norm) and hold every tick. Prints as JSON the number of ticks, the largest absolute difference between the policy's
means in the log and those computed here, and the largest mean for comparison. The exit code is 1 if the difference is
above TOLERANCE, or not a number.
"""
import json
import sys

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

LEARNED, TRACE_CUT, BETA, ALPHA_OVER_VARIANCE = 1 << 16, 1 << 17, 0.9, 0.01


def row(x, limit):
    return np.exp(-((x - np.linspace(-limit, limit, 16)) ** 2) / (2 * 0.5**2))


def features(x):
    target = np.outer(row(x[0], 1.0), row(x[1], 1.0)).ravel()
    g = np.concatenate([target] + [row(angle, np.pi) for angle in x[2:6]])
    return g / np.linalg.norm(g)


def main(path, tolerance):
    ticks, largest_difference, largest_mean = {}, 0.0, 0.0
    w, z = np.zeros((4, 320)), np.zeros((4, 320))
    with open(path, "rb") as file:
        for _, channel, _, m in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            if channel.topic != "/gap":
                ticks.setdefault(m.header.tick, {})[channel.topic] = m
    for k in sorted(ticks):
        observation, command, learning = (ticks[k][topic] for topic in ("/observation", "/command", "/learning"))
        if learning.header.flags & LEARNED:  # with the reward of tick k-1 and the trace up to it
            w += ALPHA_OVER_VARIANCE * observation.reward * z
        if learning.header.flags & TRACE_CUT:
            z[:] = 0.0
        g = features(np.array(observation.inputs))
        largest_difference = np.maximum(largest_difference, np.abs(w @ g - command.mean[:4]).max())
        largest_mean = np.maximum(largest_mean, np.abs(command.mean[:4]).max())
        z = BETA * z + (1 - BETA) * np.outer(learning.noise[:4], g)
    result = {
        "ticks": len(ticks),
        "largest_difference": float(largest_difference),
        "largest_mean": float(largest_mean),
    }
    print(json.dumps(result))
    return 0 if ticks and largest_difference <= tolerance else 1


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1], float(sys.argv[2])))
