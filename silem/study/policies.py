"""Policies of finished runs, ready to be rolled out again."""

from __future__ import annotations

from silem.study.evaluate import Policy, random_policy
from silem.study.record import POLICY, RunRecord
from silem.study.training import make_env, make_policy_model
from silem.util import files


def load_policy(record: RunRecord) -> Policy:
    """Return a finished run's policy, ready to `predict`.

    Raises:
        SilemError: The policy's file is missing or not the recorded one.
    """
    config = record.run_config()
    if config.method == "random":
        return random_policy(config.learner, config.seed, config.hyper.action_std)
    arrays, _ = files.read_tensors(record.file(POLICY))
    env = make_env(config)
    try:
        model = make_policy_model(config, env)
    finally:
        env.close()
    model.load_policy_arrays(arrays)
    return model
