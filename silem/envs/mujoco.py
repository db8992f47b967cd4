"""Humanoids that learn to walk in MuJoCo: E states of one model, and dm_control's `humanoid walk`.

The only change to dm_control's task is the speed that earns the full reward: the demonstrator's,
which the paper's reward asks to be matched (Figure 3b), in place of 1 m/s.
"""

from collections.abc import Sequence
from typing import NamedTuple

import gymnasium
import mujoco
import numpy as np
from mujoco.batch import Batch

from silem.bodies import MujocoBody
from silem.envs import base
from silem.motion.features import FEATURES, POINTS, Landmarks, skeletal_features
from silem.util.errors import COUNT, RATE, SilemError

JOINT_NOISE_RAD = 0.02  # hinges start within +- this of the standing pose
VELOCITY_NOISE = 0.02  # and joint velocities within +- this of rest, in m/s and rad/s

StartStates = tuple[np.ndarray, np.ndarray]
"""Positions (S, nq) and velocities (S, nv) to start episodes from, drawn at random."""

_UPRIGHT_FROM = 0.9  # cosine of the torso's tilt
_UPRIGHT_MARGIN = 1.9
_LOG_MARGIN_VALUE = np.log(0.1)  # dm_control's default value of its Gaussian at the margin
_HEAD = POINTS.index("head")
_LIMBS = ("left_hand", "left_foot", "right_hand", "right_foot")
_SEEN = ["head_height", *(f"{part}_{i}" for part in (*_LIMBS, "torso_vertical") for i in "xyz")]
_OBSERVED = np.array([[feature.name for feature in FEATURES].index(name) for name in _SEEN])

# what MuJoCo counts when it starts a state anew: of positions, velocities or accelerations
_FAILURES = slice(mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQACC + 1)


class Reading(NamedTuple):
    """What a simulation of E bodies holds after a step.

    Attributes:
        qpos: Positions of all joints, (E, nq): free root (position, quaternion), hinges in rad.
        qvel: Their velocities, (E, nv).
        points: Landmarks in the world in m, (E, P, 3).
        torso_axes: Forward, left and up of the torso in the world, as rows, (E, 3, 3).
        com_velocity: Of the centre of mass, in the world in m/s, (E, 3).
    """

    qpos: np.ndarray
    qvel: np.ndarray
    points: np.ndarray
    torso_axes: np.ndarray
    com_velocity: np.ndarray

    @property
    def head_m(self) -> np.ndarray:
        """Height of the head, (E,)."""
        return self.points[:, _HEAD, 2]

    def features(self, up: tuple[float, float, float] | None = None) -> np.ndarray:
        """Return the skeletal features (E, F), float32; `up` is the vertical if it is not z."""
        return skeletal_features(self.points, self.torso_axes, self.com_velocity, up)


class Simulation(base.Simulation):
    """E states of one body's model, or each of its own body's, stepped in one thread or several.

    A control step is dm_control's: the last substep stops after the part that brings positions
    and velocities up to date, and the next control step begins with the rest of it. An episode's
    `speed_m_s` is the straight way over its time, `upright` the share of the most steps that it
    lasted.

    Attributes:
        body: The body.
        model: Its compiled model.
        qpos: Positions of all joints, (E, nq); writing to them moves the bodies.
        qvel: Their velocities, (E, nv).
    """

    def __init__(
        self,
        body: MujocoBody,
        n_envs: int,
        *,
        n_threads: int = 1,
        speed_m_s: float | None = None,
        starts: StartStates | None = None,
        bodies: Sequence[MujocoBody] | None = None,
    ) -> None:
        """Prepare the states; the options are those of `silem.envs.make_vec`."""
        speed_m_s = body.target_speed_m_s if speed_m_s is None else speed_m_s
        COUNT.check("n_threads", n_threads)
        RATE.check("speed_m_s", speed_m_s)
        self.body, self._speed_m_s, self._starts = body, speed_m_s, starts
        size = 2 * body.action_size + len(_OBSERVED) + 3 + 6
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)
        self.model = stepped_model(body)
        self._landmarks = Landmarks(self.model, body.skeleton)
        self._batch = batch = Batch(self.model, n_envs, min(n_envs, n_threads), persistent=True)
        self.qpos, self.qvel, self._controls = map(batch.bind, ("qpos", "qvel", "ctrl"))
        own = body.each(n_envs) if body.each and bodies is None else bodies
        self._bodies = [body] * n_envs if own is None else list(own)
        if own is not None:
            if len(self._bodies) != n_envs:
                raise SilemError(f"{len(self._bodies)} bodies for {n_envs} environments")
            self.filmed = self._bodies[0]
            try:
                batch.set_models([stepped_model(each) for each in self._bodies])
            except (ValueError, mujoco.FatalError) as error:  # of other sizes
                raise SilemError(f"bodies of one batch differ in lengths alone: {error}") from error
        self._places = batch.bind("xpos")
        self._torso = batch.bind("xmat")[:, self._landmarks.torso]
        self._com_velocity = batch.bind("subtree_linvel")[:, self._landmarks.root]
        self._blank = batch.state[0].copy()
        self._none = np.zeros(n_envs, dtype=bool)
        self._start_xy = np.zeros((n_envs, 2))

    def place(self, index: int | np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Put a state at joint positions (nq,) and velocities (nv,), or several (n,) at theirs."""
        self._batch.state[index] = self._blank
        self.qpos[index], self.qvel[index] = qpos, qvel
        self._batch.forward(np.atleast_1d(index), mujoco.mjtStage.mjSTAGE_VEL)

    def advance(self, actions: np.ndarray) -> np.ndarray:
        """Apply actions (E, A), within -1..1, for one control step.

        Returns whose physics went wrong, (E,): MuJoCo then starts it anew.
        """
        self._controls[:] = actions
        self._batch.step(nstep=self.body.n_substeps, stage=mujoco.mjtStage.mjSTAGE_VEL)
        if not np.count_nonzero(self._batch.warning):
            return self._none
        failed = self._batch.warning[:, _FAILURES, 1].any(axis=1)
        self._batch.warning[:] = 0
        return failed

    def read(self, indices: slice | np.ndarray = slice(None)) -> Reading:
        """Return copies of what the states hold: the chosen ones', or all."""
        return Reading(
            self.qpos[indices].copy(),
            self.qvel[indices].copy(),
            self._places[indices].take(self._landmarks.ids, 1),
            self._landmarks.oriented(self._torso[indices]),
            self._com_velocity[indices].copy(),
        )

    def data(self, index: int = 0) -> mujoco.MjData:
        """Return a copy of all that MuJoCo knows of one state."""
        return self._batch.get_data(index)

    def begin(
        self, indices: np.ndarray, generators: base.Generators
    ) -> tuple[np.ndarray, base.Infos]:
        """Start an episode of some bodies."""
        pairs = zip(generators, indices.tolist(), strict=True)
        states = [start_state(chance, self._bodies[i], self._starts) for chance, i in pairs]
        self.place(indices, *map(np.array, zip(*states, strict=True)))
        self._start_xy[indices] = self.qpos[indices, :2]
        return self._observed(self.read(indices))

    def step(self, actions: np.ndarray) -> base.Stepped:
        """Step all bodies."""
        actions = actions.clip(-1.0, 1.0)
        failed = self.advance(actions)
        reading = self.read()
        earned = rewards(reading, actions, self.body.standing_head_m, self._speed_m_s)
        fallen = reading.head_m < self.body.fall_head_m
        if failed is not self._none:
            earned[failed], fallen[failed] = 0.0, True
        observations, infos = self._observed(reading)
        return observations, earned, fallen, infos

    def _observed(self, reading: Reading) -> tuple[np.ndarray, base.Infos]:
        """Return observations (E, O) and infos."""
        features = reading.features(self.body.up if self.body.slope_deg else None)
        return observe(reading, features), [{base.INFO_KEY: row} for row in features]

    def summary(self, index: int, n_steps: int, max_steps: int) -> dict[str, float]:
        """Sum up an episode."""
        way_m = float(np.hypot(*(self.qpos[index, :2] - self._start_xy[index])))
        seconds = n_steps * self.body.control_step_s
        return {"speed_m_s": way_m / seconds, "upright": n_steps / max_steps}

    def pose(self) -> np.ndarray:
        """Return the first body's joint positions."""
        return self.qpos[0]


def stepped_model(body: MujocoBody) -> mujoco.MjModel:
    """Compile a body's model as it is stepped: the same motion, bit for bit, in less time.

    What is only drawn is left out where inertias do not follow from it. One body is one tree, so
    there are no islands to find among its constraints; and each of its links has so few shapes
    that trees of bounding boxes cost more than they save. The one sensor has MuJoCo compute the
    velocity of the centre of mass.
    """
    spec = mujoco.MjSpec.from_string(body.model_xml())
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    drawn = [geom for geom in spec.geoms if not geom.contype and not geom.conaffinity]
    drawn = [geom for geom in drawn if geom.parent.explicitinertial and geom.name not in paired]
    for thing in (*spec.sensors, *drawn):
        spec.delete(thing)
    if body.slope_deg:
        spec.option.gravity = np.linalg.norm(spec.option.gravity) * -np.array(body.up)
    flags = mujoco.mjtDisableBit
    spec.option.disableflags |= flags.mjDSBL_ISLAND | flags.mjDSBL_MIDPHASE
    root = spec.body(body.skeleton.torso)
    while root.parent.name != "world":
        root = root.parent
    kind, of = mujoco.mjtSensor.mjSENS_SUBTREELINVEL, mujoco.mjtObj.mjOBJ_BODY
    spec.add_sensor(name="com_velocity", type=kind, objtype=of, objname=root.name)
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


def observe(reading: Reading, features: np.ndarray) -> np.ndarray:
    """Return dm_control's observation of a humanoid, (E, O) float32.

    In order: hinges in rad; height of the head in m; left hand, left foot, right hand, right foot
    relative to the torso, in its frame, in m; the vertical in the torso's frame; velocity of the
    centre of mass in the world in m/s; velocity of all joints. `features` are g(s), (E, F).
    """
    parts = (reading.qpos[:, 7:], features.take(_OBSERVED, 1), reading.com_velocity, reading.qvel)
    return np.concatenate(parts, axis=1, dtype=np.float32)


def rewards(
    reading: Reading, actions: np.ndarray, standing_head_m: float, speed_m_s: float
) -> np.ndarray:
    """Return dm_control's reward for walking, (E,), each from 0 to 1.

    The product of standing (head up from `standing_head_m` and torso upright), small control, and
    speed of the centre of mass in any horizontal direction, up to `speed_m_s`. `reading` is the
    state after the step by `actions` (E, A), clipped to -1..1.
    """
    # tolerance() with a Gaussian that falls to 0.1 a margin below the bound
    below = np.maximum(standing_head_m - reading.head_m, 0.0) / (standing_head_m / 4)
    standing = np.exp(_LOG_MARGIN_VALUE * np.square(below))
    short = np.maximum(_UPRIGHT_FROM - reading.torso_axes[:, 2, 2], 0.0)
    upright = np.maximum(1.0 - short / _UPRIGHT_MARGIN, 0.0)
    saved = np.add.reduce(1.0 - np.square(actions), 1)
    small_control = (4.0 + saved / actions.shape[1]) / 5.0
    speed = np.sqrt(np.add.reduce(np.square(reading.com_velocity[:, :2]), 1))
    move = (5.0 * np.minimum(speed / speed_m_s, 1.0) + 1.0) / 6.0
    return small_control * standing * upright * move
