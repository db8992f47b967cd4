"""Steps per second of training, against raw simulation and stable-baselines3, in one run.

Every contestant trains on HC0 with the paper's settings (2048 steps an iteration, 10 epochs of
minibatches of 64; SILEM with its best combination for HC0). They take turns, several rounds, so
that what else the machine does falls on all of them alike, and the time is the processor's; the
table gives medians.

    python -m benchmarks.training [--rounds 5] [--iterations 3]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import gymnasium
import numpy as np
import torch as th
from stable_baselines3 import PPO as SB3PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from tqdm import tqdm

import silem
from benchmarks.envs import Raw

BODY, N_ENVS, STEPS_PER_ITERATION = "HC0", 8, 2048
PPO_SETTINGS: dict[str, Any] = {
    "n_steps": STEPS_PER_ITERATION // N_ENVS,
    "batch_size": 64,
    "seed": 0,
}

Contestant = Callable[[int], float]  # trains so many iterations, returns seconds


def raw_simulation() -> Contestant:
    """Set torques and step as many PyBullet clients in turn, and do nothing else."""
    raw = Raw(BODY, N_ENVS)
    rng = np.random.default_rng(0)
    shape = (STEPS_PER_ITERATION // N_ENVS, N_ENVS, raw.env.body.action_size)

    def simulate(iterations: int) -> float:
        raw.reset(seed=0)
        start = time.process_time()
        for _ in range(iterations):
            raw.run(rng.uniform(-1.0, 1.0, shape))
        return time.process_time() - start

    return simulate


def learner(model: SB3PPO) -> Contestant:
    """Train a model; its first iteration, which builds the environments, is not timed."""
    model.learn(STEPS_PER_ITERATION)

    def train(iterations: int) -> float:
        start = time.process_time()
        model.learn(iterations * STEPS_PER_ITERATION, reset_num_timesteps=False)
        return time.process_time() - start

    return train


def public_env() -> VecEnv:
    """Return the public package's HalfCheetah, as many as ours."""
    import pybullet_envs_gymnasium  # noqa: F401  (registers the ids)

    return DummyVecEnv([lambda: gymnasium.make("HalfCheetahBulletEnv-v0")] * N_ENVS)


def contestants() -> dict[str, Contestant]:
    """Return everything that is timed, by name; the raw simulation first."""
    rng = np.random.default_rng(0)
    expert = [rng.standard_normal((1001, 26)).astype(np.float32) for _ in range(20)]
    ours: dict[str, Any] = {"env": silem.make_vec(BODY, N_ENVS), **PPO_SETTINGS}
    imitate: dict[str, Any] = {
        "env": silem.make_vec(BODY, N_ENVS),
        "demonstrations": expert,
        **PPO_SETTINGS,
    }
    theirs: dict[str, Any] = {"device": "cpu", **PPO_SETTINGS}
    return {
        "raw simulation": raw_simulation(),
        "our PPO": learner(silem.PPO("MlpPolicy", **ours)),
        "our SILEM-minus": learner(silem.SILEM("MlpPolicy", transform="identity", **imitate)),
        "our SILEM": learner(silem.SILEM("MlpPolicy", **imitate)),
        "our SILEM, gradient penalty": learner(
            silem.SILEM("MlpPolicy", gradient_penalty=1.0, **imitate)
        ),
        "SB3 PPO on our VecEnv": learner(
            SB3PPO("MlpPolicy", silem.make_vec(BODY, N_ENVS), **theirs)
        ),
        "SB3 PPO on the public env": learner(SB3PPO("MlpPolicy", public_env(), **theirs)),
    }


def main() -> None:
    """Time all contestants in turn and print one table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--iterations", type=int, default=3)
    args = parser.parse_args()
    th.set_num_threads(1)
    field = contestants()
    rates: dict[str, list[float]] = {name: [] for name in field}
    for _ in tqdm(range(args.rounds), desc="rounds"):
        for name, run in field.items():
            rates[name].append(args.iterations * STEPS_PER_ITERATION / run(args.iterations))
    medians = {name: median(values) for name, values in rates.items()}
    raw, public = medians["raw simulation"], medians["SB3 PPO on the public env"]
    print(f"{BODY}, {N_ENVS} clients, median of {args.rounds} rounds")
    print(f"{'':30}{'steps/s':>10}{'of raw':>10}{'x SB3 on public env':>22}")
    for name, rate in medians.items():
        print(f"{name:30}{rate:10.0f}{rate / raw:10.2f}{rate / public:22.2f}")


if __name__ == "__main__":
    main()
