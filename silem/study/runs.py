"""Runs: started, resumed or looked up by their configuration, and recorded once finished."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from silem import bodies
from silem.motion import demonstrations as demos
from silem.motion.demonstrations import Demonstrations
from silem.study import curve
from silem.study.checkpoint import CHECKPOINT, PROGRESS, Checkpoint
from silem.study.config import MAX_RUN_ID, RunConfig
from silem.study.interrupt import sigterm_as_interrupt
from silem.study.record import CURVE, POLICY, RECORD, TRANSFORM, RunRecord, provenance
from silem.study.settings import check_counts
from silem.util import files, paths
from silem.util.errors import SilemError, check_name

if TYPE_CHECKING:
    from silem.algorithms import PPO
    from silem.study.evaluate import Evaluation
    from silem.study.training import Segments

LOCK = "run.lock"


def run_folder(config: RunConfig) -> Path:
    """Return a run's working folder."""
    return paths.runs_dir() / config.study / config.run_id


def find(run_id: str) -> RunRecord | None:
    """Return a finished run's record, or None; published records come first.

    Raises:
        SilemError: `run_id` can be no run's, or the record is damaged.
    """
    check_name("run id", run_id, MAX_RUN_ID)
    for root in (paths.data_dir() / "results", paths.runs_dir()):
        for path in sorted(root.glob(f"*/{run_id}/{RECORD}")):
            return RunRecord.load(path)
    return None


def finished(config: RunConfig) -> RunRecord | None:
    """Return a run's record if it is finished, else None.

    Raises:
        SilemError: It was made with other demonstrations than those there are now.
    """
    record = find(config.run_id)
    if record is None or not config.demonstrations:
        return record
    path = demos.file_of(config.demonstrations)
    if not path.exists():
        return record
    now, then = files.sha256(path), str(record.demonstrations_sha256)
    if now != then:
        raise SilemError(
            f"{record.run_id} was made with other demonstrations (SHA-256 {then[:12]}) than"
            f" {path} holds now ({now[:12]}); bring those back, or make the run anew with --force"
        )
    return record


def state(config: RunConfig) -> str:
    """Return "finished", "running", "part" (there is a checkpoint) or "missing"."""
    if find(config.run_id) is not None:
        return "finished"
    folder = run_folder(config)
    if files.is_locked(folder / LOCK):
        return "running"
    return "part" if (folder / CHECKPOINT).exists() else "missing"


def run(
    config: RunConfig, progress: bool = True, force: bool = False, wait: bool = False
) -> RunRecord:
    """Return the finished run of a configuration: looked up, resumed, or made from the start.

    Killed at any moment, even with ``kill -9``, a run goes on from its last checkpoint when it is
    asked for again, and ends bit-identical to an uninterrupted one.

    Args:
        config: The run.
        progress: Show a progress bar.
        force: Throw the run's checkpoint away and make it anew, even if it is finished. A record
            that is already published stays until the new one replaces it.
        wait: If another process works on this run, wait for it instead of raising.

    Raises:
        SilemError: Another process works on this run; its checkpoint is damaged or another run's;
            its demonstrations are missing, too few, or not those it was made with.
        KeyboardInterrupt: On Ctrl-C or SIGTERM; the message tells how to go on.
    """
    folder, published = run_folder(config), paths.results_dir(config.study) / config.run_id
    written = (folder, published)
    crashed = any(files.leftovers(place) for place in written)
    if not (force or crashed) and (record := finished(config)):
        return record
    check_counts(config.budget, bodies.get(config.body).family)
    wait_s = float("inf") if wait else 1.0
    with sigterm_as_interrupt(), files.lock(folder / LOCK, wait_s):
        for place in written:
            files.remove_leftovers(place)
        if not force and (record := finished(config)):  # by whoever held the lock
            return record
        if force:
            for name in (CHECKPOINT, RECORD, PROGRESS):
                (folder / name).unlink(missing_ok=True)
        try:
            return _make(config, folder, progress)
        except KeyboardInterrupt:
            kept = "its checkpoint is kept" if (folder / CHECKPOINT).exists() else "no checkpoint"
            message = f"stopped {config.run_id} ({kept}); to go on: {config.command}"
            raise KeyboardInterrupt(message) from None


def _make(config: RunConfig, folder: Path, progress: bool) -> RunRecord:
    """Make a run, from its checkpoint where there is one, and record it."""
    import torch  # here, so that looking runs up does not load it

    from silem.algorithms import GAIfO
    from silem.study.evaluate import evaluate, random_policy
    from silem.study.training import make_env, make_model, task_options, train

    torch.set_num_threads(1)
    began, processor_began = time.perf_counter(), time.process_time()
    source = provenance()
    n_episodes = config.budget.n_eval_episodes
    if config.method == "random":
        policy = random_policy(config.learner, config.seed, config.hyper.action_std)
        result = evaluate(policy, config.learner, n_episodes, progress=progress)
        training = {"n_steps": 0, "steps_per_s": None, "disc_reward_last": None}
        spent = {
            "wall_time_s": time.perf_counter() - began,
            "processor_time_s": time.process_time() - processor_began,
        }
        return _record(config, folder, result, training, source, None, spent)

    demonstrations, sha = load_demonstrations(config)
    start = _start(config, folder, sha or "", source["git_commit"] or "unknown")
    env = make_env(config)
    try:
        model = make_model(config, env, demonstrations)
        segments = train(model, config, folder, start, progress=progress)
    finally:
        env.close()
    training = _training(config, segments)
    scorer = model if isinstance(model, GAIfO) else None
    task = task_options(config)
    result = evaluate(model, config.learner, n_episodes, model=scorer, progress=progress, **task)
    _write_outcome(folder, model, segments.curve, config.run_id)
    if demonstrations is not None:
        source["expert_run_id"] = demonstrations.expert_run_id
    source["earlier_commits"] = [c for c in start.commits if c != source["git_commit"]]
    return _record(config, folder, result, training, source, sha, segments.spent)


def _start(config: RunConfig, folder: Path, sha: str, commit: str) -> Checkpoint:
    """Return the run's checkpoint, or an empty one; the present commit joins it."""
    path = folder / CHECKPOINT
    found = Checkpoint.load(path, config, sha) if path.exists() else Checkpoint.start(config, sha)
    return dataclasses.replace(found, commits=tuple(dict.fromkeys([*found.commits, commit])))


def _training(config: RunConfig, segments: Segments) -> dict[str, Any]:
    disc_rewards = segments.curve[:, curve.COLUMNS.index("disc_reward")]
    disc_rewards = disc_rewards[~np.isnan(disc_rewards)]
    return {
        "n_steps": config.budget.n_steps,
        "steps_per_s": config.budget.n_steps / segments.spent["wall_time_s"],
        "disc_reward_last": float(disc_rewards[-1]) if len(disc_rewards) else None,
    }


def _write_outcome(folder: Path, model: PPO, values: np.ndarray, run_id: str) -> None:
    from silem.algorithms import SILEM
    from silem.algorithms.networks import AffineTransform

    files.write_text(folder / CURVE, curve.to_csv(values))
    model.export_policy(folder / POLICY, run_id=run_id)
    if isinstance(model, SILEM) and isinstance(model.transform_net, AffineTransform):
        transform = model.transform_net
        arrays = {"A": transform.scale, "b": transform.offset}
        files.write_npz(
            folder / TRANSFORM,
            {name: value.detach().cpu().numpy() for name, value in arrays.items()},
        )


def _record(
    config: RunConfig,
    folder: Path,
    result: Evaluation,
    training: dict[str, Any],
    source: dict[str, Any],
    demonstrations_sha256: str | None,
    spent: dict[str, Any],
) -> RunRecord:
    """Publish the run where its budget says so; the records themselves are written last."""
    (folder / PROGRESS).unlink(missing_ok=True)
    names = [name for name in (CURVE, POLICY, TRANSFORM) if (folder / name).exists()]
    record = RunRecord(
        run_id=config.run_id,
        status="finished",
        config=config.to_dict(),
        evaluation=result.to_dict(),
        training=training,
        provenance=source,
        demonstrations_sha256=demonstrations_sha256,
        **spent,
        files={name: files.sha256(folder / name) for name in names},
        folder=folder,
    )
    if config.budget.is_evidence:
        published = paths.results_dir(config.study) / config.run_id
        for name in names:
            files.write_bytes(published / name, (folder / name).read_bytes())
        record.save(published)
    record.save(folder)
    return record


def load_demonstrations(config: RunConfig) -> tuple[Demonstrations | None, str | None]:
    """Return a run's demonstrations and their file's SHA-256, or None twice for no imitator.

    Raises:
        SilemError: They are missing, damaged or not those in the manifest; the message says how to
            make them.
    """
    if not config.demonstrations:
        return None, None
    path = demos.file_of(config.demonstrations)
    if not path.exists():
        check_made_by_an_expert(config.demonstrations)
        raise SilemError(
            f"there are no demonstrations of {config.demonstrations} ({path}); train its expert"
            f" with `python -m silem run --body {config.demonstrations} --method ppo`, then record"
            f" it with `python -m silem demonstrations --body {config.demonstrations}` (both take"
            " --budget)"
        )
    return demos.load_published(config.demonstrations)


def check_made_by_an_expert(demonstrations: str) -> None:
    """Raise SilemError, saying how they are made, unless an expert makes these demonstrations."""
    if demonstrations not in bodies.names():
        path = demos.file_of(demonstrations)
        raise SilemError(f"{path} is not there or not whole; `python -m silem mocap` makes it")
