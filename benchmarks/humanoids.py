"""MuJoCo's bodies: raw `mj_step`, our environments, dm_control's.

All get the same actions and go back to the standing pose when the head falls, which random
actions bring about every half second. Raw MuJoCo starts where our batch does.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import mujoco
import numpy as np
from dm_control import suite

from benchmarks.measurement import Batched, Measurement, Row, Single
from silem.bodies import MujocoBody, of_kind
from silem.envs import BatchedEnv, SingleEnv
from silem.envs.mujoco import Simulation, stepped_model

PEER = "dm_control humanoid walk"
N_ENVS = (1, 8, 16)
N_THREADS = 2
TARGET_TIMES_PEER = 1.5
TARGET_SHARE_OF_RAW = 0.95


class Raw:
    """MuJoCo alone: controls set, simulation stepped, nothing read but the head's height.

    Attributes:
        states: One of MuJoCo's data per body.
    """

    def __init__(self, body: str, n_envs: int, is_lean: bool = False) -> None:
        """Compile the model as its file has it, or as our environment steps it.

        Either is without sensors, which nothing reads.
        """
        self.body = of_kind(body, MujocoBody)
        self.model = mujoco.MjModel.from_xml_string(self.body.model_xml())
        if is_lean:
            self.model = stepped_model(self.body)
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
        self.states = [mujoco.MjData(self.model) for _ in range(n_envs)]

    def reset(self, seed: int) -> None:
        """Start every body as our environments start with this seed."""
        env = BatchedEnv(self.body, len(self.states), seed)
        env.reset()
        assert isinstance(env.simulation, Simulation)
        for data, qpos, qvel in zip(
            self.states, env.simulation.qpos, env.simulation.qvel, strict=True
        ):
            mujoco.mj_resetData(self.model, data)
            data.qpos[:], data.qvel[:] = qpos, qvel
            mujoco.mj_forward(self.model, data)

    def run(self, actions: np.ndarray) -> None:
        """Step through (T, E, A) actions."""
        body, model = self.body, self.model
        step, n_substeps, fall_head_m = mujoco.mj_step, body.n_substeps, body.fall_head_m
        pose = np.array(body.standing_pose)
        head = model.body(body.skeleton.head).id
        states = [(data, data.ctrl, data.xpos[head]) for data in self.states]
        for rows in actions:
            for (data, control, head_m), action in zip(states, rows, strict=True):
                control[:] = action
                step(model, data, n_substeps)
                if head_m[2] < fall_head_m:
                    mujoco.mj_resetData(model, data)
                    data.qpos[:] = pose
                    mujoco.mj_forward(model, data)


class Walker(Single):
    """One of our Gymnasium environments, started anew after every fall."""

    def run(self, actions: np.ndarray) -> None:
        """Step through (T, 1, A) actions."""
        for action in actions[:, 0]:
            _, _, fallen, _, _ = self.env.step(action)
            if fallen:
                self.env.reset()


class DmControl:
    """dm_control's task, in our standing pose at the start and after every fall.

    Its own start is a random pose, drawn again until it touches nothing: the search would cost
    it time that has nothing to do with steps.
    """

    def __init__(self, body: str) -> None:
        """Make the environment, with no limit of steps."""
        self.env = suite.load("humanoid", "walk", task_kwargs={"time_limit": float("inf")})
        self.env.reset()
        self._body = of_kind(body, MujocoBody)

    def reset(self, seed: int) -> None:
        """Stand."""
        self._place(np.array(self._body.standing_pose))

    def run(self, actions: np.ndarray) -> None:
        """Step through (T, 1, A) actions."""
        step, physics = self.env.step, self.env.physics
        pose = np.array(self._body.standing_pose)
        for action in actions[:, 0]:
            step(action)
            if physics.head_height() < self._body.fall_head_m:
                self._place(pose)

    def _place(self, pose: np.ndarray) -> None:
        with self.env.physics.reset_context():
            self.env.physics.data.qpos[:] = pose


def measurement(body: str, n_envs: Sequence[int] = N_ENVS) -> Measurement:
    """Make all contenders of a body, ours and raw with each number of environments."""
    most = max(n_envs)
    threaded = Batched(BatchedEnv(body, most, n_threads=N_THREADS))
    others = [
        Row("raw mj_step, our model", most, Raw(body, most, is_lean=True)),
        Row(f"  {N_THREADS} threads, by the clock", most, threaded, time.perf_counter),
        Row(f"gymnasium silem/{body}-v0", 1, Walker(SingleEnv(body))),
    ]
    return Measurement(
        body,
        of_kind(body, MujocoBody).action_size,
        [Row("raw mj_step", n, Raw(body, n)) for n in n_envs],
        [Row("silem.make_vec", n, Batched(BatchedEnv(body, n))) for n in n_envs],
        others,
        Row(PEER, 1, DmControl(body)) if body == "Humanoid" else None,
        TARGET_TIMES_PEER,
        TARGET_SHARE_OF_RAW,
    )
