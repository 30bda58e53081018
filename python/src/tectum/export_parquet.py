"""Writes a channel of a run's log as a Parquet table, with the names and units of `tectum log csv`.

    python -m tectum.export_parquet RUN OUT [CHANNEL]

Needs pyarrow. The channel is observation, unless command, learning or gap is named.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from .errors import Refused
from .exporting import need_pyarrow, run_command
from .log import read_log


def export(run: str, out: str, channel: str = "observation") -> dict[str, Any]:
    """Writes the table into the new file `out`. Returns what was written."""
    pyarrow = need_pyarrow()
    file = Path(out)
    if file.exists():
        raise Refused(f"{file} exists already; give a file that does not")
    log = read_log(run)

    def column(values: np.ndarray) -> Any:
        return pyarrow.array(np.ascontiguousarray(values) if values.ndim == 1 else values.tolist())

    table = pyarrow.table({name: column(values) for name, values in log.columns(channel).items()})
    facts = {"tectum.run": json.dumps(log.facts)}
    draft = file.with_name(file.name + ".part")
    pyarrow.parquet.write_table(table.replace_schema_metadata(facts), draft)
    draft.rename(file)
    return {"file": str(file), "rows": table.num_rows, "columns": table.num_columns}


def main() -> int:
    """The command. Exit code 2 for bad input."""
    return run_command("python -m tectum.export_parquet RUN OUT [CHANNEL]", (2, 3), export)


if __name__ == "__main__":
    sys.exit(main())
