"""Steps per second of training, against raw simulation and stable-baselines3, in one run.

Every contestant trains on one body with the `book` budget's counts and the paper's best
combinations of hyper-parameters, HC0 also with the gradient penalty that some combinations have.
They take turns, several rounds, so that what else the machine does falls on all of them alike,
and the time is the processor's; the table gives medians.

    python -m benchmarks.training [--body Humanoid] [--rounds 5] [--iterations 3]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from statistics import median
from time import process_time

import gymnasium
import numpy as np
import torch as th
from stable_baselines3 import PPO as SB3PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from tqdm import tqdm

import silem
from benchmarks import bullet, humanoids
from silem import bodies
from silem.envs import BatchedEnv
from silem.motion.demonstrations import Demonstrations
from silem.study.config import RunConfig
from silem.study.training import make_model

METHODS = {
    "HC0": ("ppo", "silem-minus", "silem"),
    "Humanoid": ("ppo", "silem-minus", "silem", "tpil"),
}
PUBLIC = "SB3 PPO on the public env"

Contestant = Callable[[int], float]  # trains so many iterations, returns seconds


def raw_simulation(config: RunConfig) -> Contestant:
    """Apply random actions to as many bodies in turn, and do nothing else."""
    budget = config.budget
    body = bodies.get(config.body)
    raw: bullet.Raw | humanoids.Raw
    if body.engine == "bullet":
        raw = bullet.Raw(BatchedEnv(body, budget.n_envs))
    else:
        raw = humanoids.Raw(config.body, budget.n_envs)
    rng = np.random.default_rng(0)
    shape = (budget.steps_per_iteration // budget.n_envs, budget.n_envs, body.action_size)

    def simulate(iterations: int) -> float:
        raw.reset(seed=0)
        start = process_time()
        for _ in range(iterations):
            raw.run(rng.uniform(-1.0, 1.0, shape))
        return process_time() - start

    return simulate


def learner(model: SB3PPO, n_steps: int) -> Contestant:
    """Train a model; its first iteration, which builds the environments, is not timed."""
    model.learn(n_steps)

    def train(iterations: int) -> float:
        start = process_time()
        model.learn(iterations * n_steps, reset_num_timesteps=False)
        return process_time() - start

    return train


def ours(config: RunConfig) -> Contestant:
    """Train by one of our methods."""
    demonstrations = None
    if config.demonstrations:
        demonstrations = Demonstrations.load(config.demonstrations)
    env = silem.make_vec(config.body, config.budget.n_envs)
    return learner(make_model(config, env, demonstrations), config.budget.steps_per_iteration)


def theirs(config: RunConfig, env: VecEnv) -> Contestant:
    """Train by stable-baselines3's PPO, with the same counts and networks."""
    budget, hyper = config.budget, config.hyper
    model = SB3PPO(
        "MlpPolicy",
        env,
        n_steps=budget.steps_per_iteration // budget.n_envs,
        batch_size=hyper.minibatch_size,
        n_epochs=hyper.n_epochs,
        policy_kwargs={"net_arch": list(hyper.policy_hidden)},
        seed=0,
        device="cpu",
    )
    return learner(model, budget.steps_per_iteration)


def public_env(n_envs: int) -> VecEnv:
    """Return the public package's HalfCheetah, as many as ours."""
    import pybullet_envs_gymnasium  # noqa: F401  (registers the ids)

    return DummyVecEnv([lambda: gymnasium.make("HalfCheetahBulletEnv-v0")] * n_envs)


def contestants(body: str) -> dict[str, Contestant]:
    """Return everything that is timed on a body, by name; the raw simulation first."""
    expert = RunConfig.create(body, "ppo", budget="book")
    n_envs = expert.budget.n_envs
    field = {"raw simulation": raw_simulation(expert)}
    for method in METHODS[body]:
        field[f"our {method}"] = ours(RunConfig.create(body, method, budget="book"))
    field["SB3 PPO on our VecEnv"] = theirs(expert, silem.make_vec(body, n_envs))
    if body == "HC0":
        penalised = RunConfig.create(body, "silem", budget="book", gradient_penalty=1.0)
        field["our silem, gradient penalty"] = ours(penalised)
        field[PUBLIC] = theirs(expert, public_env(n_envs))
    return field


def table(rates: dict[str, list[float]]) -> str:
    """Return medians of the contestants' rates as text."""
    medians = {name: median(values) for name, values in rates.items()}
    peer = PUBLIC if PUBLIC in medians else "SB3 PPO on our VecEnv"
    lines = [f"{'':30}{'steps/s':>10}{'of raw':>10}{'x ' + peer:>32}"]
    for name, rate in medians.items():
        of_raw, of_peer = rate / medians["raw simulation"], rate / medians[peer]
        lines.append(f"{name:30}{rate:10,.0f}{of_raw:10.2f}{of_peer:32.2f}")
    return "\n".join(lines)


def main() -> None:
    """Time all contestants in turn and print one table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--body", default="HC0", choices=list(METHODS))
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--iterations", type=int, default=3)
    args = parser.parse_args()
    th.set_num_threads(1)
    field = contestants(args.body)
    n_steps = RunConfig.create(args.body, "ppo", budget="book").budget.steps_per_iteration
    rates: dict[str, list[float]] = {name: [] for name in field}
    for _ in tqdm(range(args.rounds), desc="rounds"):
        for name, run in field.items():
            rates[name].append(args.iterations * n_steps / run(args.iterations))
    print(f"{args.body}, median of {args.rounds} rounds\n{table(rates)}")


if __name__ == "__main__":
    main()
