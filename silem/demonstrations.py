"""State-only demonstrations tau_E: skeletal features of an expert's episodes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from silem import files, paths
from silem.errors import SilemError

MANIFEST = "manifest.json"


@dataclass(frozen=True)
class Demonstrations:
    """An expert's trajectories; no actions.

    Attributes:
        features: One (T + 1, F) float32 array of skeletal features per trajectory.
        returns: The expert's return per trajectory, or an empty tuple where it is unknown.
        body: The expert's body.
        expert_run_id: The run whose policy was rolled out, "" where there is none.
    """

    features: tuple[np.ndarray, ...]
    returns: tuple[float, ...] = ()
    body: str = ""
    expert_run_id: str = ""

    def __post_init__(self) -> None:
        if not self.features:
            raise SilemError("demonstrations are empty; at least one trajectory is needed")
        widths = {array.shape[1:] for array in self.features}
        if len(widths) != 1 or len(next(iter(widths))) != 1:
            raise SilemError(f"trajectories must all be (T + 1, F) with one F, got {widths}")
        for i, array in enumerate(self.features):
            if len(array) < 2:
                raise SilemError(
                    f"trajectory {i} has {len(array)} state(s), too short for a window: "
                    "a window needs a transition, so at least 2 states"
                )
            if not np.isfinite(array).all():
                raise SilemError(f"trajectory {i} holds NaN or infinity")

    @property
    def n_features(self) -> int:
        """F, the number of skeletal features per state."""
        return int(self.features[0].shape[1])

    def first(self, n: int) -> Demonstrations:
        """Return the first ``n`` trajectories; raises SilemError if there are fewer."""
        if not 1 <= n <= len(self.features):
            raise SilemError(f"asked for {n} trajectories, allowed: 1 to {len(self.features)}")
        return Demonstrations(self.features[:n], self.returns[:n], self.body, self.expert_run_id)

    def save(self, path: Path | str) -> None:
        """Write one npz file (no pickle), whole or not at all."""
        lengths = np.array([len(array) for array in self.features], dtype=np.int64)
        files.write_npz(
            Path(path),
            {
                "features": np.concatenate(self.features),
                "lengths": lengths,
                "returns": np.array(self.returns, dtype=np.float64),
                "body": np.array(self.body),
                "expert_run_id": np.array(self.expert_run_id),
            },
        )

    @classmethod
    def from_arrays(cls, arrays: Iterable[np.ndarray]) -> Demonstrations:
        """Wrap (T + 1, F) arrays, checked as a file's are."""
        return cls(tuple(np.asarray(array, dtype=np.float32) for array in arrays))

    @classmethod
    def load(cls, source: Path | str) -> Demonstrations:
        """Read demonstrations by expert body ("HC0") or from a file.

        Raises:
            SilemError: If there is no such file, or it is truncated, pickled, not a
                demonstrations file, or holds NaN.
        """
        path = file_of(source) if isinstance(source, str) and "/" not in source else Path(source)
        arrays = files.read_npz(path)
        missing = {"features", "lengths", "returns", "body", "expert_run_id"} - arrays.keys()
        if missing:
            raise SilemError(f"{path.name} is no demonstrations file: it lacks {sorted(missing)}")
        lengths = arrays["lengths"]
        if lengths.sum() != len(arrays["features"]):
            raise SilemError(f"{path.name} is damaged: trajectory lengths do not add up")
        parts = np.split(arrays["features"].astype(np.float32), np.cumsum(lengths)[:-1])
        returns = tuple(float(value) for value in arrays["returns"])
        return cls(tuple(parts), returns, str(arrays["body"]), str(arrays["expert_run_id"]))


def file_of(name: str) -> Path:
    """Return where the demonstrations of expert body ``name`` lie (or would lie)."""
    return paths.demonstrations_dir() / (name if name.endswith(".npz") else f"{name}.npz")


def publish(name: str, demonstrations: Demonstrations) -> Path:
    """Save demonstrations under the data folder and enter them in its manifest."""
    path = file_of(name)
    demonstrations.save(path)
    manifest_path = path.parent / MANIFEST
    manifest = files.read_json(manifest_path) if manifest_path.exists() else {}
    manifest[name] = {
        "body": demonstrations.body,
        "expert_run_id": demonstrations.expert_run_id,
        "n_trajectories": len(demonstrations.features),
        "n_features": demonstrations.n_features,
        "return_mean": float(np.mean(demonstrations.returns)),
        "return_std": float(np.std(demonstrations.returns)),
        "sha256": files.sha256(path),
    }
    files.write_json(manifest_path, dict(sorted(manifest.items())))
    return path
