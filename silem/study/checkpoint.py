"""Checkpoints: the state of a training at the start of a segment, in one safetensors file.

Training is cut into segments of ``budget.checkpoint_every`` iterations. At every segment's start,
interrupted or not, the environments are reset and all random streams restart from the run's seed
and the iteration. So a checkpoint needs neither random states nor episodes under way, and a
resumed run equals an uninterrupted one bit for bit.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from silem.study.curve import COLUMNS
from silem.util import files
from silem.util.errors import SilemError

CHECKPOINT = "checkpoint.safetensors"
PROGRESS = "progress.json"
_MODEL = "model/"


@dataclass(frozen=True)
class Checkpoint:
    """Everything a training goes on from.

    Attributes:
        run_id: The run it belongs to.
        iteration: Finished iterations.
        wall_time_s: Time spent so far, over all sessions.
        commits: The code's commits of the sessions so far.
        demonstrations_sha256: Hash of the demonstrations' file; "" where none are used.
        curve: Learning curve so far, (iteration, columns) with NaN for blank.
        model: The model's `state_arrays`.
    """

    run_id: str
    iteration: int
    wall_time_s: float
    commits: tuple[str, ...]
    demonstrations_sha256: str
    curve: np.ndarray
    model: dict[str, np.ndarray]

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
        metadata = {
            "run_id": self.run_id,
            "iteration": str(self.iteration),
            "wall_time_s": repr(self.wall_time_s),
            "commits": json.dumps(self.commits),
            "demonstrations_sha256": self.demonstrations_sha256,
        }
        files.write_tensors(path, arrays | {"curve": self.curve}, metadata)

    @classmethod
    def load(cls, path: Path, run_id: str, demonstrations_sha256: str) -> Checkpoint:
        """Read a checkpoint of a given run.

        Raises:
            SilemError: The file is damaged, another run's, or was made with other demonstrations.
                Nothing is deleted.
        """
        advice = "move it away, or run with --force, to start this run anew"
        try:
            arrays, metadata = files.read_tensors(path)
            found = cls(
                metadata["run_id"],
                int(metadata["iteration"]),
                float(metadata["wall_time_s"]),
                tuple(json.loads(metadata["commits"])),
                metadata["demonstrations_sha256"],
                arrays.pop("curve"),
                {name.removeprefix(_MODEL): array for name, array in arrays.items()},
            )
        except (SilemError, KeyError, ValueError) as error:
            raise SilemError(f"damaged checkpoint: {error}; {advice}") from error
        if found.curve.ndim != 2 or found.curve.shape[1] != len(COLUMNS):
            raise SilemError(f"{path} is of an older version: its curve is another; {advice}")
        if found.run_id != run_id:
            raise SilemError(f"{path} is a checkpoint of {found.run_id}, not {run_id}; {advice}")
        if found.demonstrations_sha256 != demonstrations_sha256:
            raise SilemError(
                f"{path} was made with other demonstrations than those there now; bring those"
                f" back, or {advice}"
            )
        return found
