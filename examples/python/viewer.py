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
    run = tectum.Run(arguments.run)
    observations = run.reader("observation", tectum.Observation, 64)
except tectum.Refused as cause:
    parser.exit(cause.code, f"viewer.py: {cause}\n")

seen, lost, expected, rewards, shown = 0, 0, None, 0.0, time.monotonic()
over = False
while not over:
    over = run.run_ended()  # checked before the channel, so that everything sent until then is still received
    while (observation := observations.receive()) is not None:
        sequence = observation.header.sequence
        lost += 0 if expected is None else max(sequence - expected, 0)
        seen, expected, rewards, last = seen + 1, sequence + 1, rewards + observation.reward, observation
    if seen and (over or time.monotonic() - shown >= arguments.every):
        inputs = "  ".join(f"{name} {value:+.3f}" for name, value in zip(run.inputs, last.inputs))
        print(f"tick {last.header.tick}  reward {rewards / seen:+.4f}  seen {seen}  lost {lost}  {inputs}", flush=True)
        seen, lost, rewards, shown = 0, 0, 0.0, time.monotonic()
    time.sleep(0.005)
