"""Runs: started, resumed or looked up by their configuration, and what is recorded of them."""

import dataclasses
import gc
import importlib.metadata
import math
import os
import platform
import re
import signal
import subprocess
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import numpy as np

from silem import bodies
from silem.motion import demonstrations as demos
from silem.motion.demonstrations import Demonstrations
from silem.study.config import MAX_RUN_ID, RunConfig
from silem.study.settings import BUDGETS, namesake
from silem.util import files, paths
from silem.util.errors import SilemError, check_name, choose

if TYPE_CHECKING:
    from silem.algorithms import PPO

RECORD = "record.json"
CURVE, POLICY, TRANSFORM = "curve.csv", "policy.safetensors", "transform.npz"
CHECKPOINT, PROGRESS = "checkpoint.safetensors", "progress.json"  # of an unfinished run
LOCK, ATTEMPT, FAILED = "run.lock", "attempt.json", "failed.txt"
STARTS = 5
"""How often a work loop begins a run at one checkpoint, each time killed, before it has failed."""
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
Shown = tuple[Demonstrations | None, str]
"""A run's demonstrations and their file's SHA-256; None and "" for no imitator."""


@dataclass(frozen=True, repr=False)
class RunRecord:
    """A finished run, as ``record.json`` holds it."""

    run_id: str  #: its name, which ends in a hash of its configuration
    status: str  #: ``"finished"``
    config: dict[str, Any]  #: `RunConfig.to_dict`
    evaluation: dict[str, Any]  #: a `silem.study.evaluate.Evaluation`
    training: dict[str, Any]  #: ``n_steps``, ``steps_per_s``
    provenance: dict[str, Any]  #: of the last session; ``earlier_...`` of those before
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
    def run_config(self) -> RunConfig:
        """The configuration, checked when it is first asked for."""
        return RunConfig.from_dict(self.config)

    def file(self, name: str) -> Path:
        """Return one of the record's files; raises SilemError if it is not the recorded one."""
        path = self.folder / choose(f"file of run {self.run_id}", name, self.files)
        if files.sha256(path) != self.files[name]:
            raise SilemError(f"{path} is not the file that its record describes (SHA-256 differs)")
        return path


def provenance() -> dict[str, Any]:
    """Return what the code runs on: commit, package versions, machine.

    ``git_dirty`` tells whether the package's own code, or the pinned environment, differs from the
    commit; both are None where there is no git. Processor and ``kernels`` of the libraries move a
    run's last bits.
    """
    status = git("status", "--porcelain", "--untracked-files=no", "--", "silem", "environment.txt")
    processor = platform.processor() or platform.machine()
    with suppress(OSError):
        found = re.search(r"^model name\s*:\s*(.*)$", Path("/proc/cpuinfo").read_text(), re.M)
        processor = found[1] if found else processor
    return {
        "git_commit": git("rev-parse", "HEAD"),
        "git_dirty": None if status is None else bool(status),
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
    command = ["git", "--no-optional-locks", "-C", str(root), *arguments]
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


def run_folder(config: RunConfig) -> Path:
    """Return a run's working folder."""
    return paths.runs_dir() / config.study / config.run_id


def _home(config: RunConfig) -> Path:
    """Return the folder that a run's record goes to: the committed one where it is evidence."""
    published = paths.results_dir(config.study) / config.run_id
    return published if config.is_published else run_folder(config)


def recorded(study: str = "*", run_id: str = "*", *, working: bool = False) -> list[Path]:
    """Return the folders of published records, or working ones: of all, of a study, or of a run."""
    root = paths.runs_dir() if working else paths.data_dir() / "results"
    return sorted(path.parent for path in root.glob(f"{study}/{run_id}/{RECORD}"))


def locate(run_id: str) -> Path | None:
    """Return the folder of a finished run's record, published or not; None if there is none."""
    check_name("run id", run_id, MAX_RUN_ID)
    found = recorded(run_id=run_id) or recorded(run_id=run_id, working=True)
    return found[0] if found else None


def find(run_id: str) -> RunRecord | None:
    """Return a finished run's record, published or not, or None; SilemError if it is damaged."""
    return RunRecord.load(folder) if (folder := locate(run_id)) else None


def get(run_id: str) -> RunRecord:
    """Return a finished run's record; SilemError if there is none, or it is damaged."""
    if (record := find(run_id)) is None:
        raise SilemError(f"there is no finished run {run_id!r} in {paths.data_dir()}")
    return record


def finished(config: RunConfig) -> RunRecord | None:
    """Return a run's record, or None; SilemError if its demonstrations are not those there now."""
    if (record := find(config.run_id)) and config.demonstrations:
        path, then = demos.file_of(config.demonstrations), str(record.demonstrations_sha256)
        if path.exists() and (now := files.sha256(path)) != then:
            raise SilemError(
                f"{record.run_id} was made with other demonstrations (SHA-256 {then[:12]}) than"
                f" {path} holds now ({now[:12]}); bring those back, or"
                f" {instead_of(record.folder, f'{config.command} ')}"
            )
    return record


def demonstrator(experts: Sequence[RunConfig]) -> RunRecord:
    """Return a body's demonstrator: the expert with the highest return among all its trials.

    "Running as fast as possible" (Section V) is a choice among policies; this is the rule for it,
    the same for every body. Returns are those of the finished runs' evaluations. Raises SilemError:
    not all of these experts are finished; the message names the next.
    """
    found = [find(config.run_id) for config in experts]
    missing = [config for config, record in zip(experts, found, strict=True) if record is None]
    if missing:
        told = (
            f"the demonstrator of {missing[0].body} is the best of {len(found)} experts, of which"
        )
        raise SilemError(f"{told} {len(missing)} are not finished; next: {missing[0].command}")
    records = [record for record in found if record is not None]
    return max(records, key=lambda record: float(record.evaluation["return_mean"]))


def instead_of(path: Path, command: str = "") -> str:
    """Say how something else is made than what lies at a path: what is committed is kept."""
    root = paths.checkout()
    committed = [root / "data" / name for name in ("results", "demonstrations")] if root else []
    kept = any(path.is_relative_to(folder) for folder in committed)
    return "set SILEM_DATA_DIR to another folder" if kept else f"replace it with {command}--force"


def is_finished(config: RunConfig) -> bool:
    """Tell whether a run's record is there, without a look into it."""
    folders = (paths.results_dir(config.study) / config.run_id, run_folder(config))
    return any((folder / RECORD).exists() for folder in folders)


def state(config: RunConfig) -> str:
    """Return "finished", "running", "failed", "part" (there is a checkpoint) or "missing"."""
    if is_finished(config):
        return "finished"
    folder = run_folder(config)
    if files.is_locked(folder / LOCK):
        return "running"
    if (folder / FAILED).exists():
        return "failed"
    return "part" if (folder / CHECKPOINT).exists() else "missing"


def fail(config: RunConfig, reason: str) -> None:
    """Note why a run has failed; work loops then leave it alone until it is asked for again."""
    files.write_text(run_folder(config) / FAILED, f"{reason}\n")


def forgive(config: RunConfig) -> None:
    """Forget that a run has failed."""
    (run_folder(config) / FAILED).unlink(missing_ok=True)


@contextmanager
def _attempt(folder: Path, most: float = math.inf) -> Iterator[None]:
    """Count how often a run was begun at its checkpoint; only ``kill -9`` leaves the count.

    Raises SilemError: it was killed `most` times there; next time the count begins anew.
    """
    path, checkpoint = folder / ATTEMPT, folder / CHECKPOINT
    reached = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
    before = files.read_json(path) if path.exists() else {}
    starts = before["starts"] + 1 if before.get("reached") == reached else 1
    if starts > most:
        path.unlink()
        raise SilemError(f"it was killed {most} times without getting on")
    files.write_json(path, {"starts": starts, "reached": reached})
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


@contextmanager
def stoppable() -> Iterator[None]:
    """Raise KeyboardInterrupt on SIGTERM as on Ctrl-C while the block runs: one way to stop."""

    def interrupt(signal_number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    # Python allows this in the main thread alone. What is ignored, as Ctrl-C is in a shell's
    # background jobs, stays so.
    main = threading.current_thread() is threading.main_thread()
    numbers = (signal.SIGINT, signal.SIGTERM) if main else ()
    caught = [number for number in numbers if signal.getsignal(number) != signal.SIG_IGN]
    before = [(number, signal.signal(number, interrupt)) for number in caught]
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)


def stop_with_input() -> None:
    """Stop as by SIGTERM when the standard input ends: with its other end, even by ``kill -9``."""

    def watch() -> None:
        while os.read(0, 1024):
            pass
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()


def run(
    config: RunConfig,
    progress: bool = True,
    force: bool = False,
    until: float = math.inf,
    starts: float = math.inf,
) -> RunRecord:
    """Return the finished run of a configuration: looked up, resumed, or made from the start.

    Killed at any moment, even with ``kill -9``, a run goes on from its last checkpoint when it is
    asked for again, and ends bit-identical to an uninterrupted one.

    Args:
        config: The run.
        progress: Show a progress bar.
        force: Throw the run's checkpoint away and make it anew, even if it is finished. A record
            that is already published stays until the new one replaces it.
        until: The `time.monotonic` after which no checkpoint can be reached any more.
        starts: How often it may be begun at one checkpoint, and killed there.

    Raises:
        SilemError: It was killed too often at one checkpoint; another process works on it
            (`silem.util.files.Held`); its checkpoint is damaged or another run's; its
            demonstrations are missing, too few, or not those it was made with.
        KeyboardInterrupt: On Ctrl-C or SIGTERM, or when time is up; it tells how to go on.
    """
    folder = run_folder(config)
    if not force and (record := finished(config)):
        return record
    named = namesake(config.budget, bodies.get(config.body).family)
    differs = [n for n, count in vars(config.budget).items() if getattr(named, n) != count]
    if differs not in ([], ["n_trials"]):  # it would pass for evidence; old records may differ
        told = f"budget {config.budget.name!r} has another {', '.join(differs)} than {named.name!r}"
        raise SilemError(f"{told}; give it a name of its own, begun unlike {', '.join(BUDGETS)}")
    shown = load_demonstrations(config)
    with stoppable(), files.lock(folder / LOCK):
        for place in {folder, _home(config)}:
            files.remove_leftovers(place)
        if not force and (record := finished(config)):  # by whoever held the lock
            return record
        forgive(config)
        for name in (CHECKPOINT, RECORD, PROGRESS) if force else ():
            (folder / name).unlink(missing_ok=True)
        try:
            return _make(config, shown, progress, until, starts)
        except KeyboardInterrupt as interrupt:
            kept = "its checkpoint is kept" if (folder / CHECKPOINT).exists() else "no checkpoint"
            why = f"{interrupt}: " if str(interrupt) else ""
            message = f"{why}stopped {config.run_id} ({kept}); to go on: {config.command}"
            raise KeyboardInterrupt(message) from None
        finally:
            # A model holds itself in circles, which Python breaks when objects are many, not large:
            # loops would keep several runs' simulators.
            gc.collect()


def _make(config: RunConfig, shown: Shown, progress: bool, until: float, most: float) -> RunRecord:
    """Make a run, from its checkpoint where there is one, and record it where its budget says."""
    import torch  # here, so that looking runs up does not load it

    from silem.algorithms import GAIfO
    from silem.study.evaluate import RandomPolicy, evaluate
    from silem.study.training import Checkpoint, make_env, make_model, task_options, train

    torch.set_num_threads(1)
    folder, source, (demonstrations, sha) = run_folder(config), provenance(), shown
    start = Checkpoint.load(folder / CHECKPOINT, config, sha)
    commit, processor = source["git_commit"] or "unknown", source["machine"]["processor"]
    commits = tuple(dict.fromkeys([*start.commits, commit]))
    processors = tuple(dict.fromkeys([*start.processors, processor]))
    start = dataclasses.replace(start, commits=commits, processors=processors)
    home, training = _home(config), {"n_steps": 0, "steps_per_s": None}
    policy: Any
    curve: np.ndarray | None = None
    with _attempt(folder, most):
        if config.method == "random":
            policy = RandomPolicy(config.learner, config.seed, config.hyper.action_std)
        else:
            env = make_env(config)
            try:
                policy = make_model(config, env, demonstrations)
                curve = train(policy, config, folder, start, progress, until)
            finally:
                env.close()
            n_steps = config.budget.n_steps
            training = {"n_steps": n_steps, "steps_per_s": n_steps / start.spent()["wall_time_s"]}
            source["earlier_commits"] = [one for one in commits if one != commit]
            source["earlier_processors"] = [one for one in processors if one != processor]
        result = evaluate(
            policy, config.learner, config.budget.n_eval_episodes, progress=progress,
            model=policy if isinstance(policy, GAIfO) else None, **task_options(config),
        )  # fmt: skip
    (folder / PROGRESS).unlink(missing_ok=True)
    record = RunRecord(
        run_id=config.run_id,
        status="finished",
        config=config.to_dict(),
        evaluation=result._asdict(),
        training=training,
        provenance=source,
        demonstrations_sha256=sha or None,
        **start.spent(),
        files={} if curve is None else _write_outcome(home, policy, curve, config.run_id),
        folder=home,
    )
    record.save(home)  # last: whoever finds it finds a whole run
    return record


def _write_outcome(folder: Path, model: "PPO", curve: np.ndarray, run_id: str) -> dict[str, str]:
    """Write what a training leaves, and return the files' SHA-256 by name."""
    from silem.algorithms.silem import SILEM, AffineEnsemble, AffineTransform

    files.write_text(folder / CURVE, curve_csv(curve))
    model.export_policy(folder / POLICY, run_id=run_id)
    net = model.transform_net if isinstance(model, SILEM) else None
    names = [CURVE, POLICY]
    if isinstance(net, AffineTransform):
        arrays = net.mean()
        if isinstance(net, AffineEnsemble):
            arrays |= {name: x.detach().cpu().numpy() for name, x in net.state_dict().items()}
        files.write_npz(folder / TRANSFORM, arrays)
        names.append(TRANSFORM)
    return {name: files.sha256(folder / name) for name in names}


def load_demonstrations(config: RunConfig) -> Shown:
    """Return what a run is shown; SilemError if that is missing, too little or not as published."""
    name = config.demonstrations
    if not name:
        return None, ""
    path = demos.file_of(name)
    if not path.exists():
        check_made_by_an_expert(name)
        from silem.study.studies import experts

        budget = BUDGETS.get(config.budget.base_name, config.budget)
        body, trial = demos.expert_of(name)
        expert = experts(body, budget, trial)[0].command
        then = expert.partition(" --method")[0].replace("silem run", "silem demonstrations")
        then += f" --budget {budget.name}" + ("" if trial is None else f" --trial {trial}")
        told = f"there are no demonstrations of {name} ({path}); train its expert with `{expert}`"
        raise SilemError(f"{told}, then `{then}`")
    there, sha = demos.load_published(name)
    if (n := config.hyper.n_trajectories) > len(there.features):
        raise SilemError(f"n_trajectories is {n}, and {path} holds {len(there.features)}")
    return there, sha


def check_made_by_an_expert(demonstrations: str) -> None:
    """Raise SilemError, saying how they are made, unless an expert makes these demonstrations."""
    if not bodies.exists(demos.expert_of(demonstrations)[0]):
        path = demos.file_of(demonstrations)
        raise SilemError(f"{path} is not there or not whole; `silem mocap` makes it")
