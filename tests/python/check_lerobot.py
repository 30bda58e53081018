#!/usr/bin/env python3
"""Loads an exported dataset with LeRobot itself, and compares every frame with the data that pyarrow reads.

    check_lerobot.py SET

Prints as JSON the numbers of episodes and frames, the versions, what a batch of PyTorch's loader looks like, and all
faults found. Nothing is fetched: the folder is the whole dataset.
"""
import json
import os
import sys
from pathlib import Path

os.environ["HF_HUB_OFFLINE"] = "1"

import lerobot  # noqa: E402
import numpy as np  # noqa: E402
import pyarrow.parquet as parquet  # noqa: E402
import torch  # noqa: E402
from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: E402


def main(folder):
    faults = []

    def check(what, holds):
        if not holds:
            faults.append(what)

    dataset = LeRobotDataset("tectum/run", root=folder)
    table = parquet.read_table(Path(folder) / "data/chunk-000/file-000.parquet").to_pydict()
    info = json.loads((Path(folder) / "meta/info.json").read_text())
    check("number of frames", len(dataset) == dataset.num_frames == info["total_frames"] == len(table["index"]))
    check("number of episodes", dataset.num_episodes == info["total_episodes"])
    check("frames a second", dataset.fps == info["fps"])
    names = [name for name in info["features"] if name != "timestamp"]
    for i, frame in enumerate(dataset):
        for name in names:
            check(f"{name} of frame {i}", np.array_equal(np.asarray(frame[name]).ravel(), np.ravel(table[name][i])))
        check(f"task of frame {i}", frame["task"].startswith("tectum "))
        check(f"time of frame {i}", abs(float(frame["timestamp"]) - frame["frame_index"].item() / dataset.fps) < 1e-4)
    for name in ("observation.state", "action"):
        values = np.array(table[name])
        check(f"mean of {name}", np.allclose(dataset.meta.stats[name]["mean"], values.mean(axis=0), atol=1e-6))
    # What a policy is trained with: an observation before and eight actions from now on, in batches.
    period = 1 / dataset.fps
    deltas = {"observation.state": [-period, 0.0], "action": [i * period for i in range(8)]}
    windows = LeRobotDataset("tectum/run", root=folder, delta_timestamps=deltas)
    loader = torch.utils.data.DataLoader(windows, batch_size=32, shuffle=False)
    batch = next(iter(loader))
    check("actions of a window", np.allclose(batch["action"][3], np.array(table["action"][3:11]), atol=0))
    last = windows[dataset.meta.episodes[0]["dataset_to_index"] - 1]
    check("the end of an episode is padded", last["action_is_pad"].sum() == 7)
    second = LeRobotDataset("tectum/run", root=folder, episodes=[1])
    check("one episode", len(second) == dataset.meta.episodes[1]["length"])
    shapes = {name: list(batch[name].shape) for name in ("observation.state", "action")}
    versions = {"lerobot": lerobot.__version__, "torch": torch.__version__}
    found = {"episodes": dataset.num_episodes, "frames": len(dataset), "batch": shapes, **versions}
    print(json.dumps({**found, "faults": faults[:20]}))


main(*sys.argv[1:])
