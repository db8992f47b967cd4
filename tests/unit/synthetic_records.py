"""Made-up records in the true format, for tests of everything that reads records."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from silem import bodies
from silem.algorithms import PPO
from silem.envs import make_vec
from silem.motion.features import FEATURES
from silem.study.config import RunConfig
from silem.study.runs import MAX_ROWS, POLICY, RunRecord, curve_csv, curve_row
from silem.study.studies import study_configs
from silem.study.training import settings
from silem.util import files, paths

HUMANOIDS = ("Humanoid", "HumanoidR", "Atlas")
EXPERT_RETURNS = {"HC0": 2450.0, "HC1": 1500.0, "HC2": 820.0}
EXPERT_RETURNS |= {"Humanoid": 860.0, "HumanoidR": 840.0, "Atlas": 700.0}
RANDOM_RETURNS = {"HC0": -1555.0, "HC1": -1480.0, "HC2": -1600.0}
RANDOM_RETURNS |= dict.fromkeys(HUMANOIDS, 4.0)
NORMALISED = {
    ("silem", "HC0"): 0.93,
    ("silem", "HC1"): 0.81,
    ("silem", "HC2"): 0.70,
    ("silem-minus", "HC0"): 0.95,
    ("silem-minus", "HC1"): 0.32,
    ("silem-minus", "HC2"): -0.35,
    ("silem-minus-own", "HC0"): 0.96,
    ("silem-minus-own", "HC1"): 0.94,
    ("silem-minus-own", "HC2"): 0.90,
    ("silem-mlp", "HC0"): -0.80,
}
for _method, _levels in {
    "silem": (0.9, 0.9, 0.9),
    "silem-minus": (0.4, 0.3, 0.7),
    "tpil": (0.2, 0.1, 0.6),
    "peng20": (0.3, 0.2, 0.7),
}.items():
    NORMALISED |= {(_method, body): level for body, level in zip(HUMANOIDS, _levels, strict=True)}
ANTS = bodies.names("ant")
for _i, _body in enumerate(ANTS):
    EXPERT_RETURNS[_body], RANDOM_RETURNS[_body] = 2900.0 - 80 * _i, 40.0
    NORMALISED["silem", _body] = 0.95 - 0.01 * _i
    NORMALISED["silem-minus", _body] = 0.95 - 0.13 * _i
    NORMALISED["silem-minus-own", _body] = 0.95
N_FEATURES = {"halfcheetah": 26, "ant": 28, "humanoid": len(FEATURES)}
LONGEST_RETURN = 1500.0
"""From this return on a made-up Ant's episodes last to their end."""


def typical_return(config: RunConfig) -> float:
    """The return that a made-up cell is centred on."""
    if config.method == "random":
        return RANDOM_RETURNS[config.body]
    level = 1.0 if config.method == "ppo" else NORMALISED[config.method, config.body]
    return level * EXPERT_RETURNS[config.body]


def write_record(
    config: RunConfig,
    return_mean: float | None = None,
    disc_reward: float | None = 430.0,
    commit: str = "0123456789abcdef0123456789abcdef01234567",
    folder: Path | None = None,
    processor_time_s: float | None = None,
) -> RunRecord:
    """Write one made-up run's folder as a finished run leaves it, and return its record."""
    rng = np.random.default_rng([config.seed, len(config.run_id), ord(config.run_id[-1])])
    walks = bodies.get(config.body).family == "humanoid"
    if return_mean is None:
        noise = 70.0 * rng.normal()
        return_mean = typical_return(config) + (noise if not walks else 0.3 * noise)
    folder = folder or paths.results_dir(config.study) / config.run_id
    imitates = bool(config.demonstrations)
    returns = return_mean + (5.0 if walks else 30.0) * rng.normal(
        size=config.budget.n_eval_episodes
    )
    written = {}
    if config.method != "random":
        files.write_text(folder / "curve.csv", _curve(config, return_mean, rng))
        written["curve.csv"] = files.sha256(folder / "curve.csv")
        policy = {"mean": np.zeros(1, np.float32)}
        files.write_tensors(folder / "policy.safetensors", policy, {"run_id": config.run_id})
        written["policy.safetensors"] = files.sha256(folder / "policy.safetensors")
    if config.transform == "affine":
        arrays = _humanoid_transform(config, rng) if walks else _runner_transform(config, rng)
        files.write_npz(folder / "transform.npz", arrays)
        written["transform.npz"] = files.sha256(folder / "transform.npz")
    record = RunRecord(
        run_id=config.run_id,
        status="finished",
        config=config.to_dict(),
        evaluation={
            "n_episodes": len(returns),
            "return_mean": float(returns.mean()),
            "return_std": float(returns.std()),
            "returns": [round(float(value), 3) for value in returns],
            **_gait(return_mean, config.body),
            "disc_reward_mean": disc_reward if imitates else None,
        },
        training={
            "n_steps": 0 if config.method == "random" else config.budget.n_steps,
            "steps_per_s": None if config.method == "random" else 2400.0,
        },
        provenance={
            "git_commit": commit,
            "git_dirty": False,
            "packages": {},
            "python": "3.11",
            "earlier_commits": [],
        },
        demonstrations_sha256="0" * 64 if imitates else None,
        wall_time_s=0.0 if config.method == "random" else 420.0,
        files=written,
        folder=folder,
        processor_time_s=processor_time_s,
    )
    record.save(folder)
    return record


def write_study(
    budget: str = "book",
    n_trials: int | None = None,
    without: Mapping[tuple[str, str], int] | None = None,
    study: str = "halfcheetah",
) -> list[RunRecord]:
    """Write a whole made-up study.

    Args:
        budget: The budget.
        n_trials: Trials per cell.
        without: (method, body) -> how many trials of that cell there are, where fewer.
        study: The study.
    """
    kept = []
    for config in study_configs(study, budget, n_trials):
        limit = (without or {}).get((config.method, config.body))
        if limit is None or config.seed < limit:
            disc_reward = 466.0 if config.method == "silem-mlp" else 430.0
            kept.append(write_record(config, disc_reward=disc_reward + 5 * config.seed))
    return kept


def _gait(return_mean: float, body: str) -> dict[str, float]:
    """How a body moves that earns a return; records of HalfCheetahs are of before steps counted."""
    if body in HUMANOIDS:
        share = float(np.clip(return_mean / 850, 0.02, 1))
        return {"speed_m_s": 1.6 * share, "upright": min(1.0, 1.1 * share)}
    if body in ANTS:
        steps = 1000 * float(np.clip(return_mean / LONGEST_RETURN, 0.03, 1))
        return {"speed_m_s": return_mean / 1200, "upright": 1 - 1 / steps, "steps_mean": steps}
    upright = float(np.clip(0.5 + return_mean / 4000, 0, 1))
    return {"speed_m_s": max(0.02, 2.4 * (return_mean + 200) / 2600), "upright": upright}


def _runner_transform(config: RunConfig, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """A transform that strays from the identity with a length; Ants' forward velocity tracks it."""
    longer, body = int(config.body[-1]), bodies.get(config.body)
    n, tracks = body.observation_size, body.family == "ant"
    spread = 0.3 if tracks else longer
    arrays = {"A": 1 + 0.12 * spread * rng.normal(size=n), "b": 0.08 * spread * rng.normal(size=n)}
    if tracks:
        arrays["A"][3] += 0.1 * longer
    count = config.hyper.transform_components
    if count > 1:  # an ensemble's maps and gate, which no figure reads
        several = 1 + 0.1 * rng.normal(size=(count, n))
        maps = dict.fromkeys(("scale", "offset", "gate.weight"), several)
        arrays |= maps | dict.fromkeys(("gate.bias", "shares"), np.ones(count))
    return arrays


def _humanoid_transform(config: RunConfig, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """The paper's finding: HumanoidR's short left arm scaled up, its long right arm down."""
    n = N_FEATURES["humanoid"]
    arrays = {"A": 1 + 0.02 * rng.normal(size=n), "b": 0.02 * rng.normal(size=n)}
    if config.body == "HumanoidR":
        for index, feature in enumerate(FEATURES):
            side = {"left": 1.0, "right": -1.0}.get(feature.name.partition("_")[0], 0.0)
            if "hand" in feature.name:
                arrays["A"][index] += 0.4 * side
            if "elbow" in feature.name:
                arrays["b"][index] -= 0.3 * side
    return arrays


def _curve(config: RunConfig, return_mean: float, rng: np.random.Generator) -> str:
    """A curve that rises from the random policy's return to the run's own."""
    walks = bodies.get(config.body).family == "humanoid"
    n = config.budget.n_iterations
    share = 1 - np.exp(-5 * np.arange(1, n + 1) / n)
    start = RANDOM_RETURNS.get(config.body, -1500.0)
    returns = start + share * (return_mean - start) + 60 * rng.normal(size=n)
    size, rows = max(1, -(-n // MAX_ROWS)), []  # as many rows as are kept
    for i in range(size - 1, n, size):
        stats = {"policy_std": 1 - 0.8 * share[i]}
        if size > 3 or i % 4 == 3:  # an episode ends only now and then
            stats |= {"return_mean": returns[i], "speed_m_s": max(0, 2.4 * returns[i] / 2600)}
            if config.body in ANTS:
                stats |= {"episode_length": 30 + 970 * share[i]}
            if walks:
                stats |= {"speed_m_s": returns[i] / 530, "episode_length": 20 + 980 * share[i]}
        if config.demonstrations:
            stats |= {"disc_reward": abs(450 * share[i] + 12 * rng.normal()), "disc_loss": 1.2}
        rows.append(curve_row(i + 1, (i + 1) * config.budget.steps_per_iteration, stats))
    return curve_csv(np.array(rows))


def study(case: str) -> pytest.MarkDecorator:
    """Let a test meet one of its module's studies (see the fixture `frame`)."""
    return pytest.mark.parametrize("frame", [case], indirect=True)


def with_policy(record: RunRecord) -> RunRecord:
    """Give a made-up record an untrained policy."""
    config = record.run_config
    env = make_vec(config.body, n_envs=1)
    model = PPO("MlpPolicy", env, **settings(config.body, "ppo"))
    env.close()
    path = record.folder / POLICY
    model.export_policy(path, run_id=record.run_id)
    complete = dataclasses.replace(record, files=record.files | {POLICY: files.sha256(path)})
    complete.save(record.folder)
    return complete
