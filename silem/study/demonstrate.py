"""Recording an expert's run as the demonstrations that imitators learn from."""

from __future__ import annotations

from pathlib import Path

from silem.motion import demonstrations as demos
from silem.study.evaluate import record_episodes
from silem.study.policies import load_policy
from silem.study.record import RunRecord
from silem.util.errors import SilemError


def demonstrate(
    record: RunRecord, n_trajectories: int = 20, *, force: bool = False, progress: bool = False
) -> Path:
    """Record state-only demonstrations of a finished run's stochastic policy and publish them.

    Args:
        record: The expert's run.
        n_trajectories: How many episodes.
        force: Replace demonstrations that another run made.
        progress: Show a progress bar.

    Returns:
        The file, named after the expert's body.

    Raises:
        SilemError: The run is no expert's, or there are demonstrations of this body by another
            run already.
    """
    body = record.config["body"]
    if record.config["method"] != "ppo":
        raise SilemError(f"{record.run_id} is no expert's run (its method is not ppo)")
    if n_trajectories < 1:
        raise SilemError(f"demonstrations need 1 trajectory or more, not {n_trajectories}")
    path = demos.file_of(body)
    with demos.publishing():
        if path.exists() and not force:
            there = demos.Demonstrations.load(body)
            if there.expert_run_id == record.run_id and len(there.features) == n_trajectories:
                return path if demos.is_published(body) else demos.publish(body, there)
            raise SilemError(
                f"{path} holds {len(there.features)} trajectories of"
                f" {there.expert_run_id or 'another expert'} already; --force replaces them"
            )
        policy = load_policy(record)
        recorded = record_episodes(
            policy, body, n_trajectories, run_id=record.run_id, progress=progress
        )
        return demos.publish(body, recorded)
