"""Every folder of the project, named once; whoever writes a file creates its folder.

``SILEM_DATA_DIR`` moves the folders that the program writes to. Without it they are ``data/`` in a
checkout, or ``silem-data/`` in the working folder of whoever installed the package. What is part of
the package never moves.
"""

import os
from pathlib import Path

from silem.util.errors import SilemError, check_name

PACKAGE = Path(__file__).resolve().parent.parent

REPO: Path
"""The root of the checkout that the package lies in. Where it was installed from a wheel there is
none, and asking for it raises SilemError; `checkout` returns None instead."""


def checkout() -> Path | None:
    """Return the root of the checkout that the package lies in, or None if it was installed."""
    return PACKAGE.parent if (PACKAGE.parent / "pyproject.toml").is_file() else None


def __getattr__(name: str) -> Path:
    if name != "REPO":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if (root := checkout()) is None:
        raise SilemError("the book and its figures need a checkout of the project, not a wheel")
    return root


def data_dir() -> Path:
    """Return the data folder: ``$SILEM_DATA_DIR``, a checkout's ``data/``, or ``./silem-data``."""
    if moved := os.environ.get("SILEM_DATA_DIR"):
        try:
            return Path(moved).expanduser().resolve()
        except RuntimeError as error:
            raise SilemError(f"SILEM_DATA_DIR is {moved!r}: {error}") from error
    root = checkout()
    return root / "data" if root else Path.cwd() / "silem-data"


def results_dir(study: str) -> Path:
    """Return the folder of a study's committed records; raises as `check_name`."""
    return data_dir() / "results" / check_name("study", study)


def runs_dir() -> Path:
    """Return the folder of the runs' working files: checkpoints, progress, logs (not committed)."""
    return data_dir() / "runs"


def demonstrations_dir() -> Path:
    """Return the folder of the experts' recorded demonstrations."""
    return data_dir() / "demonstrations"


def clips_dir() -> Path:
    """Return the folder of the human's clips that come with the project."""
    root = checkout()
    return root / "data" / "demonstrations" if root else PACKAGE / "clips"
