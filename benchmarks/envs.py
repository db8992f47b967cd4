"""Simulation speed: raw PyBullet, our environments and the public package's, in one table.

`python -m benchmarks.envs` runs all contenders in turn, many times over, on random actions. The
time is the processor's, so that what else runs on the machine matters less. Every repetition
starts from a reset, which is not timed, and is short enough for bodies to stay on their feet.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import gymnasium
import numpy as np
import pybullet
from tqdm import tqdm

from silem import bodies
from silem.envs import BulletEnv, BulletVecEnv
from silem.envs.bullet import start_angles
from silem.envs.simulator import Simulator

PEERS = {"HC0": "HalfCheetahBulletEnv-v0", "Ant0": "AntBulletEnv-v0"}
TARGET_TIMES_PEER = 2.3
TARGET_SHARE_OF_RAW = 0.80
_STEPS = 100  # per client and repetition: 1.65 s of simulated time


@dataclass
class Contender:
    """Something that steps a body.

    Attributes:
        name: Of its row in the table.
        n_clients: Number of PyBullet clients it steps in turn.
        reset: Starts an episode.
        run: Steps through (steps, clients, A) actions.
        rates: Steps of one client per second of processor time, one per repetition.
    """

    name: str
    n_clients: int
    reset: Callable[[], object]
    run: Callable[[np.ndarray], None]
    rates: list[float] = field(default_factory=list)

    @property
    def best(self) -> float:
        """Fastest repetition."""
        return max(self.rates)

    @property
    def median(self) -> float:
        """Median repetition."""
        return float(np.median(self.rates))


def raw(body: str, n_clients: int) -> Contender:
    """PyBullet alone: torques set and the simulation stepped, nothing read."""
    simulators = [Simulator(bodies.get(body)) for _ in range(n_clients)]
    torques = np.array([motor.torque_n_m for motor in bodies.get(body).motors])
    rng = np.random.default_rng(0)

    def reset() -> None:
        for simulator in simulators:
            simulator.reset(start_angles(rng, simulator.body))

    def run(actions: np.ndarray) -> None:
        control, simulate = pybullet.setJointMotorControlArray, pybullet.stepSimulation
        mode = pybullet.TORQUE_CONTROL
        clients = [(sim.robot, sim.joints, sim.client) for sim in simulators]
        for step in (actions * torques).tolist():
            for (robot, joints, client), forces in zip(clients, step, strict=True):
                control(robot, joints, mode, forces=forces, physicsClientId=client)
                simulate(client)

    return Contender("raw stepSimulation", n_clients, reset, run)


def vectorised(body: str, n_clients: int) -> Contender:
    """Our batched environment."""
    env = BulletVecEnv(body, n_clients)

    def run(actions: np.ndarray) -> None:
        for step in actions:
            env.step(step)

    return Contender("silem.make_vec", n_clients, env.reset, run)


def single(name: str, env: gymnasium.Env) -> Contender:  # type: ignore[type-arg]
    """Any Gymnasium environment."""

    def run(actions: np.ndarray) -> None:
        for step in actions[:, 0]:
            env.step(step)

    return Contender(name, 1, env.reset, run)


def contenders(body: str, clients: Sequence[int]) -> list[Contender]:
    """Return all that step a body: raw and batched for each number of clients, then singles."""
    import pybullet_envs_gymnasium  # noqa: F401, PLC0415  registers the public environments

    with _silence():
        peer = gymnasium.make(PEERS[body], disable_env_checker=True).unwrapped
        peer.reset(seed=0)
    pairs = [make(body, n) for n in clients for make in (raw, vectorised)]
    return [
        *pairs,
        single(f"gymnasium silem/{body}-v0", BulletEnv(body)),
        single(f"gymnasium {PEERS[body]}", peer),
    ]


def measure(body: str, clients: Sequence[int], repetitions: int) -> list[Contender]:
    """Time all contenders in turn, `repetitions` times."""
    entrants = contenders(body, clients)
    n_actions = len(bodies.get(body).motors)
    rng = np.random.default_rng(0)
    with tqdm(total=repetitions * len(entrants), desc=body, file=sys.stderr) as progress:
        for _ in range(repetitions):
            for entrant in entrants:
                shape = (_STEPS, entrant.n_clients, n_actions)
                actions = rng.uniform(-1, 1, shape).astype(np.float32)
                entrant.reset()
                start = time.process_time()
                entrant.run(actions)
                seconds = time.process_time() - start
                entrant.rates.append(_STEPS * entrant.n_clients / seconds)
                progress.update()
    return entrants


def table(body: str, entrants: Sequence[Contender]) -> str:
    """Return the rows of one body: rates, and medians as shares of raw and of the peer."""
    peer = entrants[-1]
    raw_rates = {e.n_clients: e for e in entrants if e.name.startswith("raw")}
    rows = []
    for entrant in entrants:
        base = raw_rates.get(entrant.n_clients)
        share = f"{entrant.median / base.median:10.0%}" if base else f"{'':10}"
        rows.append(
            f"{body:5} {entrant.name:36} {entrant.n_clients:7} {entrant.best:9,.0f} "
            f"{entrant.median:9,.0f} {share} {entrant.median / peer.median:9.2f}"
        )
    return "\n".join(rows)


def verdict(body: str, entrants: Sequence[Contender]) -> str:
    """Say whether our batched environment reaches its targets at its best number of clients."""
    peer = entrants[-1].median
    pairs = list(zip(entrants[:-2:2], entrants[1:-2:2], strict=True))
    share, times, n = max(
        (ours.median / r.median, ours.median / peer, r.n_clients) for r, ours in pairs
    )
    reached = share >= TARGET_SHARE_OF_RAW and times >= TARGET_TIMES_PEER
    return (
        f"{body}, {n} clients: {share:.0%} of raw (target {TARGET_SHARE_OF_RAW:.0%}), "
        f"{times:.2f} x the public package (target {TARGET_TIMES_PEER}): "
        f"{'reached' if reached else 'not reached'}"
    )


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
    parser.add_argument("--clients", nargs="+", type=int, default=[1, 4, 8, 16])
    parser.add_argument("--repetitions", type=int, default=15)
    options = parser.parse_args(arguments)
    results = {body: measure(body, options.clients, options.repetitions) for body in options.bodies}
    print(
        f"{'body':5} {'what':36} {'clients':>7} {'best':>9} {'median':>9} {'of raw':>10} {'x peer':>9}"
    )
    for body, entrants in results.items():
        print(table(body, entrants))
    print("Rates: steps of one client per second of processor time. Shares: of medians.")
    for body, entrants in results.items():
        print(verdict(body, entrants))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
