"""Python imports this by itself where its folder is on the path: it notes which files are read.

At its end the process writes the paths that it opened for reading or listed, and those of its
modules, into a file of its own in the folder that ``SILEM_READS`` names.
"""

import atexit
import json
import os
import sys
from typing import Any

_seen: set[str] = set()


def _note(event: str, arguments: tuple[Any, ...]) -> None:
    if event not in ("open", "os.listdir", "os.scandir") or not arguments:
        return
    path, mode = arguments[0], arguments[1] if event == "open" else "r"
    if isinstance(path, str) and not set(mode or "r") & set("wax+"):
        _seen.add(os.path.abspath(path))


def _write(folder: str) -> None:
    modules = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    found = sorted(_seen | {os.path.abspath(path) for path in modules if path})
    with open(os.path.join(folder, f"{os.getpid()}.json"), "w") as file:
        json.dump(found, file)


if _folder := os.environ.get("SILEM_READS"):
    sys.addaudithook(_note)
    atexit.register(_write, _folder)
