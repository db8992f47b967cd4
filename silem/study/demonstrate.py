"""The demonstrator of a body, by a rule, and its recording as what imitators learn from."""

from __future__ import annotations

from pathlib import Path

from silem import bodies
from silem.bodies import BulletBody
from silem.motion import demonstrations as demos
from silem.study import gait, runs
from silem.study.config import TRIAL_SEEDS, RunConfig
from silem.study.record import RunRecord
from silem.study.settings import Budget
from silem.util import paths
from silem.util.errors import SilemError


def experts(body: str, budget: str | Budget) -> list[RunConfig]:
    """Return the configurations of a body's experts: every trial of PPO with the true reward."""
    first = RunConfig.create(body, "ppo", None, budget, TRIAL_SEEDS[0])
    seeds = TRIAL_SEEDS[: first.budget.n_trials]
    return [first, *(RunConfig.create(body, "ppo", None, budget, seed) for seed in seeds[1:])]


def demonstrator(body: str, budget: str | Budget) -> RunRecord:
    """Return a body's demonstrator: the expert with the highest return among all its trials.

    "Running as fast as possible" (Section V) is a choice among policies; this is the rule for it,
    the same for every body. Returns are those of the finished runs' evaluations.

    Raises:
        SilemError: Not all of the budget's trials are finished; the message names the next.
    """
    configs = experts(body, budget)
    found = [runs.find(config.run_id) for config in configs]
    missing = [config for config, record in zip(configs, found, strict=True) if record is None]
    if missing:
        raise SilemError(
            f"the demonstrator of {body} is the best of {len(configs)} experts, of which"
            f" {len(missing)} are not finished; next: {missing[0].command}"
        )
    records = [record for record in found if record is not None]
    return max(records, key=lambda record: float(record.evaluation["return_mean"]))


def expert_of(name: str) -> tuple[str, int | None]:
    """Return the body and the trial that demonstrations are of: ("HC0", 3) for "HC0_s3".

    The trial of "HC0" is None: its demonstrator's, whichever that is.
    """
    body, separator, trial = name.rpartition("_s")
    return (body, int(trial)) if separator and trial.isdecimal() else (name, None)


def trial_name(record: RunRecord) -> str:
    """Return the name of one trial's own demonstrations: "HC0_s3"."""
    return f"{record.config['body']}_s{record.config['seed']}"


def demonstrate(
    record: RunRecord,
    n_trajectories: int = 20,
    *,
    name: str | None = None,
    force: bool = False,
    progress: bool = False,
) -> Path:
    """Record state-only demonstrations of a finished run's stochastic policy and publish them.

    Failed episodes stay in; the manifest says how many, and how a runner moves
    (`silem.study.gait`).

    Args:
        record: The expert's run.
        n_trajectories: How many episodes.
        name: What imitators find them by; None means the expert's body, whose demonstrator it
            then is.
        force: Replace demonstrations that another run made.
        progress: Show a progress bar.

    Returns:
        The file, named ``name``.

    Raises:
        SilemError: The run is no expert's, or there are demonstrations of this name by another
            run already.
    """
    from silem.study.evaluate import record_episodes
    from silem.study.policies import load_policy

    body = record.config["body"]
    name = body if name is None else name
    if record.config["method"] != "ppo":
        raise SilemError(f"{record.run_id} is no expert's run (its method is not ppo)")
    if n_trajectories < 1:
        raise SilemError(f"demonstrations need 1 trajectory or more, not {n_trajectories}")
    path = demos.file_of(name)
    with demos.publishing():
        if path.exists() and not force:
            there = demos.Demonstrations.load(name)
            if there.expert_run_id != record.run_id or len(there.features) != n_trajectories:
                raise SilemError(
                    f"{path} holds {len(there.features)} trajectories of"
                    f" {there.expert_run_id or 'another expert'} already; {_instead(path)}"
                )
            if demos.is_published(name):
                return path
        else:
            policy = load_policy(record)
            there = record_episodes(
                policy, body, n_trajectories, run_id=record.run_id, progress=progress
            )
        runner = isinstance(bodies.get(body), BulletBody)
        return demos.publish(name, there, gait.measure(there)._asdict() if runner else None)


def _instead(path: Path) -> str:
    """Say what to do where there are demonstrations already."""
    root = paths.checkout()
    if root is not None and path.is_relative_to(root / "data"):  # the committed runs' own
        return "to record others, set SILEM_DATA_DIR to another folder for expert and recording"
    return "--force replaces them"


def describe(name: str) -> str:
    """Say in one line what the manifest knows of demonstrations that an expert made."""
    about = demos.entry(name)
    text = (
        f"{about['n_trajectories']} trajectories of {about['expert_run_id']}, return"
        f" {about['return_mean']:.0f} ± {about['return_std']:.0f}"
    )
    if "pitch_rad" in about:
        text += (
            f", worst {about['return_worst']:.0f}, failed and kept: {about['n_failed']};"
            f" {about['speed_m_s']:.2f} m/s, pitch {about['pitch_rad']:.2f} ±"
            f" {about['pitch_std_rad']:.2f} rad, a joint at its limit"
            f" {100 * about['limit_share']:.0f} % of the time"
        )
    return text
