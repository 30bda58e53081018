"""A tracker without a camera, to try `sight = "vision"`: a stand-in for a program that observes the arm.

    target/release/tectum run servo-vision --name seen &
    target/python/bin/python examples/python/tracker.py --run seen

A real tracker computes positions from a camera's pictures. This one computes them from the measured angles, which
it reads like any viewer, and the scenario's lengths. It also draws the targets. Everything else is as for a real
one: publish where target and end-effector are in each picture, and when the picture was taken.
"""

import argparse
import math
import random
import time

import tectum

parser = argparse.ArgumentParser(description="A stand-in for a camera: publishes target and end-effector")
parser.add_argument("--run", required=True, help="the run to observe: its folder, or its name under runs/")
parser.add_argument("--rate", type=float, default=30.0, help="pictures a second")
parser.add_argument("--noise", type=float, default=0.003, help="standard deviation of the measured positions, m")
arguments = parser.parse_args()
try:
    tracker = tectum.Tracker(arguments.run)
    run, observations = tracker.run, tectum.Viewer(tracker.run, buffer=2)
except tectum.Refused as cause:
    parser.exit(cause.code, f"tracker.py: {cause}\n")

arm = run.settings["plant"]["arm"]
draw, target, shown = random.Random(f"{run.seed}/tracker"), None, -1
while not run.over():
    newest = observations.newest()
    if newest is not None:
        while shown < newest.header.tick // arm["target_every"]:
            target = [draw.uniform(*arm["arena"]) for _ in range(2)]
            shown += math.dist(target, arm["base"]) < sum(arm["lengths"])
        end, direction = list(arm["base"]), 0.0
        for length, angle in zip(arm["lengths"], newest.inputs[2:]):
            direction = angle if arm["angles"] == "absolute" else direction + angle
            end = [end[0] + length * math.cos(direction), end[1] + length * math.sin(direction)]
        about = [[x + draw.gauss(0.0, arguments.noise) for x in at] for at in (target, end)]
        tracker.publish(newest.header.sensed_ns, *about)  # the picture is as old as the angles in it
    time.sleep(1.0 / arguments.rate)
