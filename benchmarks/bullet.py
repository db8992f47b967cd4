"""PyBullet's bodies: raw PyBullet, our environments, the public package's.

Raw PyBullet and our batched environment start alike and get the same actions, so the same physics.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import pybullet

from benchmarks.measurement import Batched, Measurement, Row, Single
from silem.envs import BatchedEnv, SingleEnv
from silem.envs.bullet import Simulation
from silem.util.offscreen import silence

PEERS = {"HC0": "HalfCheetahBulletEnv-v0", "Ant0": "AntBulletEnv-v0"}
N_CLIENTS = (1, 4, 8)
TARGET_TIMES_PEER = 2.3


class Raw(Batched):
    """PyBullet alone, on the same clients: torques set, simulation stepped, nothing read."""

    def run(self, actions: np.ndarray) -> None:
        """Step through (T, E, A) actions."""
        control, simulate = pybullet.setJointMotorControlArray, pybullet.stepSimulation
        mode = pybullet.TORQUE_CONTROL
        strengths = [motor.torque_n_m for motor in self.env.body.motors]
        simulation = self.env.simulation
        assert isinstance(simulation, Simulation)
        clients = [(each.robot, each.joints, each.client) for each in simulation.clients]
        for torques in (actions * strengths).tolist():
            for (robot, joints, client), forces in zip(clients, torques, strict=True):
                control(robot, joints, mode, forces=forces, physicsClientId=client)
                simulate(client)


def measurement(body: str, clients: Sequence[int] = N_CLIENTS) -> Measurement:
    """Make all contenders of a body, ours and raw with each number of clients."""
    single = SingleEnv(body)
    return Measurement(
        body,
        single.body.action_size,
        [Row("raw stepSimulation", n, Raw(BatchedEnv(body, n))) for n in clients],
        [Row("silem.make_vec", n, Batched(BatchedEnv(body, n))) for n in clients],
        [Row(f"gymnasium silem/{body}-v0", 1, Single(single))],
        Row(f"gymnasium {PEERS[body]}", 1, Single(_peer(body))),
        TARGET_TIMES_PEER,
    )


def _peer(body: str) -> gymnasium.Env[Any, Any]:
    """Make the public package's environment; its first reset builds it."""
    import pybullet_envs_gymnasium  # noqa: F401  registers its environments

    with silence(1):
        env = gymnasium.make(PEERS[body], disable_env_checker=True).unwrapped
        env.reset(seed=0)
    return env
