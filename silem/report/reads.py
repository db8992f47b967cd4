"""What a notebook's pages were made from, so that it runs again only when that has changed.

Beside an executed notebook lies ``<name>.reads.json``: a hash of the notebook, its parameters and
the pinned environment, and one of every file of this project that its processes read and every
folder that they listed. ``watch/sitecustomize.py`` notes them while the notebook runs.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from silem.util import files
from silem.util.paths import REPO, data_dir

_WATCH = Path(__file__).with_name("watch")
_PASSING = {"_build", ".git", ".venv", "__pycache__", "runs"}  # what is made on the way


def watching(folder: Path) -> dict[str, str]:
    """Return the environment variables that let processes note their reads in a folder."""
    path = os.pathsep.join(filter(None, [str(_WATCH), os.environ.get("PYTHONPATH")]))
    return {"SILEM_READS": str(folder), "PYTHONPATH": path}


def keep(notebook: Path, executed: Path, parameters: Mapping[str, Any], noted: Path) -> None:
    """Write down what a notebook read: what its processes noted in a folder."""
    paths = {Path(path) for file in noted.glob("*.txt") for path in file.read_text().splitlines()}
    mine = {path for path in paths if _is_ours(path)}
    results = [data_dir() / "results"]
    mine |= {path.parents[1] for path in mine if list(path.parents[2:3]) == results}
    reads = {str(path): _digest(path) for path in sorted(mine)}
    content = {"key": _key(notebook, parameters), "reads": reads}
    files.write_json(_beside(executed), content)


def is_fresh(notebook: Path, executed: Path, parameters: Mapping[str, Any]) -> bool:
    """Tell whether an executed notebook is what executing it again would give."""
    if not executed.exists() or not _beside(executed).exists():
        return False
    found = files.read_json(_beside(executed))
    same = (_digest(Path(path)) == digest for path, digest in found["reads"].items())
    return bool(found["key"] == _key(notebook, parameters) and found["reads"] and all(same))


def _beside(executed: Path) -> Path:
    return executed.with_suffix(".reads.json")


def _is_ours(path: Path) -> bool:
    """Tell whether what was read is of this project; of folders only those of data matter.

    Python lists folders to find modules, and those that are found are noted as files.
    """
    for root in (data_dir(), REPO):
        if path.is_relative_to(root):
            known = root == data_dir() or not path.is_dir()
            return known and not _PASSING & set(path.relative_to(root).parts)
    return False


def _key(notebook: Path, parameters: Mapping[str, Any]) -> str:
    parts = notebook.read_bytes(), (REPO / "environment.txt").read_bytes()
    text = json.dumps([hashlib.sha256(part).hexdigest() for part in parts] + [dict(parameters)])
    return hashlib.sha256(text.encode()).hexdigest()


def _digest(path: Path) -> str:
    """Return a hash of a file or of the names in a folder; "" where there is neither."""
    if path.is_dir():
        names = sorted(entry.name for entry in path.iterdir() if entry.name not in _PASSING)
        return hashlib.sha256("\n".join(names).encode()).hexdigest()
    return files.sha256(path) if path.is_file() else ""
