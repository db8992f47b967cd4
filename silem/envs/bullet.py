"""HalfCheetahs and Ants that learn to run in PyBullet: E clients with a body each, and their task.

Observation and reward are those of PyBullet's HalfCheetah and Ant tasks: forward progress, an
alive bonus of +1 or -1, and small costs for electricity, stalling and joints at their limits.
What runs after every step is plain Python: at a few dozen numbers that is twice as fast as
NumPy's calls, whose code the simulator has pushed out of the processor's caches.
"""

import contextlib
import math
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import gymnasium
import numpy as np

from silem.bodies import BulletBody, measure
from silem.bodies.body import AT_LIMIT, VELOCITY_SCALE
from silem.envs import base
from silem.util.errors import SilemError
from silem.util.offscreen import silence

with silence(2):  # its greeting
    import pybullet
    import pybullet_data

JOINT_NOISE_RAD = 0.1  # joints start within +- this of the model's pose
OBSERVATION_BOUND = 5.0  # observations are clipped to +- this
SUBSTEPS = 4  # of PyBullet's locomotion tasks, as what follows
_SOLVER_ITERATIONS = 5
_GRAVITY_M_S2 = 9.8
_CONTACT_ERP = 0.9
_FLOOR_FRICTION = 0.8
_FLOOR_RESTITUTION = 0.5
_TARGET_M = 1e3  # the body runs along x towards a point a kilometre away
_ELECTRICITY_COST = -2.0
_STALL_COST = -0.1
_LIMIT_COST = -0.1
_JOINT_VELOCITY_SCALE = 0.1
_ANY_LINK = -2  # in PyBullet's filter of contacts
_FIELDS = {"center": 0, "origin": 4}  # of what PyBullet tells of a link

_Numbers: TypeAlias = tuple[float, ...]


class State(NamedTuple):
    """What a client holds after a step."""

    joints: Sequence[_Numbers]  # per motor its hinge's angle in rad and velocity in rad/s, ...
    rpy: _Numbers  # the root's roll, pitch and yaw in rad
    velocity: _Numbers  # the root's, in the world in m/s
    parts: Sequence[_Numbers]  # places in the world in m of the body's parts, the root first
    contact: list[float]  # 1 for each foot that touches the floor, else 0


class Client:
    """A PyBullet client that holds the floor and one body, read with the fewest calls.

    Everything is loaded and set in the order of PyBullet's own locomotion tasks, except that
    overlapping pairs are always deterministic: without that, equal clients drift apart. Raises
    SilemError if PyBullet has no client left or cannot load the body.

    Attributes:
        client: PyBullet's number of the client.
        robot: PyBullet's number of the body within the client.
        joints: PyBullet's numbers of the actuated joints, in the order of the action.
        limits: Lower and upper limit of each of those joints in rad.
    """

    def __init__(self, body: BulletBody) -> None:
        self.body = body
        self.client = pybullet.connect(pybullet.DIRECT)
        if self.client < 0:
            raise SilemError("PyBullet has no client left; close environments that are not used")
        self.close = weakref.finalize(self, _disconnect, self.client)
        client = self._of = {"physicsClientId": self.client}
        pybullet.resetSimulation(**client)
        pybullet.setPhysicsEngineParameter(deterministicOverlappingPairs=1, **client)
        pybullet.setGravity(*(0.0 - _GRAVITY_M_S2 * part for part in body.up), **client)
        pybullet.setDefaultContactERP(_CONTACT_ERP, **client)
        step = {"fixedTimeStep": body.control_step_s, "numSubSteps": SUBSTEPS}
        iterations = {"numSolverIterations": _SOLVER_ITERATIONS}
        pybullet.setPhysicsEngineParameter(**step, **iterations, **client)
        floor = str(Path(pybullet_data.getDataPath()) / "plane_stadium.sdf")
        (self._floor,) = pybullet.loadSDF(floor, **client)
        surface = {"lateralFriction": _FLOOR_FRICTION, "restitution": _FLOOR_RESTITUTION}
        pybullet.changeDynamics(self._floor, measure.BASE, **surface, **client)
        self.robot = measure.load(body, self.client)
        infos = measure.joint_infos(self.robot, self.client)
        index = {info[1].decode(): number for number, info in enumerate(infos)}
        self.joints = [index[motor.joint] for motor in body.motors]
        self._movable = [*(index[name] for name in body.root_joints), *self.joints]
        self.limits = [infos[joint][8:10] for joint in self.joints]
        self._torques = [motor.torque_n_m for motor in body.motors]
        for joint in range(len(infos)):
            self._free(joint)
        # what `read` looks at
        link = self._links = measure.link_names(self.robot, self.client)
        self._foot_of_link = {link[name]: foot for foot, name in enumerate(body.feet)}
        self._has_base = link[body.root] == measure.BASE  # whose state is no link's
        parts = body.parts[self._has_base :]
        self._seen = list(dict.fromkeys(link[part.link] for part in parts))
        self._picks = [(self._seen.index(link[p.link]), _FIELDS[p.point]) for p in parts]
        self._start_state = pybullet.saveState(**client)

    def reset(self, angles: Sequence[float]) -> State:
        """Put the body back to its start pose with the given (J,) joint angles, at rest."""
        pybullet.restoreState(self._start_state, **self._of)
        for joint, angle in zip(self.joints, angles, strict=True):
            pybullet.resetJointState(self.robot, joint, angle, targetVelocity=0, **self._of)
            self._free(joint)
        return self.read()

    def advance(self, action: Sequence[float]) -> None:
        """Apply (J,) shares of the motors' torques, clipped to -1..1, for one control step."""
        forces = [
            torque * (-1.0 if share < -1.0 else 1.0 if share > 1.0 else share)
            for torque, share in zip(self._torques, action, strict=True)
        ]
        mode = pybullet.TORQUE_CONTROL
        pybullet.setJointMotorControlArray(
            self.robot, self.joints, mode, forces=forces, physicsClientId=self.client
        )
        pybullet.stepSimulation(self.client)

    def read(self) -> State:
        """Return the present state; runs after every step, hence arguments by place."""
        robot, client, has_base = self.robot, self.client, self._has_base
        states = pybullet.getLinkStates(robot, self._seen, not has_base, False, client)
        places = [states[link][field] for link, field in self._picks]
        if has_base:
            position, quaternion = pybullet.getBasePositionAndOrientation(robot, client)
            velocity, places = pybullet.getBaseVelocity(robot, client)[0], [position, *places]
        else:
            quaternion, velocity = states[0][1], states[0][6]
        contact = [0.0] * len(self.body.feet)
        for point in pybullet.getContactPoints(robot, self._floor, _ANY_LINK, _ANY_LINK, client):
            if (foot := self._foot_of_link.get(point[3])) is not None:
                contact[foot] = 1.0
        hinges = pybullet.getJointStates(robot, self.joints, client)
        rpy = pybullet.getEulerFromQuaternion(quaternion)
        return State(hinges, rpy, velocity, places, contact)

    def place(self, link: str) -> tuple[_Numbers, _Numbers]:
        """Return the position in m and the quaternion, in the world, of a link's own frame."""
        if (index := self._links[link]) == measure.BASE:
            position, quaternion = pybullet.getBasePositionAndOrientation(self.robot, **self._of)
            return position, quaternion
        state = pybullet.getLinkState(self.robot, index, **self._of)
        return state[4], state[5]

    def qpos(self) -> np.ndarray:
        """Return the joint positions (nq,) as MuJoCo orders them, the root's place first."""
        at = []
        if not self.body.root_joints:
            position, (*axis, w) = self.place(self.body.root)
            at = [*position, w, *axis]
        states = pybullet.getJointStates(self.robot, self._movable, **self._of)
        return np.array(at + [state[0] for state in states])

    def _free(self, joint: int) -> None:
        """Take the force out of the motor that PyBullet puts on every joint."""
        zero = {"targetPosition": 0, "targetVelocity": 0, "force": 0}
        gains, mode = {"positionGain": 0.1, "velocityGain": 0.1}, pybullet.POSITION_CONTROL
        control = {"controlMode": mode, **zero, **gains, **self._of}
        pybullet.setJointMotorControl2(self.robot, joint, **control)


def _disconnect(client: int) -> None:
    with contextlib.suppress(pybullet.error):  # at the interpreter's exit it may be gone
        pybullet.disconnect(physicsClientId=client)


class LocomotionTask:
    """Observation and reward of one body, made of it and of its joints' limits in rad.

    The observation (O,) is: the root's height above its start; sine and cosine of the angle to
    the target; 0.3 times the root's velocity in m/s in its own heading (forward, left, up); roll
    and pitch in rad; then per motor the angle, scaled to -1..1 between its limits, and 0.1 times
    the velocity in rad/s; then 1 or 0 per foot for floor contact. As in PyBullet's tasks the
    contacts, in the observation and in the alive rule, are those of one step before. Whoever
    hands an observation out clips it.

    On a slope the task is the floor's: height, way, bearing, contacts and the alive rule are
    measured along and against it. What is felt is gravity's: roll and pitch are those against the
    vertical, and the velocity is split into what goes up and what goes level.

    Attributes:
        way_m: How far the root has come along x.
        n_upright: For how many steps the body was upright.
    """

    def __init__(self, body: BulletBody, limits: Sequence[tuple[float, float]]) -> None:
        self._step_s, self._terminates = body.control_step_s, body.alive.terminates
        self._min_height_m, self._max_pitch_rad = body.alive.min_height_m, body.alive.max_pitch_rad
        self._no_contact = [body.feet.index(name) for name in body.alive.no_contact]
        self._weights = [part.weight / body.n_parts for part in body.parts]
        scales = [2 / (upper - lower) for lower, upper in limits]
        self._ranges = [(s, -lower * s - 1) for s, (lower, _) in zip(scales, limits, strict=True)]
        self._slope = body.up if body.slope_deg else None
        self._at_rest = [0.0] * len(limits)
        self._no_foot = [0.0] * len(body.feet)

    def begin(self, state: State) -> list[float]:
        """Start an episode and return its first observation (O,)."""
        self.n_upright, self.way_m, self._contact = 0, 0.0, self._no_foot
        self._start_x_m, _, self._start_height_m = state.parts[0]
        observation, self._distance_m, _ = self._observe(state, self._at_rest)
        return observation

    def step(self, action: Sequence[float], state: State) -> tuple[list[float], float, bool]:
        """Score the step by an action (J,), as the policy gave it, to a state.

        Returns:
            Observation (O,), reward, and whether the episode terminates: by the alive rule, or
            because of numbers that are not finite, when observation is zero and reward -1.
        """
        observation, distance_m, costs = self._observe(state, action)
        upright = self._is_upright(state)
        reward = (self._distance_m - distance_m) / self._step_s + costs + (1.0 if upright else -1.0)
        terminated = self._terminates and not upright
        if not math.isfinite(reward):  # the physics exploded
            observation, reward, terminated = [0.0] * len(observation), -1.0, True
        else:
            self.way_m = state.parts[0][0] - self._start_x_m
        self._distance_m, self._contact = distance_m, state.contact
        self.n_upright += upright
        return observation, reward, terminated

    def _is_upright(self, state: State) -> bool:
        if not (state.parts[0][2] > self._min_height_m and abs(state.rpy[1]) < self._max_pitch_rad):
            return False
        for foot in self._no_contact:  # a loop, since any() is slower on four items
            if self._contact[foot]:
                return False
        return True

    def _observe(self, state: State, action: Sequence[float]) -> tuple[list[float], float, float]:
        """Return the observation, the distance to the target in m, and the (negative) costs."""
        joints, (roll, pitch, yaw), (vx, vy, vz), parts, _ = state
        ahead, aside = _TARGET_M, 0.0  # from the mean place of the parts to the target
        for weight, (x, y, _) in zip(self._weights, parts, strict=True):
            ahead -= weight * x
            aside -= weight * y
        distance = math.hypot(ahead, aside)
        if self._slope is not None:
            roll, pitch, vx, vz = _felt(self._slope, (roll, pitch, yaw), (vx, vz))
        cos, sin = math.cos(yaw), math.sin(yaw)
        observation = [
            parts[0][2] - self._start_height_m,
            (aside * cos - ahead * sin) / distance,
            (ahead * cos + aside * sin) / distance,
            VELOCITY_SCALE * (vx * cos + vy * sin),
            VELOCITY_SCALE * (vy * cos - vx * sin),
            VELOCITY_SCALE * vz,
            roll,
            pitch,
        ]
        power = stall = 0.0
        n_at_limit = 0
        for joint, (scale, shift), command in zip(joints, self._ranges, action, strict=True):
            angle = joint[0] * scale + shift
            velocity = joint[1] * _JOINT_VELOCITY_SCALE
            observation += (angle, velocity)
            power += abs(command * velocity)
            stall += command * command
            if not -AT_LIMIT <= angle <= AT_LIMIT:
                n_at_limit += 1
        observation += self._contact
        costs = (_ELECTRICITY_COST * power + _STALL_COST * stall) / len(action)
        return observation, distance, costs + _LIMIT_COST * n_at_limit


def _felt(up: _Numbers, rpy: _Numbers, velocity: _Numbers) -> _Numbers:
    """Return roll and pitch against the vertical, and velocities level and up, on a slope.

    Given are the vertical, roll, pitch and yaw, and velocities along x and z, in the floor's frame.
    """
    (sr, sp, sy), (cr, cp, cy) = [[of(angle) for angle in rpy] for of in (math.sin, math.cos)]
    sine, _, cosine = up
    # the vertical's parts along the root's own axes: forward, left, up
    forward = sine * cy * cp - cosine * sp
    left = sine * (cy * sp * sr - sy * cr) + cosine * cp * sr
    above = sine * (cy * sp * cr + sy * sr) + cosine * cp * cr
    vx, vz = velocity
    level, rise = cosine * vx - sine * vz, sine * vx + cosine * vz
    return math.atan2(left, above), -math.asin(max(-1.0, min(1.0, forward))), level, rise


class Simulation(base.Simulation):
    """E PyBullet clients with the same body, stepped in turn in one process.

    An episode's `speed_m_s` is the root's mean forward speed, `upright` the share of its steps.

    Attributes:
        clients: The clients; none before the first `begin` and after `close`.
        tasks: What each of them does.
    """

    def __init__(self, body: BulletBody, n_envs: int) -> None:
        self._body, self._n_envs = body, n_envs
        self.clients: Sequence[Client] = ()
        bound, shape = OBSERVATION_BOUND, (body.observation_size,)
        self.observation_space = gymnasium.spaces.Box(-bound, bound, shape, np.float32)

    def begin(
        self, indices: np.ndarray, generators: base.Generators
    ) -> tuple[np.ndarray, base.Infos]:
        """Start an episode of some bodies."""
        if not self.clients:
            self.clients = [Client(self._body) for _ in range(self._n_envs)]
            self.tasks = [LocomotionTask(self._body, client.limits) for client in self.clients]
        observations, size = [], self._body.action_size
        for index, generator in zip(indices.tolist(), generators, strict=True):
            angles = generator.uniform(-JOINT_NOISE_RAD, JOINT_NOISE_RAD, size).tolist()
            observations.append(self.tasks[index].begin(self.clients[index].reset(angles)))
        return _clipped(observations), [{} for _ in generators]

    def step(self, actions: np.ndarray) -> base.Stepped:
        """Step all bodies."""
        rows = actions.tolist()
        # One kind of work after the other, so that its code is still in the processor's caches.
        for client, action in zip(self.clients, rows, strict=True):
            client.advance(action)
        states = [client.read() for client in self.clients]
        moves = zip(self.tasks, rows, states, strict=True)
        results = [task.step(action, state) for task, action, state in moves]
        observations, rewards, terminated = zip(*results, strict=True)
        return _clipped(observations), np.array(rewards), np.array(terminated), [{} for _ in rows]

    def summary(self, index: int, n_steps: int, max_steps: int) -> dict[str, float]:
        """Sum up an episode."""
        task, seconds = self.tasks[index], n_steps * self._body.control_step_s
        return {"speed_m_s": task.way_m / seconds, "upright": task.n_upright / n_steps}

    def pose(self) -> np.ndarray:
        """Return the first body's joint positions."""
        return self.clients[0].qpos()

    def close(self) -> None:
        """Disconnect all clients."""
        for client in self.clients:
            client.close()
        self.clients = ()


def _clipped(observations: Sequence[Sequence[float]]) -> np.ndarray:
    array = np.array(observations, dtype=np.float32)
    return array.clip(-OBSERVATION_BOUND, OBSERVATION_BOUND, out=array)
