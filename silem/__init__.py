"""SILEM: imitation learning across bodies, after Hudson, Warnell, Torabi and Stone (2022).

Importing the package registers the Gymnasium ids ``silem/HC0-v0`` to ``silem/Atlas-v0``. What it
offers is loaded when it is first asked for (PEP 562): PyTorch and stable-baselines3 come with the
algorithms, the simulators with the environments.
"""

import os
import signal
import sys

# A program that is still loading, as argv says, dies of Ctrl-C without a word; `cli.main` says one.
if {os.path.basename(name) for name in sys.argv[:1]} & {"-m", "silem"}:
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)

import importlib
from typing import TYPE_CHECKING, Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # threads only slow these small networks down

import silem.util.offscreen  # noqa: F401  before anything imports MuJoCo
from silem import bodies, envs  # noqa: F401  environments' ids are registered by the bodies

if TYPE_CHECKING:
    from silem.algorithms import PPO, SILEM, TPIL, GAIfO, load_policy
    from silem.envs import make_vec
    from silem.motion.demonstrations import Demonstrations
    from silem.study.config import RunConfig
    from silem.study.evaluate import evaluate
    from silem.study.runs import RunRecord, run
    from silem.study.training import settings
    from silem.util.errors import SilemError

__all__ = [
    "PPO", "SILEM", "TPIL", "Demonstrations", "GAIfO", "RunConfig", "RunRecord", "SilemError",
    "bodies", "evaluate", "load_policy", "make_vec", "run", "settings",
]  # fmt: skip
__version__ = "0.1.0"

_HOMES = {
    "silem.algorithms": ("PPO", "SILEM", "TPIL", "GAIfO", "load_policy"),
    "silem.envs": ("make_vec",),
    "silem.motion.demonstrations": ("Demonstrations",),
    "silem.study.config": ("RunConfig",),
    "silem.study.evaluate": ("evaluate",),
    "silem.study.runs": ("RunRecord", "run"),
    "silem.study.training": ("settings",),
    "silem.util.errors": ("SilemError",),
}


def __getattr__(name: str) -> Any:
    for home, offered in _HOMES.items():
        if name in offered:
            return getattr(importlib.import_module(home), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


bodies.load_installed()
