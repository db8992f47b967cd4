"""Runs: started, resumed or looked up by their configuration, and recorded once finished."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import numpy as np
import torch

from silem import demonstrations as demos
from silem import files, paths, seeding
from silem.config import RunConfig
from silem.demonstrations import Demonstrations
from silem.envs import make_vec
from silem.errors import SilemError
from silem.imitation.silem import SILEM
from silem.imitation.transforms import AffineTransform
from silem.learning.ppo import PPO
from silem.study import curve
from silem.study.checkpoint import CHECKPOINT, Checkpoint
from silem.study.evaluate import EVALUATION_SEED, Policy, evaluate, random_policy
from silem.study.record import RECORD, RunRecord, provenance
from silem.study.training import PROGRESS, make_model, make_policy_model, train

LOCK = "run.lock"
CURVE, POLICY, TRANSFORM = "curve.csv", "policy.safetensors", "transform.npz"


def run_folder(config: RunConfig) -> Path:
    """Return a run's working folder."""
    return paths.runs_dir() / config.study / config.run_id


def find(run_id: str) -> RunRecord | None:
    """Return a finished run's record, or None; published records come first."""
    for root in (paths.data_dir() / "results", paths.runs_dir()):
        for path in sorted(root.glob(f"*/{run_id}/{RECORD}")):
            return RunRecord.load(path)
    return None


def run(config: RunConfig, progress: bool = True, force: bool = False) -> RunRecord:
    """Return the finished run of a configuration: looked up, resumed, or made from the start.

    Killed at any moment, even with ``kill -9``, a run goes on from its last checkpoint when it is
    asked for again, and ends bit-identical to an uninterrupted one.

    Args:
        config: The run.
        progress: Show a progress bar.
        force: Throw the run's checkpoint away and make it anew, even if it is finished. A record
            that is already published stays until the new one replaces it.

    Raises:
        SilemError: Another process works on this run; its checkpoint is damaged or another run's;
            its demonstrations are missing, too few, or not those it was made with.
        KeyboardInterrupt: On Ctrl-C or SIGTERM; the message tells how to go on.
    """
    if not force and (finished := find(config.run_id)):
        return _with_same_demonstrations(finished, config)
    folder = run_folder(config)
    with files.lock(folder / LOCK), sigterm_as_interrupt():
        if not force and (finished := find(config.run_id)):  # by whoever held the lock
            return _with_same_demonstrations(finished, config)
        files.remove_leftovers(folder)
        if force:
            for name in (CHECKPOINT, RECORD, PROGRESS):
                (folder / name).unlink(missing_ok=True)
        torch.set_num_threads(1)
        try:
            return _work(config, folder, progress)
        except KeyboardInterrupt:
            has = "its checkpoint is kept" if (folder / CHECKPOINT).exists() else "no checkpoint yet"
            message = f"stopped {config.run_id} ({has}); to go on: {config.command}"
            raise KeyboardInterrupt(message) from None


@contextmanager
def sigterm_as_interrupt() -> Iterator[None]:
    """Make SIGTERM stop the block as Ctrl-C does (only possible in the main thread)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(signal_number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _work(config: RunConfig, folder: Path, progress: bool) -> RunRecord:
    source = provenance()
    if config.method == "random":
        policy = random_policy(config.body)
        n_episodes = config.budget.n_eval_episodes
        result = evaluate(policy, config.body, n_episodes, EVALUATION_SEED, progress=progress)
        training = {"n_steps": 0, "steps_per_s": None, "disc_reward_last": None}
        record = RunRecord(
            config.run_id, "finished", config.to_dict(), result.to_dict(), training,
            source | {"earlier_commits": []}, None, 0.0, {}, folder,
        )  # fmt: skip
        return _finish(record, config)
    return _train_and_record(config, folder, source, progress)


def _train_and_record(
    config: RunConfig, folder: Path, source: dict, progress: bool
) -> RunRecord:
    demonstrations, sha = load_demonstrations(config)
    commit = source["git_commit"] or "unknown"
    start = _start(config, folder, sha or "", commit)
    env_seed = seeding.child_seed(config.seed, "env", 0)
    env = make_vec(config.body, n_envs=config.budget.n_envs, seed=env_seed)
    try:
        model = make_model(config, env, demonstrations)
        segments = train(model, config, folder, start, progress=progress)
    finally:
        env.close()
    training_time_s = segments.wall_time_s
    result = evaluate(
        model, config.body, config.budget.n_eval_episodes, EVALUATION_SEED,
        model if isinstance(model, SILEM) else None, progress=progress,
    )  # fmt: skip
    files.write_text(folder / CURVE, curve.to_csv(segments.curve))
    files.write_tensors(folder / POLICY, model.policy_arrays(), {"run_id": config.run_id})
    if isinstance(model, SILEM) and isinstance(model.transform_net, AffineTransform):
        files.write_npz(folder / TRANSFORM, _affine_arrays(model.transform_net))
    record = RunRecord(
        run_id=config.run_id,
        status="finished",
        config=config.to_dict(),
        evaluation=result.to_dict(),
        training={
            "n_steps": config.budget.n_steps,
            "steps_per_s": config.budget.n_steps / training_time_s,
            "disc_reward_last": _last(segments.curve, "disc_reward"),
        },
        provenance=source | {"earlier_commits": [c for c in start.commits if c != commit]},
        demonstrations_sha256=sha,
        wall_time_s=segments.wall_time_s,
        files={
            name: files.sha256(folder / name)
            for name in (CURVE, POLICY, TRANSFORM)
            if (folder / name).exists()
        },
        folder=folder,
    )
    return _finish(record, config)


def _start(config: RunConfig, folder: Path, sha: str, commit: str) -> Checkpoint:
    path = folder / CHECKPOINT
    if not path.exists():
        empty = np.empty((0, len(curve.COLUMNS)))
        return Checkpoint(config.run_id, 0, 0.0, (commit,), sha, empty, {})
    found = Checkpoint.load(path, config.run_id, sha)
    commits = tuple(dict.fromkeys([*found.commits, commit]))
    return Checkpoint(
        found.run_id, found.iteration, found.wall_time_s, commits, sha, found.curve, found.model
    )


def _finish(record: RunRecord, config: RunConfig) -> RunRecord:
    """Publish the run where its budget says so; the records themselves are written last."""
    if config.budget.is_evidence:
        published = paths.results_dir(config.study) / config.run_id
        for name in record.files:
            files.write_bytes(published / name, (record.folder / name).read_bytes())
        record.save(published)
    record.save(record.folder)
    (record.folder / PROGRESS).unlink(missing_ok=True)
    return record


def load_demonstrations(config: RunConfig) -> tuple[Demonstrations | None, str | None]:
    """Return a run's demonstrations and their file's SHA-256, or None twice for no imitator.

    Raises:
        SilemError: They are missing or damaged; the message says how to make them.
    """
    if not config.demonstrations:
        return None, None
    path = demos.file_of(config.demonstrations)
    if not path.exists():
        raise SilemError(
            f"there are no demonstrations of {config.demonstrations} ({path}); train its expert"
            f" with `python -m silem run --body {config.demonstrations} --method ppo`, then record"
            f" it with `python -m silem demonstrations --body {config.demonstrations}` (both take"
            " --budget)"
        )
    return Demonstrations.load(config.demonstrations), files.sha256(path)


def _with_same_demonstrations(record: RunRecord, config: RunConfig) -> RunRecord:
    path = demos.file_of(config.demonstrations)
    if config.demonstrations and path.exists():
        now = files.sha256(path)
        if now != record.demonstrations_sha256:
            raise SilemError(
                f"{record.run_id} was made with other demonstrations (SHA-256"
                f" {str(record.demonstrations_sha256)[:12]}) than {path} holds now ({now[:12]});"
                " bring those back, or make the run anew with --force"
            )
    return record


def _last(values: np.ndarray, column: str) -> float | None:
    """Return a curve column's last number that is not blank."""
    numbers = values[:, curve.COLUMNS.index(column)]
    numbers = numbers[~np.isnan(numbers)]
    return float(numbers[-1]) if len(numbers) else None


def _affine_arrays(transform: AffineTransform) -> dict[str, np.ndarray]:
    return {
        "A": transform.scale.detach().cpu().numpy(),
        "b": transform.offset.detach().cpu().numpy(),
    }


def load_policy(record: RunRecord) -> Policy:
    """Return a finished run's policy, ready to `predict`.

    Raises:
        SilemError: The policy's file is missing or not the recorded one.
    """
    config = record.run_config()
    if config.method == "random":
        return random_policy(config.body)
    arrays, _ = files.read_tensors(record.file(POLICY))
    env = make_vec(config.body, n_envs=1)
    try:
        model = make_policy_model(config, env)
    finally:
        env.close()
    model.load_policy_arrays(arrays)
    return model


def state(config: RunConfig) -> str:
    """Return "finished", "running", "part" (there is a checkpoint) or "missing"."""
    if find(config.run_id) is not None:
        return "finished"
    folder = run_folder(config)
    if files.is_locked(folder / LOCK):
        return "running"
    return "part" if (folder / CHECKPOINT).exists() else "missing"
