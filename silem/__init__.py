"""SILEM: imitation learning across bodies, after Hudson, Warnell, Torabi and Stone (2022).

Importing the package registers the Gymnasium ids ``silem/HC0-v0`` to ``silem/Atlas-v0``.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads only slow these small networks down

import silem.util.offscreen  # noqa: F401  before anything imports MuJoCo
from silem import bodies
from silem.algorithms import PPO, SILEM, TPIL, GAIfO, load_policy
from silem.envs import make_vec
from silem.motion.demonstrations import Demonstrations
from silem.study.config import RunConfig
from silem.study.evaluate import evaluate
from silem.study.record import RunRecord
from silem.study.runs import run
from silem.util.errors import SilemError

__all__ = [
    "PPO",
    "SILEM",
    "TPIL",
    "Demonstrations",
    "GAIfO",
    "RunConfig",
    "RunRecord",
    "SilemError",
    "bodies",
    "evaluate",
    "load_policy",
    "make_vec",
    "run",
]
__version__ = "0.1.0"
