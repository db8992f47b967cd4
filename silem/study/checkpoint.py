"""Checkpoints: the state of a training at the start of a segment, in one safetensors file.

Training is cut into segments of ``budget.checkpoint_every`` iterations. At every segment's start,
interrupted or not, the environments are reset and all random streams restart from the run's seed
and the iteration. So a checkpoint needs neither random states nor episodes under way, and a
resumed run equals an uninterrupted one bit for bit.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from silem.study.config import RunConfig
from silem.study.record import CURVE_COLUMNS
from silem.util import files
from silem.util.errors import SilemError, reason

CHECKPOINT, PROGRESS = "checkpoint.safetensors", "progress.json"
_MODEL, _CURVE, _SHA256 = "model/", "curve", "sha256"


@dataclass(frozen=True)
class Checkpoint:
    """Everything a training goes on from."""

    run_id: str
    iteration: int  # finished
    wall_time_s: float  # over all sessions, as what follows
    processor_time_s: float | None  # None where an earlier session did not count
    commits: tuple[str, ...]  # of the code
    demonstrations_sha256: str  # of their file; "" where none are used
    curve: np.ndarray  # (iteration, columns), NaN for blank
    model: dict[str, np.ndarray]  # its `state_arrays`

    @classmethod
    def start(cls, config: RunConfig, demonstrations_sha256: str) -> Checkpoint:
        """Return what a run starts from that has not begun."""
        no_curve = np.empty((0, len(CURVE_COLUMNS)))
        return cls(config.run_id, 0, 0.0, 0.0, (), demonstrations_sha256, no_curve, {})

    def save(self, path: Path) -> None:
        """Write the checkpoint atomically; a crash leaves the one before.

        Raises:
            SilemError: The file cannot be written, or the training has diverged (the checkpoint
                before is kept).
        """
        for name, array in self.model.items():
            if not np.isfinite(array).all():
                raise SilemError(
                    f"{self.run_id} diverged before iteration {self.iteration}: {name} holds NaN"
                    " or infinity; the checkpoint before is kept"
                )
        arrays = {_MODEL + name: array for name, array in self.model.items()}
        arrays[_CURVE] = self.curve
        metadata = {
            "run_id": self.run_id,
            "iteration": str(self.iteration),
            "wall_time_s": repr(self.wall_time_s),
            "processor_time_s": json.dumps(self.processor_time_s),
            "commits": json.dumps(self.commits),
            "demonstrations_sha256": self.demonstrations_sha256,
        }
        metadata[_SHA256] = _digest(arrays, metadata)
        files.write_tensors(path, arrays, metadata)

    @classmethod
    def load(cls, path: Path, config: RunConfig, demonstrations_sha256: str) -> Checkpoint:
        """Read a checkpoint of a given run.

        Raises:
            SilemError: The file is damaged, another run's, was made with other demonstrations, or
                says what no checkpoint of this run can say. Nothing is deleted.
        """
        advice = "move it away, or run with --force, to start this run anew"
        try:
            arrays, metadata = files.read_tensors(path)
            # the version before wrote neither a checksum nor processor time
            if _SHA256 in metadata and metadata.pop(_SHA256) != _digest(arrays, metadata):
                raise SilemError(f"the checksum of {path} differs")
            found = cls(
                metadata.pop("run_id"),
                int(metadata.pop("iteration")),
                float(metadata.pop("wall_time_s")),
                json.loads(metadata.pop("processor_time_s", "null")),
                tuple(json.loads(metadata.pop("commits"))),
                metadata.pop("demonstrations_sha256"),
                arrays.pop(_CURVE),
                {name.removeprefix(_MODEL): array for name, array in arrays.items()},
            )
            if metadata:
                raise SilemError(f"{path} holds unknown {', '.join(metadata)}")
        except (KeyError, TypeError, ValueError) as error:
            raise SilemError(f"damaged checkpoint: {reason(error)}; {advice}") from error
        if found.curve.ndim != 2 or found.curve.shape[1] != len(CURVE_COLUMNS):
            raise SilemError(f"{path} is of an older version: its curve is another; {advice}")
        if found.run_id != config.run_id:
            wrong = f"{path} is a checkpoint of {found.run_id}, not {config.run_id}"
        elif found.demonstrations_sha256 != demonstrations_sha256:
            wrong = f"{path} was made with other demonstrations (bring those back)"
        elif wrong := found._implausible(config):
            wrong = f"damaged checkpoint: {path} {wrong}"
        if wrong:
            raise SilemError(f"{wrong}; {advice}")
        return found

    def _implausible(self, config: RunConfig) -> str:
        """Return what no checkpoint of a run can say, or ""."""
        last, budget = self.iteration, config.budget
        if not 0 < last <= budget.n_iterations or (
            last % budget.checkpoint_every and last != budget.n_iterations
        ):
            return f"is of iteration {last}, at which none is written"
        iterations = np.arange(1, last + 1)
        counted = np.stack([iterations, iterations * budget.steps_per_iteration], axis=1)
        if not np.array_equal(self.curve[:, :2], counted):
            return f"has no curve of {last} iterations"
        for seconds in (self.wall_time_s, self.processor_time_s or 0.0):
            if not isinstance(seconds, float) or not 0 <= seconds < math.inf:
                return f"has taken {seconds!r} s"
        if not all(isinstance(commit, str) for commit in self.commits):
            return "names commits that are no text"
        return ""


class Stopwatch:
    """Wall and processor time that a run takes, over all sessions."""

    def __init__(self, start: Checkpoint) -> None:
        self._start, self._began = start, (time.perf_counter(), time.process_time())

    def __call__(self) -> dict[str, Any]:
        """Return it in seconds; of the processor None where an earlier session did not count it."""
        before = self._start.processor_time_s
        processor_s = time.process_time() - self._began[1]
        return {
            "wall_time_s": self._start.wall_time_s + time.perf_counter() - self._began[0],
            "processor_time_s": None if before is None else before + processor_s,
        }


def _digest(arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> str:
    """Return a SHA-256 of all that a checkpoint holds."""
    about = {name: [array.dtype.str, array.shape] for name, array in arrays.items()}
    digest = hashlib.sha256(json.dumps([about, dict(metadata)], sort_keys=True).encode())
    for name in sorted(arrays):
        digest.update(np.asarray(arrays[name], order="C").tobytes())
    return digest.hexdigest()
