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
def silence(descriptor: int) -> Iterator[None]:
    """Drop what goes to standard output (1) or error (2) meanwhile, even from PyBullet's C code."""
    (sys.stdout if descriptor == 1 else sys.stderr).flush()
    kept = os.dup(descriptor)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), descriptor)
        try:
            yield
        finally:
            os.dup2(kept, descriptor)
            os.close(kept)
