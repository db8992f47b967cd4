"""Policies of finished runs, ready to be rolled out again."""

from __future__ import annotations

from silem import algorithms
from silem.study.evaluate import Policy, random_policy
from silem.study.record import POLICY, RunRecord
from silem.study.training import unclipped


def load_policy(record: RunRecord) -> Policy:
    """Return a finished run's policy, ready to `predict`.

    Raises:
        SilemError: The policy's file is missing or not the recorded one.
    """
    config = record.run_config()
    if config.method == "random":
        return random_policy(config.learner, config.seed, config.hyper.action_std)
    policy = algorithms.load_policy(record.file(POLICY))
    if not config.hyper.clip_actions:
        policy.action_space = unclipped(policy.action_space)
    return policy
