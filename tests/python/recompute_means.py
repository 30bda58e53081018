#!/usr/bin/env python3
"""Repeats what the controller learned from nothing but its log, with the paper's rule in double precision.

    recompute_means.py LOG TOLERANCE

For a log of the arm (4 segments, 16 x 16 units for the target, 16 for each angle, radius 0.5 throughout, unit norm) of
which every tick is written. Prints, as JSON, the number of ticks, the largest absolute difference between the policy's
means as logged and as computed here, and the largest mean for comparison. Ends with 1 if the difference is above
TOLERANCE, or not a number.
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
    ticks, worst, most, w, z = {}, 0.0, 0.0, np.zeros((4, 320)), np.zeros((4, 320))
    with open(path, "rb") as file:
        for _, channel, _, m in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            if channel.topic != "/gap":
                ticks.setdefault(m.header.tick, {})[channel.topic] = m
    for k in sorted(ticks):
        seen, sent, learned = (ticks[k][topic] for topic in ("/observation", "/command", "/learning"))
        if learned.header.flags & LEARNED:  # with the reward of tick k-1, and the trace up to it
            w += ALPHA_OVER_VARIANCE * seen.reward * z
        if learned.header.flags & TRACE_CUT:
            z[:] = 0.0
        g = features(np.array(seen.inputs))
        worst = np.maximum(worst, np.abs(w @ g - sent.mean[:4]).max())
        most = np.maximum(most, np.abs(sent.mean[:4]).max())
        z = BETA * z + (1 - BETA) * np.outer(learned.noise[:4], g)
    print(json.dumps({"ticks": len(ticks), "largest_difference": float(worst), "largest_mean": float(most)}))
    return 0 if ticks and worst <= tolerance else 1


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1], float(sys.argv[2])))
