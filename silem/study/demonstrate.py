"""A body's demonstrator, by a rule, its recording as what imitators learn from, and its gait."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from silem import bodies
from silem.bodies import BulletBody
from silem.bodies.body import AT_LIMIT, VELOCITY_SCALE
from silem.motion import demonstrations as demos
from silem.motion.demonstrations import Demonstrations
from silem.study import runs
from silem.study.config import TRIAL_SEEDS, RunConfig
from silem.study.runs import RunRecord
from silem.study.settings import Budget, budget_named
from silem.study.studies import STUDIES
from silem.util.errors import SilemError

_FORWARD, _PITCH, _FIRST_ANGLE = 3, 7, 8  # columns of `silem.envs.bullet.LocomotionTask`


def experts(body: str, budget: str | Budget, trial: int | None = None) -> list[RunConfig]:
    """Return a body's experts, PPO with the true reward: every trial's configuration, or one's.

    Those of its family's study; of a body that its name describes, of the first that plans them.
    """
    cells = (cell for known in STUDIES.values() for cell in known.cells)
    plans = [cell.study for cell in cells if (cell.method, cell.body) == ("ppo", body)]
    study = plans[0] if plans and body not in bodies.names() else None
    trials = STUDIES[study].seeds if study else TRIAL_SEEDS
    seeds = trials[: budget_named(budget).n_trials] if trial is None else (trial,)
    return [RunConfig.create(body, "ppo", None, budget, seed, study) for seed in seeds]


def demonstrator(body: str, budget: str | Budget, trial: int | None = None) -> RunRecord:
    """Return a body's demonstrator: the expert with the highest return among all its trials.

    "Running as fast as possible" (Section V) is a choice among policies; this is the rule for it,
    the same for every body. Returns are those of the finished runs' evaluations. A `trial` is one
    expert, whichever it is. Raises SilemError: not all of these trials are finished; the message
    names the next.
    """
    configs = experts(body, budget, trial)
    found = [runs.find(config.run_id) for config in configs]
    missing = [config for config, record in zip(configs, found, strict=True) if record is None]
    if missing:
        raise SilemError(
            f"the demonstrator of {body} is the best of {len(found)} experts, of which"
            f" {len(missing)} are not finished; next: {missing[0].command}"
        )
    records = [record for record in found if record is not None]
    return max(records, key=lambda record: float(record.evaluation["return_mean"]))


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
    """Record and publish state-only demonstrations of a finished run's stochastic policy.

    Failed episodes stay in; the manifest says how many, and a runner's `Gait`. Imitators find the
    file, which is returned, by `name`; None means the expert's body, whose demonstrator it then is.
    Raises SilemError: the run is no expert's, or another's are there already, and no `force`.
    """
    from silem.study.evaluate import load_policy, record_episodes

    body = record.config["body"]
    name = body if name is None else name
    if record.config["method"] != "ppo":
        raise SilemError(f"{record.run_id} is no expert's run (its method is not ppo)")
    if n_trajectories < 1:
        raise SilemError(f"demonstrations need 1 trajectory or more, not {n_trajectories}")
    path = demos.file_of(name)
    with demos.publishing():
        if path.exists() and not force:
            there = Demonstrations.load(name)
            n, whose = len(there.features), there.expert_run_id or "another expert"
            if whose != record.run_id or n != n_trajectories:
                told = f"{path} holds {n} trajectories of {whose} already"
                raise SilemError(f"{told}; {runs.instead_of(path)}")
            if demos.is_published(name):
                return path
        else:
            there = record_episodes(
                load_policy(record), body, n_trajectories, run_id=record.run_id, progress=progress
            )
        runner = isinstance(bodies.get(body), BulletBody)
        return demos.publish(name, there, gait(there)._asdict() if runner else None)


def describe(name: str) -> str:
    """Say in one line what the manifest knows of demonstrations that an expert made."""
    about = demos.entry(name)
    text = "{n_trajectories} trajectories of {expert_run_id}, return {return_mean:.0f}"
    text += " ± {return_std:.0f}"
    if "pitch_rad" in about:
        text += ", worst {return_worst:.0f}, failed and kept: {n_failed}; {speed_m_s:.2f} m/s,"
        text += (
            " pitch {pitch_rad:.2f} ± {pitch_std_rad:.2f} rad, a joint at a limit {limit_share:.0%}"
        )
        text += " of the time"
    return text.format(**about)


class Gait(NamedTuple):
    """How a runner moves, by its features, and what the manifest says of an expert's returns."""

    speed_m_s: float
    pitch_rad: float  # mean over all states; positive is nose down
    pitch_std_rad: float
    limit_share: float  # of the states, those with any joint at its limit
    joints_at_limit: float  # mean number of joints at their limits, which the task charges
    return_worst: float | None  # None where the returns are unknown
    n_failed: int | None  # episodes, none of which is left out


def gait(demonstrations: Demonstrations) -> Gait:
    """Measure the gait of a runner's demonstrations over all states; SilemError for others."""
    states = np.concatenate(demonstrations.features)
    at_limits = joints_at_limit(states, demonstrations.body)
    pitch = pitch_rad(states)
    returns = np.array(demonstrations.returns)
    return Gait(
        speed_m_s=float(states[:, _FORWARD].mean(dtype=np.float64)) / VELOCITY_SCALE,
        pitch_rad=float(pitch.mean()),
        pitch_std_rad=float(pitch.std()),
        limit_share=float((at_limits > 0).mean()),
        joints_at_limit=float(at_limits.mean()),
        return_worst=float(returns.min()) if len(returns) else None,
        n_failed=int(failed(returns).sum()) if len(returns) else None,
    )


def pitch_rad(features: np.ndarray) -> np.ndarray:
    """Return the torso's pitch of every state, (..., F) to (...); positive is nose down."""
    return np.asarray(features[..., _PITCH], dtype=np.float64)


def joints_at_limit(features: np.ndarray, body: str) -> np.ndarray:
    """Count the joints at their limits in a runner's every state, (..., F) to (...)."""
    found = bodies.get(body)
    if not isinstance(found, BulletBody):
        raise SilemError(f"a gait is measured on HalfCheetahs and Ants, not on {body}")
    if features.shape[-1] != found.observation_size:
        raise SilemError(f"{features.shape[-1]} features, {body} has {found.observation_size}")
    angles = features[..., _FIRST_ANGLE : _FIRST_ANGLE + 2 * len(found.motors) : 2]
    return np.asarray((np.abs(angles) > AT_LIMIT).sum(axis=-1))


def failed(returns: np.ndarray) -> np.ndarray:
    """Tell of every episode, (N,), whether it returns less than half of what the median does."""
    median = float(np.median(returns))
    return np.asarray(returns < median - abs(median) / 2)
