"""Every folder of the project, named once.

``SILEM_DATA_DIR`` moves the folders that the program writes to; the paper's own tables are source
and never move. The functions only name folders; whoever writes a file creates its folder.
"""

from __future__ import annotations

import os
from pathlib import Path

from silem.util.errors import check_name

REPO = Path(__file__).resolve().parent.parent.parent
"""The repository's root (the folder that holds ``silem/``)."""


def data_dir() -> Path:
    """Return the data folder: ``$SILEM_DATA_DIR`` if set, else ``data/`` in the repository."""
    moved = os.environ.get("SILEM_DATA_DIR")
    return Path(moved).expanduser().resolve() if moved else REPO / "data"


def results_dir(study: str) -> Path:
    """Return the folder of a study's published (committed) records; raises as `check_name`."""
    return data_dir() / "results" / check_name("study", study)


def runs_dir() -> Path:
    """Return the folder of the runs' working files: checkpoints, progress, logs (not committed)."""
    return data_dir() / "runs"


def demonstrations_dir() -> Path:
    """Return the folder of the experts' recorded demonstrations."""
    return data_dir() / "demonstrations"
