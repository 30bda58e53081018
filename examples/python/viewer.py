"""Watches a run from outside: one line a second from the plant's observations.

    target/python/bin/python examples/python/viewer.py --run arm-1

It never slows the loop: channels overflow, and a reader that is behind loses its oldest samples. The viewer prints how
many it lost.
"""

import argparse
import time

import tectum

parser = argparse.ArgumentParser(description="A line a second of a run that is going on")
parser.add_argument("--run", required=True, help="the run to watch: its folder, or its name under runs/")
parser.add_argument("--every", type=float, default=1.0, help="seconds between two lines")
arguments = parser.parse_args()
try:
    viewer = tectum.Viewer(arguments.run)
except tectum.Refused as cause:
    parser.exit(cause.code, f"viewer.py: {cause}\n")

seen, rewards, shown, last = 0, 0.0, time.monotonic(), None


def line():
    values = zip(viewer.run.inputs, last.inputs)
    inputs = "  ".join(f"{name} {value:+.3f}" for name, value in values)
    counts = f"seen {seen}  lost {viewer.lost}"
    print(f"tick {last.header.tick}  reward {rewards / seen:+.4f}  {counts}  {inputs}", flush=True)


for last in viewer:
    seen, rewards = seen + 1, rewards + last.reward
    if time.monotonic() - shown >= arguments.every:
        line()
        seen, viewer.lost, rewards, shown = 0, 0, 0.0, time.monotonic()
if seen:
    line()
