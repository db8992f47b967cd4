"""Python imports this by itself where its folder is on the path: it notes which files are read.

The process writes each path that it opens for reading or lists, and the source of each module that
it loads, as a line into a file of its own in the folder that ``SILEM_READS`` names; at once, since
a notebook's kernel may be killed at its end.
"""

import os
import sys
from typing import Any

_seen: set[str] = set()


def _source(path: str) -> str:
    """Return the module that a file of bytecode was compiled from, and any other path as it is."""
    folder, name = os.path.split(os.path.abspath(path))
    if os.path.basename(folder) != "__pycache__":
        return os.path.join(folder, name)
    return os.path.join(os.path.dirname(folder), name.partition(".")[0] + ".py")


def _note(event: str, arguments: tuple[Any, ...]) -> None:
    if event not in ("open", "os.listdir", "os.scandir") or not arguments:
        return
    path, mode = arguments[0], arguments[1] if event == "open" else "r"
    if isinstance(path, str) and not set(mode or "r") & set("wax+") and path not in _seen:
        _seen.add(path)
        os.write(_notes, f"{_source(path)}\n".encode())


if _folder := os.environ.get("SILEM_READS"):
    _flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
    _notes = os.open(os.path.join(_folder, f"{os.getpid()}.txt"), _flags)
    sys.addaudithook(_note)
