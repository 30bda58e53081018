"""Writes a run's log as a LeRobotDataset of version 3, so that the run becomes training data.

    python -m tectum.export_lerobot RUN OUT

Needs pyarrow (`pip install 'tectum[lerobot]'`). A frame is a tick: `observation.state` are the inputs, `action` is the
command that was applied, `next.reward` the reward that followed, and `next.done` says that the episode ended with it.
An episode ends where a new target appears, and where the plant says that one ends. The last tick of a log has no frame,
because its reward is not known.
"""

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

from .errors import Refused
from .exporting import need_pyarrow, run_command
from .layouts import Flag
from .log import Log, read_log

VERSION = "v3.0"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
ENDS = int(Flag.NEW_TARGET) | int(Flag.TERMINATED) | int(Flag.TRUNCATED)
Columns = dict[str, np.ndarray]


def frames(log: Log) -> Columns:
    """The columns of the data, one row a frame."""
    rows = log.observation
    # The observation after a tick tells what was applied in it and what followed.
    known = np.flatnonzero(rows["tick"][1:] == rows["tick"][:-1] + 1)
    if len(known) == 0:
        raise Refused(f"{log.path} holds no two ticks in a row; run the scenario with `every = 1` under [log]")
    now, after = rows[known], rows[known + 1]
    done = (after["flags"] & ENDS) != 0
    # Where ticks are missing, another episode begins.
    begins = np.concatenate([[True], done[:-1] | (now["tick"][1:] != now["tick"][:-1] + 1)])
    episode = np.cumsum(begins) - 1
    first = np.flatnonzero(begins)
    index = np.arange(len(now))
    frame = index - first[episode]
    return {
        "observation.state": now["inputs"][:, : len(log.inputs)].astype(np.float32),
        "action": after["applied"][:, : len(log.outputs)].astype(np.float32),
        "next.reward": after["reward"].astype(np.float32),
        "next.done": done,
        "timestamp": (frame * log.period).astype(np.float32),
        "frame_index": frame.astype(np.int64),
        "episode_index": episode.astype(np.int64),
        "index": index.astype(np.int64),
        "task_index": np.zeros(len(now), dtype=np.int64),
    }


def features(log: Log, columns: Columns) -> dict[str, Any]:
    """`features` of info.json."""
    names = {"observation.state": log.inputs, "action": log.outputs}
    return {
        name: {
            "dtype": str(values.dtype),
            "shape": [values.shape[1] if values.ndim > 1 else 1],
            "names": names.get(name),
        }
        for name, values in columns.items()
    }


def statistics(values: np.ndarray) -> dict[str, list[Any]]:
    """What LeRobot normalises with, over the rows of a column."""
    numbers = values.reshape(len(values), -1).astype(np.float64)
    found = {"min": numbers.min(axis=0), "max": numbers.max(axis=0), "mean": numbers.mean(axis=0)}
    found |= {"std": numbers.std(axis=0), "count": np.array([len(numbers)])}
    return {name: list(value.tolist()) for name, value in found.items()}


def episodes(columns: Columns, task: str) -> list[dict[str, Any]]:
    """The rows of the table of episodes."""
    begins = np.flatnonzero(columns["frame_index"] == 0)
    ends = np.append(begins[1:], len(columns["index"]))
    rows = []
    for number, (begin, end) in enumerate(zip(begins.tolist(), ends.tolist(), strict=True)):
        row: dict[str, Any] = {"episode_index": number, "tasks": [task], "length": end - begin}
        row |= {"data/chunk_index": 0, "data/file_index": 0, "dataset_from_index": begin, "dataset_to_index": end}
        row |= {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
        for name, values in columns.items():
            row |= {f"stats/{name}/{key}": value for key, value in statistics(values[begin:end]).items()}
        rows.append(row)
    return rows


def export(run: str, out: str) -> dict[str, Any]:
    """Writes the dataset of the log of `run` into the new folder `out`. Returns what was written."""
    pyarrow = need_pyarrow()
    folder = Path(out)
    if folder.exists():
        raise Refused(f"{folder} exists already; give a folder that does not")
    log = read_log(run)
    columns = frames(log)
    task = f"tectum {log.facts.get('name', 'run')}"
    rows = episodes(columns, task)
    draft = folder.with_name(folder.name + ".part")
    shutil.rmtree(draft, ignore_errors=True)

    def write(path: str, table: Any) -> None:
        file = draft / path
        file.parent.mkdir(parents=True, exist_ok=True)
        pyarrow.parquet.write_table(table, file)

    def array(values: np.ndarray) -> Any:
        if values.ndim == 1:
            return pyarrow.array(values)
        return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(values.ravel()), values.shape[1])

    write(DATA.format(chunk_index=0, file_index=0), pyarrow.table({n: array(v) for n, v in columns.items()}))
    write(EPISODES, pyarrow.Table.from_pylist(rows))
    # LeRobot reads the tasks with pandas, and takes their texts from its index.
    kinds = (("task_index", "task_index", "int64", "int64"), (None, "__index_level_0__", "unicode", "object"))
    keys = ("name", "field_name", "pandas_type", "numpy_type")
    described = [{**dict(zip(keys, kind, strict=True)), "metadata": None} for kind in kinds]
    index: dict[str, Any] = {"index_columns": ["__index_level_0__"], "columns": described, "column_indexes": []}
    index["pandas_version"] = "2.0.0"
    tasks = pyarrow.table({"task_index": pyarrow.array([0]), "__index_level_0__": pyarrow.array([task])})
    write("meta/tasks.parquet", tasks.replace_schema_metadata({"pandas": json.dumps(index)}))
    info = {
        "codebase_version": VERSION,
        "robot_type": "tectum",
        "total_episodes": len(rows),
        "total_frames": len(columns["index"]),
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 500,
        "fps": max(1, round(1 / log.period)) if log.period > 0 else 1,
        "splits": {"train": f"0:{len(rows)}"},
        "data_path": DATA,
        "video_path": None,
        "features": features(log, columns),
    }
    (draft / "meta/info.json").write_text(json.dumps(info, indent=4) + "\n")
    stats = {name: statistics(values) for name, values in columns.items()}
    (draft / "meta/stats.json").write_text(json.dumps(stats, indent=4) + "\n")
    draft.rename(folder)
    return {"folder": str(folder), "episodes": len(rows), "frames": len(columns["index"])}


def main() -> int:
    """The command. Exit code 2 for bad input."""
    return run_command("python -m tectum.export_lerobot RUN OUT", (2,), export)


if __name__ == "__main__":
    sys.exit(main())
