"""Simulation speed: raw PyBullet, our environments and the public package's, in one table.

`python -m benchmarks.envs` times all contenders in turn, many times over. Within a repetition all
get the same actions, and raw PyBullet and our batched environment also the same start, so the same
physics. The time is the processor's, and shares are medians of the repetitions' own, so what else
runs on the machine matters little.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import gymnasium
import numpy as np
import pybullet
from tqdm import tqdm

from silem import bodies
from silem.envs import BulletEnv, BulletVecEnv

PEERS = {"HC0": "HalfCheetahBulletEnv-v0", "Ant0": "AntBulletEnv-v0"}
TARGET_TIMES_PEER = 2.3
TARGET_SHARE_OF_RAW = 0.80
_STEPS = 200  # per client and repetition: 3.3 s of simulated time


class Contender(Protocol):
    """Something that steps a body."""

    def reset(self, seed: int) -> None:
        """Start an episode."""

    def run(self, actions: np.ndarray) -> None:
        """Step through (T, E, A) actions."""


class Batched:
    """Our batched environment."""

    def __init__(self, body: str, n_clients: int) -> None:
        """Make the environments."""
        self.env = BulletVecEnv(body, n_clients)

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self.env.seed(seed)
        self.env.reset()

    def run(self, actions: np.ndarray) -> None:
        """Step through (T, E, A) actions."""
        step = self.env.step
        for action in actions:
            step(action)


class Raw(Batched):
    """PyBullet alone, on the same clients: torques set, simulation stepped, nothing read."""

    def run(self, actions: np.ndarray) -> None:
        """Step through (T, E, A) actions."""
        control, simulate = pybullet.setJointMotorControlArray, pybullet.stepSimulation
        mode = pybullet.TORQUE_CONTROL
        strengths = [motor.torque_n_m for motor in self.env.body.motors]
        clients = [(sim.robot, sim.joints, sim.client) for sim in self.env.simulators]
        for torques in (actions * strengths).tolist():
            for (robot, joints, client), forces in zip(clients, torques, strict=True):
                control(robot, joints, mode, forces=forces, physicsClientId=client)
                simulate(client)


class Single:
    """Any Gymnasium environment."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        """Keep the environment."""
        self.env = env

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self.env.reset(seed=seed)

    def run(self, actions: np.ndarray) -> None:
        """Step through (T, 1, A) actions."""
        step = self.env.step
        for action in actions[:, 0]:
            step(action)


@dataclass
class Row:
    """One row of the table.

    Attributes:
        name: What was timed.
        n_clients: Number of PyBullet clients stepped in turn.
        contender: Steps them.
        rates: (N,) steps of one client per second of processor time, one per repetition.
    """

    name: str
    n_clients: int
    contender: Contender
    rates: list[float] = field(default_factory=list)

    def times(self, other: Row) -> float:
        """Median over repetitions of this row's rate over the other's."""
        return float(np.median(np.divide(self.rates, other.rates)))


@dataclass
class Measurement:
    """All rows of one body: a raw and a batched one per number of clients, and two single ones."""

    body: str
    raw: list[Row]
    batched: list[Row]
    single: Row
    peer: Row

    @classmethod
    def prepare(cls, body: str, clients: Sequence[int]) -> Measurement:
        """Make all contenders."""
        return cls(
            body,
            [Row("raw stepSimulation", n, Raw(body, n)) for n in clients],
            [Row("silem.make_vec", n, Batched(body, n)) for n in clients],
            Row(f"gymnasium silem/{body}-v0", 1, Single(BulletEnv(body))),
            Row(f"gymnasium {PEERS[body]}", 1, Single(_peer(body))),
        )

    @property
    def rows(self) -> list[Row]:
        """All rows, raw and batched alternating, so that they are timed one after the other."""
        pairs = [row for pair in zip(self.raw, self.batched, strict=True) for row in pair]
        return [*pairs, self.single, self.peer]

    def repeat(self, seed: int) -> None:
        """Time every row once."""
        n_actions = len(bodies.get(self.body).motors)
        rng = np.random.default_rng(seed)
        most = max(row.n_clients for row in self.rows)
        actions = rng.uniform(-1, 1, (_STEPS, most, n_actions)).astype(np.float32)
        for row in self.rows:
            row.contender.reset(seed)
            mine = np.ascontiguousarray(actions[:, : row.n_clients])
            start = time.process_time()
            row.contender.run(mine)
            seconds = time.process_time() - start
            row.rates.append(_STEPS * row.n_clients / seconds)

    def table(self) -> str:
        """Return the rows as text."""
        raw = {row.n_clients: row for row in self.raw}
        return "\n".join(
            f"{self.body:5} {row.name:34} {row.n_clients:7} {max(row.rates):9,.0f} "
            f"{np.median(row.rates):9,.0f} "
            + (f"{row.times(raw[row.n_clients]):9.1%} " if row.n_clients in raw else " " * 10)
            + f"{row.times(self.peer):9.2f}"
            for row in self.rows
        )

    def verdict(self) -> str:
        """Say how our batched environment stands against the targets, at its best."""
        pairs = zip(self.raw, self.batched, strict=True)
        share, n = max((ours.times(raw), raw.n_clients) for raw, ours in pairs)
        times, m = max((row.times(self.peer), row.n_clients) for row in self.batched)
        return (
            f"{self.body}: {share:.1%} of raw with {n} clients "
            f"(target {TARGET_SHARE_OF_RAW:.0%}: {_word(share >= TARGET_SHARE_OF_RAW)}), "
            f"{times:.2f} times the public package with {m} "
            f"(target {TARGET_TIMES_PEER}: {_word(times >= TARGET_TIMES_PEER)})"
        )


def _word(reached: bool) -> str:
    return "reached" if reached else "missed"


def _peer(body: str) -> gymnasium.Env[Any, Any]:
    """Make the public package's environment; its first reset builds it."""
    import pybullet_envs_gymnasium  # noqa: F401  registers its environments

    with _silence():
        env = gymnasium.make(PEERS[body], disable_env_checker=True).unwrapped
        env.reset(seed=0)
    return env


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Drop what PyBullet's C code writes to standard output while a client connects."""
    sys.stdout.flush()
    saved = os.dup(1)
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print the table and what it means, and return 0."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.envs", description=__doc__)
    parser.add_argument("--bodies", nargs="+", default=list(PEERS), choices=list(PEERS))
    parser.add_argument("--clients", nargs="+", type=int, default=[1, 4, 8])
    parser.add_argument("--repetitions", type=int, default=20)
    options = parser.parse_args(arguments)
    measurements = [Measurement.prepare(body, options.clients) for body in options.bodies]
    for seed in tqdm(range(options.repetitions), desc="repetitions"):
        for measurement in measurements:
            measurement.repeat(seed)
    head = "".join(f"{title:>10}" for title in ("best", "median", "of raw", "x peer"))
    print(f"{'body':5} {'what':34} clients{head}")
    for measurement in measurements:
        print(measurement.table())
    print("Rates: steps of one client per second of processor time.")
    for measurement in measurements:
        print(measurement.verdict())
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
