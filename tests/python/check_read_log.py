"""Compares `tectum.read_log` with `tectum log csv`, column by column.

    check_read_log.py RUN TECTUM    prints what was compared as JSON
"""

import csv
import json
import subprocess
import sys

import numpy as np

import tectum


def main(run, program):
    log = tectum.read_log(run)
    compared = {}
    for channel in ("observation", "command", "learning", "gap"):
        arguments = [program, "log", "csv", run, "--channel", channel]
        text = subprocess.run(arguments, check=True, capture_output=True, text=True).stdout
        head, *rows = list(csv.reader(text.splitlines()))
        columns, wrong = log.columns(channel), []
        for i, name in enumerate(head):
            if name in ("flags", "lost before", "weights hash", "channel"):
                continue  # words, counts of gaps, and hexadecimal numbers
            theirs = np.array([float(row[i]) for row in rows])
            ours = np.asarray(columns[name], dtype=float) if name in columns else None
            if ours is None or not np.array_equal(theirs.astype(np.float32), ours.astype(np.float32)):
                wrong.append(name)
        frame = log.frame(channel)
        compared[channel] = {"rows": len(rows), "columns": len(head), "wrong": wrong, "frame": list(frame.shape)}
    facts = {"complete": log.complete, "inputs": log.inputs, "outputs": log.outputs, "measures": log.measures}
    print(json.dumps({"compared": compared, **facts}))


if __name__ == "__main__":
    main(*sys.argv[1:])
