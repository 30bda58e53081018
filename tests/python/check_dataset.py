#!/usr/bin/env python3
"""Reads a LeRobotDataset and a Parquet table with pyarrow and compares them with the log.

    check_dataset.py SET TABLE RUN

Prints as JSON the lengths of the episodes and all faults found.
"""
import json
import sys
from pathlib import Path

import numpy as np
import pandas
import pyarrow.parquet as parquet
import tectum


def main(folder, table, run):
    faults = []

    def check(what, holds):
        if not holds:
            faults.append(what)

    folder, log = Path(folder), tectum.read_log(run)
    info = json.loads((folder / "meta/info.json").read_text())
    data = parquet.read_table(folder / info["data_path"].format(chunk_index=0, file_index=0))
    check("columns", set(data.column_names) == set(info["features"]))
    columns = {name: np.array(data[name].to_pylist()) for name in data.column_names}
    for name, feature in info["features"].items():
        values = columns[name].reshape(len(columns[name]), -1)
        check(f"shape of {name}", list(values.shape[1:]) == feature["shape"])
    rows = log.observation
    n = len(columns["index"])
    check("number of frames", n == info["total_frames"] == len(rows) - 1)
    inputs, outputs = len(log.inputs), len(log.outputs)
    check("states", np.array_equal(columns["observation.state"].astype("f4"), rows["inputs"][:-1, :inputs]))
    check("actions", np.array_equal(columns["action"].astype("f4"), rows["applied"][1:, :outputs]))
    drawn = log.command["drawn"][:-1, :outputs]
    check("the action is the command", np.array_equal(columns["action"].astype("f4"), drawn))
    check("rewards", np.array_equal(columns["next.reward"].astype("f4"), rows["reward"][1:]))
    check("index", np.array_equal(columns["index"], np.arange(n)))
    check("timestamps", np.allclose(columns["timestamp"], columns["frame_index"] / info["fps"], atol=1e-4))
    episodes = parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for row in episodes:
        begin, end = row["dataset_from_index"], row["dataset_to_index"]
        check("length", row["length"] == end - begin)
        check("episode", set(columns["episode_index"][begin:end]) == {row["episode_index"]})
        check("done", not columns["next.done"][begin : end - 1].any())
        check("mean", np.allclose(row["stats/action/mean"], columns["action"][begin:end].mean(axis=0)))
    # As LeRobot reads them: the texts are the index of a frame of pandas.
    tasks = pandas.read_parquet(folder / "meta/tasks.parquet")
    check("tasks", tasks["task_index"].tolist() == [0] and tasks.index[0] == episodes[0]["tasks"][0])
    check("episodes", len(episodes) == info["total_episodes"])
    check("table", parquet.read_table(table)["theta_1 (rad)"].to_pylist() == log.columns()["theta_1 (rad)"].tolist())
    print(json.dumps({"lengths": [row["length"] for row in episodes], "faults": faults}))


main(*sys.argv[1:])
