"""State-only demonstrations tau_E: skeletal features of an expert's episodes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from silem.util import files, paths
from silem.util.errors import SilemError, choose

MANIFEST = "manifest.json"
_WAIT_S = 600.0
_OWN = ("features", "lengths", "returns", "body", "expert_run_id")  # arrays of every file


@dataclass(frozen=True)
class Demonstrations:
    """An expert's trajectories; no actions.

    Attributes:
        features: One (T + 1, F) float32 array of skeletal features per trajectory.
        returns: The expert's return per trajectory, or an empty tuple where it is unknown.
        body: The expert's body.
        expert_run_id: The run whose policy was rolled out, "" where there is none.
        extra: What else is known of the states, by name ("qpos", "points", ...): arrays of one row
            per state, the trajectories one after another. Imitators never see them.
    """

    features: tuple[np.ndarray, ...]
    returns: tuple[float, ...] = ()
    body: str = ""
    expert_run_id: str = ""
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)

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
        n_states = sum(len(array) for array in self.features)
        for name, array in self.extra.items():
            if name in _OWN or array.shape[:1] != (n_states,):
                raise SilemError(
                    f"extra array {name!r} has shape {array.shape}; allowed: {n_states} rows, and a"
                    f" name other than {', '.join(_OWN)}"
                )

    @property
    def n_features(self) -> int:
        """F, the number of skeletal features per state."""
        return int(self.features[0].shape[1])

    def first(self, n: int) -> Demonstrations:
        """Return the first ``n`` trajectories; raises SilemError if there are fewer."""
        if not 1 <= n <= len(self.features):
            raise SilemError(f"asked for {n} trajectories, allowed: 1 to {len(self.features)}")
        n_states = sum(len(array) for array in self.features[:n])
        return replace(
            self,
            features=self.features[:n],
            returns=self.returns[:n],
            extra={name: array[:n_states] for name, array in self.extra.items()},
        )

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
                **self.extra,
            },
        )

    @classmethod
    def from_arrays(cls, arrays: Iterable[np.ndarray]) -> Demonstrations:
        """Wrap (T + 1, F) arrays, checked as a file's are."""
        return cls(tuple(np.asarray(array, dtype=np.float32) for array in arrays))

    @classmethod
    def load(cls, source: Path | str) -> Demonstrations:
        """Read demonstrations by name ("HC0", "cmu_08_01") or from a file.

        Raises:
            SilemError: If there is no such file, or it is truncated, pickled, not a
                demonstrations file, or holds NaN.
        """
        path = file_of(source) if isinstance(source, str) and "/" not in source else Path(source)
        arrays = files.read_npz(path)
        missing = set(_OWN) - arrays.keys()
        if missing:
            raise SilemError(f"{path.name} is no demonstrations file: it lacks {sorted(missing)}")
        features, lengths, returns, body, run_id = (arrays.pop(name) for name in _OWN)
        if lengths.sum() != len(features):
            raise SilemError(f"{path.name} is damaged: trajectory lengths do not add up")
        parts = np.split(features.astype(np.float32), np.cumsum(lengths)[:-1])
        return cls(tuple(parts), tuple(returns.tolist()), str(body), str(run_id), arrays)


def file_of(name: str) -> Path:
    """Return where the demonstrations ``name`` (an expert's body, or a clip) lie or would lie."""
    return paths.demonstrations_dir() / (name if name.endswith(".npz") else f"{name}.npz")


def entry(name: str) -> dict[str, Any]:
    """Return what the manifest says of published demonstrations.

    Raises:
        SilemError: There are none of this name, or no manifest.
    """
    manifest = files.read_json(paths.demonstrations_dir() / MANIFEST)
    found: dict[str, Any] = manifest[choose("demonstrations", name, manifest)]
    return found


@contextmanager
def publishing() -> Iterator[None]:
    """Hold the one lock of all demonstrations, because they share the manifest.

    Raises:
        SilemError: Another process holds it for longer than ten minutes.
    """
    with files.lock(paths.runs_dir() / "demonstrations.lock", wait_s=_WAIT_S):
        yield


def publish(
    name: str, demonstrations: Demonstrations, about: Mapping[str, Any] | None = None
) -> Path:
    """Save demonstrations under the data folder and enter them in its manifest.

    Args:
        name: What `Demonstrations.load` finds them by.
        demonstrations: The demonstrations.
        about: What else the manifest should say of them, such as source and licence.

    Returns:
        The file.
    """
    path = file_of(name)
    demonstrations.save(path)
    manifest_path = path.parent / MANIFEST
    manifest = files.read_json(manifest_path) if manifest_path.exists() else {}
    returns = demonstrations.returns
    manifest[name] = {
        "body": demonstrations.body,
        "expert_run_id": demonstrations.expert_run_id,
        "n_trajectories": len(demonstrations.features),
        "n_features": demonstrations.n_features,
        "return_mean": float(np.mean(returns)) if returns else None,
        "return_std": float(np.std(returns)) if returns else None,
        **(about or {}),
        "sha256": files.sha256(path),
    }
    files.write_json(manifest_path, dict(sorted(manifest.items())))
    return path


def captured_speed_m_s(name: str) -> float | None:
    """Return the mean speed of the man whose motion was captured, None for a policy's episodes.

    Of a retargeted motion it is the man's, not the learner's, which goes slower on shorter legs.

    Raises:
        SilemError: There are no such demonstrations, or no manifest.
    """
    about = entry(name)
    captured = entry(about.get("retargeted_from", name))
    return captured["speed_m_s"] if "capture_rate_hz" in captured else None
