"""What a finished run leaves: its record, where its code came from, and its learning curve."""

import dataclasses
import importlib.metadata
import os
import platform
import re
import subprocess
import warnings
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from silem.study.config import RunConfig
from silem.util import files, paths
from silem.util.errors import SilemError, choose

RECORD = "record.json"
CURVE, POLICY, TRANSFORM = "curve.csv", "policy.safetensors", "transform.npz"
CHECKPOINT, PROGRESS = "checkpoint.safetensors", "progress.json"  # of an unfinished run
_LATER = {"processor_time_s"}  # older records are without
PACKAGES = tuple("dm-control gymnasium mujoco numpy pybullet stable-baselines3 torch".split())

CURVE_COLUMNS = (
    "iteration", "timesteps", "return_mean", "speed_m_s", "disc_reward", "disc_loss",
    "disc_acc_expert", "disc_acc_learner", "transform_loss", "policy_std", "episode_length",
    "domain_acc",
)  # fmt: skip
"""Of a learning curve, which has one row per iteration."""
ALWAYS = 10  # so many first columns stand in every published curve, a later one if it has numbers
MAX_ROWS = 200  # of a published curve


@dataclass(frozen=True, repr=False)
class RunRecord:
    """A finished run, as ``record.json`` holds it."""

    run_id: str  #: its name, which ends in a hash of its configuration
    status: str  #: ``"finished"``
    config: dict[str, Any]  #: `RunConfig.to_dict`
    evaluation: dict[str, Any]  #: a `silem.study.evaluate.Evaluation`
    training: dict[str, Any]  #: ``n_steps``, ``steps_per_s``, ``disc_reward_last`` of an episode
    provenance: dict[str, Any]  #: of the last session, and ``earlier_commits`` of those before
    demonstrations_sha256: str | None  #: of their file; None where none were used
    wall_time_s: float  #: of training and evaluation, over all sessions
    files: dict[str, str]  #: SHA-256 of every file beside the record, by name
    folder: Path = dataclasses.field(compare=False)  #: where it lies; no part of its content
    processor_time_s: float | None = None  #: None in records of before it was counted

    def __repr__(self) -> str:
        result = self.evaluation
        told = f"return {result['return_mean']:.0f} over {result['n_episodes']} episodes"
        return f"<RunRecord {self.run_id}: {told}>"

    @classmethod
    def load(cls, path: Path) -> "RunRecord":
        """Read ``record.json``, or the one in a folder; raises SilemError if it is no record."""
        path = path / RECORD if path.is_dir() else path
        content = files.read_json(path)
        names = {field.name for field in dataclasses.fields(cls)} - {"folder"}
        if not isinstance(content, dict) or names - set(content) - _LATER or set(content) - names:
            needed = ", ".join(sorted(names - _LATER))
            raise SilemError(f"{path} is no run record (it needs the keys {needed})")
        for name in ("config", "evaluation", "training", "provenance", "files"):
            if not isinstance(content[name], dict):
                raise SilemError(f"{path} is no run record: its {name} is no mapping")
        return cls(**content, folder=path.parent)

    def save(self, folder: Path) -> None:
        """Write ``record.json`` into a folder."""
        content = dataclasses.asdict(self)
        del content["folder"]
        content = {k: v for k, v in content.items() if v is not None or k not in _LATER}
        files.write_json(folder / RECORD, content)

    @cached_property
    def _checked(self) -> RunConfig:
        return RunConfig.from_dict(self.config)

    def run_config(self) -> RunConfig:
        """Return the configuration, checked when it is first asked for."""
        return self._checked

    def file(self, name: str) -> Path:
        """Return one of the record's files; raises SilemError if it is not the recorded one."""
        path = self.folder / choose(f"file of run {self.run_id}", name, self.files)
        if files.sha256(path) != self.files[name]:
            raise SilemError(f"{path} is not the file that its record describes (SHA-256 differs)")
        return path


def provenance() -> dict[str, Any]:
    """Return what the code runs on: commit, pinned environment, package versions, machine.

    ``git_dirty`` tells whether the package's own code differs from the commit; both are None where
    there is no git. Processor and ``kernels`` of the libraries move a run's last bits.
    """
    status = git("status", "--porcelain", "--untracked-files=no", "--", "silem", "environment.txt")
    root = paths.checkout()
    processor = platform.processor() or platform.machine()
    with suppress(OSError):
        found = re.search(r"^model name\s*:\s*(.*)$", Path("/proc/cpuinfo").read_text(), re.M)
        processor = found[1] if found else processor
    return {
        "git_commit": git("rev-parse", "HEAD"),
        "git_dirty": None if status is None else bool(status),
        "environment_sha256": files.sha256(root / "environment.txt") if root else None,
        "packages": {name: importlib.metadata.version(name) for name in PACKAGES},
        "python": platform.python_version(),
        "machine": {"processor": processor, "cores": os.cpu_count(), "kernels": _kernels()},
    }


def _kernels() -> dict[str, str | None]:
    import torch  # reading a record does not need it

    numpy = np.show_config("dicts")
    blas = str(numpy["Build Dependencies"]["blas"].get("openblas configuration"))
    with suppress(ImportError):  # tells what OpenBLAS chose, not what it was built for
        import threadpoolctl

        chosen = {pool.get("architecture") for pool in threadpoolctl.threadpool_info()} - {None}
        blas = ", ".join(sorted(chosen)) or blas
    return {
        "blas": blas,
        "numpy": ", ".join(numpy["SIMD Extensions"].get("found", [])),
        "torch": torch.backends.cpu.get_cpu_capability(),
        "mkl_cbwr": os.environ.get("MKL_CBWR"),
    }


def git(*arguments: str) -> str | None:
    """Return what git says about this repository; None where there is no git or no repository."""
    root = paths.checkout()
    # An installed package may lie inside somebody else's repository.
    if root is None or not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), *arguments]
    try:
        return subprocess.run(command, capture_output=True, check=True, text=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def curve_row(iteration: int, timesteps: int, stats: dict[str, float]) -> np.ndarray:
    """Return one iteration's row, NaN where the iteration has no such number."""
    values = {"iteration": iteration, "timesteps": timesteps} | stats
    return np.array([values.get(column, np.nan) for column in CURVE_COLUMNS], dtype=np.float64)


def thinned(curve: np.ndarray) -> np.ndarray:
    """Average a curve, (iterations, columns), over blocks until at most `MAX_ROWS` rows are left.

    Each is the mean over what is not NaN, at the block's last iteration. Averages rather than
    every k-th row, because most iterations see no episode end.
    """
    size = max(1, -(-len(curve) // MAX_ROWS))
    blocks = [curve[start : start + size] for start in range(0, len(curve), size)]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Mean of empty slice", RuntimeWarning)
        rows = [np.concatenate([b[-1, :2], np.nanmean(b[:, 2:], axis=0)]) for b in blocks]
    return np.array(rows).reshape(-1, len(CURVE_COLUMNS))


def curve_csv(curve: np.ndarray) -> str:
    """Return a curve, thinned, as CSV text: 5 significant digits, blank for NaN."""
    rows = thinned(curve)
    used = [i for i in range(len(CURVE_COLUMNS)) if i < ALWAYS or not np.isnan(rows[:, i]).all()]
    lines = [[CURVE_COLUMNS[i] for i in used]]
    for values in rows[:, used]:
        numbers = ["" if np.isnan(value) else f"{value:.5g}" for value in values[2:]]
        lines.append([*(str(int(value)) for value in values[:2]), *numbers])
    return "".join(",".join(line) + "\n" for line in lines)
