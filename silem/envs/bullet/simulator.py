"""One PyBullet client with one body in it, read with the fewest calls."""

from __future__ import annotations

import contextlib
import weakref
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import pybullet
import pybullet_data

from silem.bodies import BulletBody, measure
from silem.util.errors import SilemError

JOINT_NOISE_RAD = 0.1  # joints start within +- this of the model's pose
SUBSTEPS = 4  # of PyBullet's locomotion tasks, as what follows
_SOLVER_ITERATIONS = 5
_GRAVITY_M_S2 = 9.8
_CONTACT_ERP = 0.9
_FLOOR_FRICTION = 0.8
_FLOOR_RESTITUTION = 0.5
_ANY_LINK = -2  # in PyBullet's filter of contacts
_FIELDS = {"center": 0, "origin": 4}  # of what PyBullet tells of a link

_Numbers: TypeAlias = tuple[float, ...]


def start_angles(generator: np.random.Generator, body: BulletBody) -> list[float]:
    """Draw (J,) joint angles in rad for an episode's start."""
    angles = generator.uniform(-JOINT_NOISE_RAD, JOINT_NOISE_RAD, body.action_size)
    return angles.tolist()


class State(NamedTuple):
    """What a simulator holds after a step."""

    joints: Sequence[_Numbers]  # per motor its hinge's angle in rad and velocity in rad/s, ...
    rpy: _Numbers  # the root's roll, pitch and yaw in rad
    velocity: _Numbers  # the root's, in the world in m/s
    parts: Sequence[_Numbers]  # places in the world in m of the body's parts, the root first
    contact: list[float]  # 1 for each foot that touches the floor, else 0


class Simulator:
    """A PyBullet client that holds the floor and one body.

    Everything is loaded and set in the order of PyBullet's own locomotion tasks, except that
    overlapping pairs are always deterministic: without that, equal clients drift apart.

    Attributes:
        client: PyBullet's number of the client.
        robot: PyBullet's number of the body within the client.
        joints: PyBullet's numbers of the actuated joints, in the order of the action.
        limits: Lower and upper limit of each of those joints in rad.
        read: `read()` returns the present state.
        advance: `advance(action)` applies (J,) shares of the motors' torques, clipped to -1..1,
            for one control step.

    Raises:
        SilemError: If PyBullet has no client left or cannot load the body.
    """

    def __init__(self, body: BulletBody) -> None:
        self.body = body
        self.client = pybullet.connect(pybullet.DIRECT)
        if self.client < 0:
            raise SilemError("PyBullet has no client left; close environments that are not used")
        self._finalizer = weakref.finalize(self, _disconnect, self.client)
        self._load()
        self.read = self._make_read()
        self.advance = self._make_advance()
        self._start_state = pybullet.saveState(physicsClientId=self.client)

    def reset(self, angles: Sequence[float]) -> State:
        """Put the body back to its start pose with the given (J,) joint angles, at rest."""
        client = {"physicsClientId": self.client}
        pybullet.restoreState(self._start_state, **client)
        for joint, angle in zip(self.joints, angles, strict=True):
            pybullet.resetJointState(self.robot, joint, angle, targetVelocity=0, **client)
            self._free(joint)
        return self.read()

    def place(self, link: str) -> tuple[_Numbers, _Numbers]:
        """Return the position in m and the quaternion, in the world, of a link's own frame."""
        index, client = self._links[link], {"physicsClientId": self.client}
        if index == measure.BASE:
            position, quaternion = pybullet.getBasePositionAndOrientation(self.robot, **client)
            return position, quaternion
        state = pybullet.getLinkState(self.robot, index, **client)
        return state[4], state[5]

    def qpos(self) -> np.ndarray:
        """Return the joint positions (nq,) as MuJoCo orders them, the root's place first."""
        client, at = {"physicsClientId": self.client}, []
        if not self.body.root_joints:
            position, (*axis, w) = self.place(self.body.root)
            at = [*position, w, *axis]
        states = pybullet.getJointStates(self.robot, self._movable, **client)
        return np.array(at + [state[0] for state in states])

    def close(self) -> None:
        """Disconnect the client; closing twice is allowed."""
        self._finalizer()

    def _load(self) -> None:
        client, base = {"physicsClientId": self.client}, measure.BASE
        pybullet.resetSimulation(**client)
        pybullet.setPhysicsEngineParameter(deterministicOverlappingPairs=1, **client)
        pybullet.setGravity(0, 0, -_GRAVITY_M_S2, **client)
        pybullet.setDefaultContactERP(_CONTACT_ERP, **client)
        step = {"fixedTimeStep": self.body.control_step_s, "numSubSteps": SUBSTEPS}
        iterations = {"numSolverIterations": _SOLVER_ITERATIONS}
        pybullet.setPhysicsEngineParameter(**step, **iterations, **client)
        floor = str(Path(pybullet_data.getDataPath()) / "plane_stadium.sdf")
        (self._floor,) = pybullet.loadSDF(floor, **client)
        surface = {"lateralFriction": _FLOOR_FRICTION, "restitution": _FLOOR_RESTITUTION}
        pybullet.changeDynamics(self._floor, base, **surface, **client)
        self.robot = measure.load(self.body, self.client)
        infos = measure.joint_infos(self.robot, self.client)
        index = {info[1].decode(): number for number, info in enumerate(infos)}
        self._links = measure.link_names(self.robot, self.client)
        self.joints = [index[motor.joint] for motor in self.body.motors]
        self._movable = [*(index[name] for name in self.body.root_joints), *self.joints]
        self.limits = [infos[joint][8:10] for joint in self.joints]
        for joint in range(len(infos)):
            self._free(joint)

    def _free(self, joint: int) -> None:
        """Take the force out of the motor that PyBullet puts on every joint."""
        zero = {"targetPosition": 0, "targetVelocity": 0, "force": 0}
        gains = {"positionGain": 0.1, "velocityGain": 0.1, "physicsClientId": self.client}
        mode = pybullet.POSITION_CONTROL
        pybullet.setJointMotorControl2(self.robot, joint, controlMode=mode, **zero, **gains)

    def _make_advance(self) -> Callable[[Sequence[float]], None]:
        client, robot, joints = self.client, self.robot, self.joints
        control, simulate = pybullet.setJointMotorControlArray, pybullet.stepSimulation
        mode = pybullet.TORQUE_CONTROL
        strengths = [motor.torque_n_m for motor in self.body.motors]

        def advance(action: Sequence[float]) -> None:
            forces = [
                strength * (-1.0 if share < -1.0 else 1.0 if share > 1.0 else share)
                for strength, share in zip(strengths, action, strict=True)
            ]
            control(robot, joints, mode, forces=forces, physicsClientId=client)
            simulate(client)

        return advance

    def _make_read(self) -> Callable[[], State]:
        """Return what runs after every step: local names and arguments by place keep it fast."""
        client, robot, floor, joints = self.client, self.robot, self._floor, self.joints
        joint_states, contact_points = pybullet.getJointStates, pybullet.getContactPoints
        euler = pybullet.getEulerFromQuaternion
        read_links = self._make_read_links()
        foot_of_link = {self._links[name]: foot for foot, name in enumerate(self.body.feet)}
        no_contact = [0.0] * len(self.body.feet)

        def read() -> State:
            quaternion, velocity, parts = read_links()
            contact = no_contact.copy()
            for point in contact_points(robot, floor, _ANY_LINK, _ANY_LINK, client):
                if (foot := foot_of_link.get(point[3])) is not None:
                    contact[foot] = 1.0
            hinges = joint_states(robot, joints, client)
            return State(hinges, euler(quaternion), velocity, parts, contact)

        return read

    def _make_read_links(self) -> Callable[[], tuple[_Numbers, _Numbers, list[_Numbers]]]:
        """Return the function that reads the root's quaternion and velocity, and the parts."""
        client, robot, link_states = self.client, self.robot, pybullet.getLinkStates
        base_pose, base_velocity = pybullet.getBasePositionAndOrientation, pybullet.getBaseVelocity
        root = self._links[self.body.root]
        has_base = root == measure.BASE
        parts = self.body.parts[has_base:]
        links = list(dict.fromkeys(self._links[part.link] for part in parts))
        picks = [(links.index(self._links[part.link]), _FIELDS[part.point]) for part in parts]

        def read_from_link() -> tuple[_Numbers, _Numbers, list[_Numbers]]:
            states = link_states(robot, links, True, False, client)
            positions = [states[link][field] for link, field in picks]
            return states[0][1], states[0][6], positions

        def read_from_base() -> tuple[_Numbers, _Numbers, list[_Numbers]]:
            states = link_states(robot, links, False, False, client)
            position, quaternion = base_pose(robot, client)
            positions = [position, *[states[link][field] for link, field in picks]]
            return quaternion, base_velocity(robot, client)[0], positions

        return read_from_base if has_base else read_from_link


def _disconnect(client: int) -> None:
    with contextlib.suppress(pybullet.error):  # at the interpreter's exit it may be gone
        pybullet.disconnect(physicsClientId=client)
