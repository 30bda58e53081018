"""Launches, views and stops runs with the package `tectum`, in the current folder. Prints what came of it as JSON."""

import json

import tectum

summary = tectum.run("arm", ticks=500, seed=3, out="whole")
log = tectum.read_log("whole")
with tectum.start("paper", ticks=10_000_000, out="stopped") as handle:
    viewer = tectum.Viewer(handle.join())
    seen = [observation.header.tick for observation, _ in zip(viewer, range(200))]
    ended = handle.stop()
mistakes = []
for scenario, options in (("no-such-scenario", {}), ("arm", {"out": "whole"}), ("arm", {"arguments": ["--what"]})):
    try:
        tectum.run(scenario, **options)
    except tectum.Failed as failed:
        mistakes.append([failed.code, str(failed)])
try:
    tectum.read_log("nothing")
except tectum.Refused as refused:
    mistakes.append([refused.code, str(refused)])
print(json.dumps({
    "ticks": summary["ticks"],
    "logged": len(log.observation),
    "same": summary["weights_hash"] == f"{log.learning['weights_hash'][-1]:016x}",
    "rising": seen == sorted(set(seen)) and len(seen) == 200,
    "ended": [ended.code, ended["ended"]],
    "mistakes": mistakes,
}))
