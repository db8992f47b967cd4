"""Which OpenGL MuJoCo draws with where there is no display; imported before MuJoCo is."""

import ctypes.util
import os
import sys

_LIBRARIES = {"egl": "EGL", "osmesa": "OSMesa"}

_HERE = [] if sys.platform == "linux" else ["glfw"]  # which is everywhere else
_HERE += [name for name, library in _LIBRARIES.items() if ctypes.util.find_library(library)]

BACKEND = os.environ.setdefault("MUJOCO_GL", _HERE[0] if _HERE else "disable")
"""``MUJOCO_GL`` where it is set, else on Linux "egl" or "osmesa", whichever library is here, or
"disable" where neither is: physics works then, pictures do not."""
