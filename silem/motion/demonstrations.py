"""State-only demonstrations tau_E: skeletal features of an expert's episodes."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from silem import bodies
from silem.util import files, paths
from silem.util.errors import NUMBER, SilemError, check_name, choose, reason

MANIFEST = "manifest.json"
_OWN = ("features", "lengths", "returns", "body", "expert_run_id")  # arrays of every file


@dataclass(frozen=True, repr=False)
class Demonstrations:
    """An expert's trajectories; no actions.

    Beside its features more can be known of the states, by name ("qpos", "points", ...): arrays of
    one row per state, the trajectories one after another. Imitators never see them.
    """

    features: tuple[np.ndarray, ...]  #: one (T + 1, F) float32 array per trajectory
    returns: tuple[float, ...] = ()  #: the expert's, per trajectory; empty where it is unknown
    body: str = ""  #: the expert's
    expert_run_id: str = ""  #: the run whose policy was rolled out, "" where there is none
    extra: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "features", tuple(map(_float32, self.features)))
        shapes = {array.shape[1:] for array in self.features}
        if [*map(len, shapes)] != [1] or shapes == {(0,)}:
            found = shapes or "none at all"
            raise SilemError(f"trajectories must all be (T + 1, F) with one F > 0, not {found}")
        for i, array in enumerate(self.features):
            if len(array) < 2:
                raise SilemError(f"trajectory {i} is too short: {len(array)} of at least 2 states")
            if not np.isfinite(array).all():
                raise SilemError(f"trajectory {i} holds NaN or infinity")
        if len(self.returns) not in (0, len(self.features)):
            raise SilemError(f"{len(self.returns)} returns of {len(self.features)} trajectories")
        for number in self.returns:
            NUMBER.check("each of the returns", number)
        n_states = sum(map(len, self.features))
        for name, array in self.extra.items():
            if name in _OWN or array.shape[:1] != (n_states,):
                told = f"extra array {name!r} has shape {array.shape}; allowed: {n_states} rows"
                raise SilemError(f"{told}, and a name other than {', '.join(_OWN)}")

    def __repr__(self) -> str:
        n, n_states = len(self.features), sum(map(len, self.features))
        held = f"{n} trajectories, {n_states} states, {self.n_features} features"
        return f"<Demonstrations{self.body and f' of {self.body}'}: {held}>"

    @property
    def n_features(self) -> int:
        """F, the number of skeletal features per state."""
        return int(self.features[0].shape[1])

    def first(self, n: int) -> "Demonstrations":
        """Return the first ``n`` trajectories; raises SilemError if there are fewer."""
        if not 1 <= n <= len(self.features):
            raise SilemError(f"asked for {n} trajectories, allowed: 1 to {len(self.features)}")
        n_states = sum(map(len, self.features[:n]))
        extra = {name: array[:n_states] for name, array in self.extra.items()}
        return replace(self, features=self.features[:n], returns=self.returns[:n], extra=extra)

    def save(self, path: Path | str) -> None:
        """Write one npz file (no pickle), whole or not at all."""
        own = {
            "features": np.concatenate(self.features),
            "lengths": np.array([len(array) for array in self.features], dtype=np.int64),
            "returns": np.array(self.returns, dtype=np.float64),
            "body": np.array(self.body),
            "expert_run_id": np.array(self.expert_run_id),
        }
        files.write_npz(Path(path), own | dict(self.extra))

    @classmethod
    def of(cls, given: Any) -> "Demonstrations":
        """Take demonstrations, or wrap a list of (T + 1, F) arrays, checked as a file's are."""
        wanted = "a Demonstrations or a list of arrays (T + 1, F), one for each episode"
        if isinstance(given, Demonstrations):
            return given
        if given is None:
            raise SilemError(f"imitation needs demonstrations: {wanted}")
        if isinstance(given, np.ndarray) and given.ndim == 2:
            given = f"one array {given.shape}; for one episode, [array]"
            raise SilemError(f"demonstrations are {given}; allowed: {wanted}")
        try:
            return cls(tuple(given))
        except (TypeError, ValueError) as error:  # a SilemError is a ValueError
            told = f"unusable demonstrations: {reason(error)}"
            raise SilemError(f"{told}; allowed: {wanted}") from error

    @classmethod
    def load(cls, source: Path | str) -> "Demonstrations":
        """Read demonstrations by name ("HC0", "cmu_08_01"), or from a file: what ends in ".npz".

        Raises SilemError: there is no such file, or it is none or damaged.
        """
        named = isinstance(source, str) and not ("/" in source or source.endswith(".npz"))
        path = file_of(str(source)) if named else Path(source)
        arrays = files.read_npz(path)
        try:
            if missing := set(_OWN) - arrays.keys():
                raise SilemError(f"it is no demonstrations file: it lacks {sorted(missing)}")
            features, lengths, returns, body, run_id = (arrays.pop(name) for name in _OWN)
            whole = features.ndim == 2 and lengths.dtype.kind == "i"
            parts = np.split(features, np.cumsum(lengths)[:-1]) if whole else []
            if not whole or [*map(len, parts)] != lengths.tolist():
                raise SilemError("it is damaged: trajectory lengths do not add up")
            if not all(isinstance(text.tolist(), str) for text in (body, run_id)):
                raise SilemError("it is damaged: its body or its expert's run is no text")
            worth = tuple(returns.ravel().tolist())
            return cls(tuple(parts), worth, str(body), str(run_id), arrays)
        except SilemError as error:
            raise SilemError(f"{path.name}: {error}") from error


def _float32(array: Any) -> np.ndarray:
    """Return real numbers as float32; text, booleans and complex numbers are no features."""
    found = np.asarray(array)
    if found.dtype.kind not in "fiu":
        raise SilemError(f"features are {found.dtype}; allowed: real numbers")
    with np.errstate(over="ignore"):  # what does not fit becomes infinite, and is refused
        return found.astype(np.float32, copy=False)


def expert_of(name: str) -> tuple[str, int | None]:
    """Return the body and the trial that demonstrations are of: ("HC0", 3) for "HC0_s3".

    The trial of "HC0" is None: its demonstrator's, whichever that is.
    """
    body, separator, trial = name.rpartition("_s")
    return (body, int(trial)) if separator and trial.isdecimal() else (name, None)


def retargeted(name: str, body: str) -> str:
    """Return the name of demonstrations retargeted to a body: "cmu_08_01_on_Atlas"."""
    suffix = f"_on_{body}"
    return name.removesuffix(suffix) + suffix


def file_of(name: str) -> Path:
    """Return where the demonstrations ``name`` (an expert's body, or a clip) lie or would lie.

    Those that no run makes come with the package, and are found there if not in the data folder.
    """
    stem = check_name("demonstrations", name).removesuffix(".npz")
    path = paths.demonstrations_dir() / f"{stem}.npz"
    packaged = not path.exists() and stem in _packaged()
    return paths.clips_dir() / path.name if packaged else path


def _packaged() -> dict[str, dict[str, Any]]:
    every = _read(paths.clips_dir())
    return {name: about for name, about in every.items() if not about.get("expert_run_id")}


def manifest() -> dict[str, dict[str, Any]]:
    """Return what is said of all demonstrations, published or with the package, by name."""
    return _packaged() | _read(paths.demonstrations_dir())


def _read(folder: Path) -> dict[str, dict[str, Any]]:
    path = folder / MANIFEST
    content = files.read_json(path) if path.exists() else {}
    if not isinstance(content, dict) or not all(isinstance(e, dict) for e in content.values()):
        raise SilemError(f"{path} is no manifest of demonstrations")
    return content


def entry(name: str) -> dict[str, Any]:
    """Return what the manifest says of published demonstrations; SilemError if there are none."""
    content = manifest()
    return content[choose("demonstrations", name, content)]


def is_published(name: str) -> bool:
    """Return whether the file is there and the one that the manifest describes.

    Whoever was killed between writing the one and the other left them apart. A person's own file,
    which no expert made and the manifest does not name, stands for itself. Raises SilemError on a
    damaged manifest, or a damaged file that it does not name.
    """
    path = file_of(name)
    if not path.exists():
        return False
    if (about := manifest().get(path.stem)) is not None:
        return bool(about.get("sha256") == files.sha256(path))
    return not Demonstrations.load(path).expert_run_id


def load_published(name: str) -> tuple[Demonstrations, str]:
    """Return published demonstrations and their file's SHA-256, after checking both.

    Raises SilemError: the file is missing, damaged, another body's, or not the manifest's.
    """
    path = file_of(name)
    if path.exists() and not is_published(name):
        told = f"{path} is not the file that {MANIFEST} beside it describes (SHA-256 differs)"
        raise SilemError(f"{told}; `silem demonstrations` or `silem mocap` publishes it again")
    there = Demonstrations.load(path)
    if bodies.exists(path.stem) and there.body != path.stem:
        raise SilemError(f"{path} holds demonstrations of {there.body!r}, another body")
    return there, files.sha256(path)


@contextmanager
def publishing() -> Iterator[None]:
    """Hold the one lock of all demonstrations, which share the manifest; wait up to ten minutes."""
    with files.lock(paths.runs_dir() / "demonstrations.lock", wait_s=600.0):
        files.remove_leftovers(paths.demonstrations_dir())
        yield


def publish(
    name: str, demonstrations: Demonstrations, about: Mapping[str, Any] | None = None
) -> Path:
    """Save demonstrations where `Demonstrations.load` finds them by name, and return the file.

    The manifest beside it takes what else is to be said `about` them, such as source and licence.
    """
    path = paths.demonstrations_dir() / f"{check_name('demonstrations', name)}.npz"
    content = _read(path.parent)
    demonstrations.save(path)
    returns = demonstrations.returns
    content[path.stem] = {
        "body": demonstrations.body,
        "expert_run_id": demonstrations.expert_run_id,
        "n_trajectories": len(demonstrations.features),
        "n_features": demonstrations.n_features,
        "return_mean": float(np.mean(returns)) if returns else None,
        "return_std": float(np.std(returns)) if returns else None,
        **(about or {}),
        "sha256": files.sha256(path),
    }
    files.write_json(path.parent / MANIFEST, dict(sorted(content.items())))
    return path
