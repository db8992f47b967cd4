"""E states of one MuJoCo model, stepped together and read as arrays."""

from __future__ import annotations

import mujoco
import numpy as np
from mujoco.batch import Batch

from silem import bodies
from silem.bodies import Body, MujocoBody
from silem.envs.mujoco.task import Reading
from silem.motion.features import Landmarks

JOINT_NOISE_RAD = 0.02  # hinges start within +- this of the standing pose
VELOCITY_NOISE = 0.02  # and joint velocities within +- this of rest, in m/s and rad/s

StartStates = tuple[np.ndarray, np.ndarray]
"""Positions (S, nq) and velocities (S, nv) to start episodes from, drawn at random."""

# what MuJoCo counts when it starts a state anew: of positions, velocities or accelerations
_FAILURES = slice(mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQACC + 1)


def body_of(body: Body | str) -> MujocoBody:
    """Return a body, given itself or its name; raises SilemError where MuJoCo does not step it."""
    return bodies.of_kind(body, MujocoBody)


class Simulation:
    """E states of one model, stepped in one thread or several.

    A control step is dm_control's: the last substep stops after the part that brings positions
    and velocities up to date, and the next control step begins with the rest of it.

    Attributes:
        model: The body's compiled model.
        qpos: Positions of all joints, (E, nq); writing to them moves the bodies.
        qvel: Their velocities, (E, nv).
    """

    def __init__(self, body: MujocoBody, n_envs: int, n_threads: int = 1) -> None:
        self.body = body
        self.model = _model(body)
        self._batch = Batch(self.model, n_envs, n_threads, persistent=True)
        self._landmarks = Landmarks(self.model, body.skeleton)
        self.qpos, self.qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._controls = self._batch.bind("ctrl")
        self._n_failures = self._batch.warning[:, _FAILURES, 1]
        self._none = np.zeros(n_envs, dtype=bool)
        self._views = (
            self.qpos,
            self.qvel,
            self._batch.bind("xpos"),
            self._batch.bind("xmat")[:, self._landmarks.torso],
            self._batch.bind("subtree_linvel")[:, self._landmarks.root],
        )
        self._blank = self._batch.state[0].copy()

    def place(self, index: int | np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Put a state at joint positions (nq,) and velocities (nv,), or several (n,) at theirs."""
        self._batch.state[index] = self._blank
        self.qpos[index], self.qvel[index] = qpos, qvel
        self._batch.forward(np.atleast_1d(index), mujoco.mjtStage.mjSTAGE_VEL)

    def advance(self, actions: np.ndarray) -> np.ndarray:
        """Apply actions (E, A), within -1..1, for one control step.

        Returns:
            Per environment (E,), whether its physics went wrong: MuJoCo then starts it anew.
        """
        self._controls[:] = actions
        self._batch.step(nstep=self.body.n_substeps, stage=mujoco.mjtStage.mjSTAGE_VEL)
        failed = self._n_failures.any(axis=1) if np.count_nonzero(self._n_failures) else self._none
        self._n_failures[:] = 0
        return failed

    def read(self, indices: np.ndarray | None = None) -> Reading:
        """Return copies of what the states hold: the chosen ones', or all."""
        views = self._views if indices is None else [view[indices] for view in self._views]
        qpos, qvel, places, torso, velocity = views
        points, axes = places.take(self._landmarks.ids, 1), self._landmarks.oriented(torso)
        return Reading(qpos.copy(), qvel.copy(), points, axes, velocity.copy())

    def data(self, index: int = 0) -> mujoco.MjData:
        """Return a copy of all that MuJoCo knows of one state."""
        return self._batch.get_data(index)


def _model(body: MujocoBody) -> mujoco.MjModel:
    """Compile a body's model, with one sensor: the velocity of its centre of mass."""
    spec = mujoco.MjSpec.from_string(body.model_xml())
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    root = spec.body(body.skeleton.torso)
    while root.parent.name != "world":
        root = root.parent
    spec.add_sensor(
        name="com_velocity",
        type=mujoco.mjtSensor.mjSENS_SUBTREELINVEL,
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        objname=root.name,
    )
    return spec.compile()


def start_state(
    generator: np.random.Generator, body: MujocoBody, starts: StartStates | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Draw the joint positions (nq,) and velocities (nv,) that an episode starts from.

    They are one of `starts`, or without any the standing pose with small noise.
    """
    if starts is not None:
        chosen = generator.integers(len(starts[0]))
        return starts[0][chosen], starts[1][chosen]
    qpos = np.array(body.standing_pose)
    qpos[7:] += generator.uniform(-JOINT_NOISE_RAD, JOINT_NOISE_RAD, len(qpos) - 7)
    return qpos, generator.uniform(-VELOCITY_NOISE, VELOCITY_NOISE, len(qpos) - 1)
