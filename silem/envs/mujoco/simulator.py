"""E states of one MuJoCo model, stepped together and read as arrays."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np

from silem import bodies
from silem.bodies import Body, MujocoBody
from silem.envs.mujoco.task import Reading
from silem.motion.features import Landmarks

JOINT_NOISE_RAD = 0.02  # hinges start within +- this of the standing pose
VELOCITY_NOISE = 0.02  # and joint velocities within +- this of rest, in m/s and rad/s

StartStates = tuple[np.ndarray, np.ndarray]
"""Positions (S, nq) and velocities (S, nv) to start episodes from, drawn at random."""


def body_of(body: Body | str) -> MujocoBody:
    """Return a body, given itself or its name; raises SilemError where MuJoCo does not step it."""
    return bodies.of_kind(body, MujocoBody)


class Simulation:
    """E states of one model, stepped in one thread or several.

    A control step is dm_control's: the last substep stops after the part that brings positions
    and velocities up to date, and the next control step begins with the rest of it.

    Attributes:
        body: The body.
        model: Its compiled model.
        states: The E states.
    """

    def __init__(self, body: MujocoBody, n_envs: int, n_threads: int = 1) -> None:
        self.body = body
        self.model = mujoco.MjModel.from_xml_string(body.model_xml())
        # Nothing reads sensors; what is needed is computed once per control step, not per substep.
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
        self.states = [mujoco.MjData(self.model) for _ in range(n_envs)]
        self._landmarks = Landmarks(self.model, body.skeleton)
        torso, root = self._landmarks.torso, self._landmarks.root
        self._controls = [data.ctrl for data in self.states]
        self._views = [
            (data.qpos, data.qvel, data.xpos.ravel(), data.xmat[torso], data.subtree_linvel[root])
            for data in self.states
        ]
        bounds = np.cumsum([0, *(view.size for view in self._views[0])]).tolist()
        self._columns = [slice(*pair) for pair in itertools.pairwise(bounds)]
        self._threads = ThreadPoolExecutor(n_threads) if n_threads > 1 else None
        self._shares = [share.tolist() for share in np.array_split(np.arange(n_envs), n_threads)]

    def place(self, index: int, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Put one state at joint positions (nq,) and velocities (nv,)."""
        data = self.states[index]
        mujoco.mj_resetData(self.model, data)
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_forward(self.model, data)
        mujoco.mj_subtreeVel(self.model, data)

    def advance(self, actions: np.ndarray) -> list[bool]:
        """Apply actions (E, A), within -1..1, for one control step.

        Returns:
            Per environment, whether its physics went wrong: MuJoCo then starts the state anew.
        """
        if self._threads is None:
            return self._advance(self._shares[0], actions)
        results = self._threads.map(self._advance, self._shares, itertools.repeat(actions))
        return [failed for share in results for failed in share]

    def _advance(self, indices: list[int], actions: np.ndarray) -> list[bool]:
        model, rest, failed = self.model, self.body.n_substeps - 1, []
        least = self.body.control_step_s - 0.5 * model.opt.timestep
        for index in indices:
            data = self.states[index]
            self._controls[index][:] = actions[index]
            due = data.time + least
            mujoco.mj_step2(model, data)
            if rest:
                mujoco.mj_step(model, data, rest)
            mujoco.mj_step1(model, data)
            mujoco.mj_subtreeVel(model, data)
            failed.append(data.time < due)
        return failed

    def read(self, indices: Iterable[int] | None = None) -> Reading:
        """Return copies of what the states hold: the chosen ones', or all."""
        views = self._views if indices is None else [self._views[index] for index in indices]
        # One copy of everything, a row per state: what counts here is the number of NumPy calls.
        rows = np.concatenate(list(itertools.chain.from_iterable(views))).reshape(len(views), -1)
        qpos, qvel, xpos, xmat, velocity = (rows[:, columns] for columns in self._columns)
        points = xpos.reshape(len(rows), -1, 3).take(self._landmarks.ids, axis=1)
        return Reading(qpos, qvel, points, self._landmarks.oriented(xmat), velocity)

    def close(self) -> None:
        """End the threads; closing twice is allowed."""
        if self._threads is not None:
            self._threads.shutdown()


def start_state(
    generator: np.random.Generator, body: MujocoBody, starts: StartStates | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Draw the joint positions (nq,) and velocities (nv,) that an episode starts from.

    Args:
        generator: Where the random numbers come from.
        body: The body.
        starts: States to choose from; None means the standing pose with small noise.
    """
    if starts is not None:
        chosen = generator.integers(len(starts[0]))
        return starts[0][chosen], starts[1][chosen]
    qpos = np.array(body.standing_pose)
    qpos[7:] += generator.uniform(-JOINT_NOISE_RAD, JOINT_NOISE_RAD, len(qpos) - 7)
    return qpos, generator.uniform(-VELOCITY_NOISE, VELOCITY_NOISE, len(qpos) - 1)
