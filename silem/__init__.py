"""SILEM: imitation learning across bodies, after Hudson, Warnell, Torabi and Stone (2022)."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads only slow these small networks down

from silem.demonstrations import Demonstrations
from silem.envs import make_vec
from silem.errors import SilemError
from silem.imitation import SILEM
from silem.learning import PPO

__all__ = ["PPO", "SILEM", "Demonstrations", "SilemError", "make_vec"]
__version__ = "0.1.0"
