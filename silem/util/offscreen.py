"""How simulators are imported: with what MuJoCo draws without a display, and without greetings."""

import ctypes.util
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}

_HERE = [] if sys.platform == "linux" else ["glfw"]  # which is everywhere else
_HERE += [name for name, library in _LIBRARIES.items() if ctypes.util.find_library(library)]

BACKEND = os.environ.setdefault("MUJOCO_GL", _HERE[0] if _HERE else "disable")
"""``MUJOCO_GL`` where it is set, else on Linux "egl" or "osmesa", whichever library is here, or
"disable" where neither is: physics works then, pictures do not. MuJoCo must not be imported yet."""


@contextmanager
def silence() -> Iterator[None]:
    """Drop what is written to standard error meanwhile, even by C code: PyBullet greets so."""
    kept = os.dup(2)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
