"""One PyBullet client with one body in it, read with the fewest calls."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pybullet
import pybullet_data

from silem.bodies import Body, bullet
from silem.errors import SilemError

STEP_S = 0.0165  # one control step, as in PyBullet's locomotion tasks
SUBSTEPS = 4
_SOLVER_ITERATIONS = 5
_GRAVITY_M_S2 = 9.8
_CONTACT_ERP = 0.9
_FLOOR_FRICTION = 0.8
_FLOOR_RESTITUTION = 0.5


@dataclass(frozen=True)
class Layout:
    """Where each quantity lies in the flat row of numbers that `Simulator.read` returns.

    Attributes:
        joint_position: (J,) hinge angles in rad.
        joint_velocity: (J,) hinge velocities in rad/s.
        rpy: (3,) the root's roll, pitch and yaw in rad.
        velocity: (3,) the root's velocity in the world in m/s.
        position: (3,) the root's position in the world in m.
        parts: (3 (1 + L),) positions in the world of the root and of the L weighted links, in m.
        contact: (C,) 1 for each foot that touches the floor, else 0.
        size: Length of the row.
    """

    joint_position: slice
    joint_velocity: slice
    rpy: slice
    velocity: slice
    position: slice
    parts: slice
    contact: slice
    size: int

    @classmethod
    def of(cls, body: Body) -> Layout:
        """Return the layout of a body's rows."""
        joints, parts = len(body.motors), len(body.part_weights)
        widths = (joints, joints, 3, 3, 3 * parts, len(body.feet))
        ends = np.cumsum(widths).tolist()
        position, velocity, rpy, speed, place, contact = (
            slice(end - width, end) for end, width in zip(ends, widths, strict=True)
        )
        root = slice(place.start, place.start + 3)  # the root leads the weighted links
        return cls(position, velocity, rpy, speed, root, place, contact, ends[-1])


def part_weights(body: Body) -> np.ndarray:
    """Return (3 (1 + L), 2): the row's `parts` times this is the parts' mean x and y."""
    weights = np.zeros((len(body.part_weights), 3, 2))
    values = np.array([weight for _, weight in body.part_weights]) / body.n_parts
    weights[:, 0, 0] = weights[:, 1, 1] = values
    return weights.reshape(-1, 2)


class Simulator:
    """A PyBullet client that holds the floor and one body.

    Everything is loaded and set in the order of PyBullet's own locomotion tasks, except that
    overlapping pairs are always deterministic: without that, equal clients drift apart.

    Attributes:
        client: PyBullet's number of the client.
        robot: PyBullet's number of the body within the client.
        floor: PyBullet's number of the floor.
        joints: Indices of the actuated joints, in the order of the action.
        limits: (J, 2) lower and upper limits of those joints in rad.
        step: `step(torques)` applies (J,) torques in N m for one control step and returns the
            row of numbers that `Layout` describes.
    """

    def __init__(self, body: Body) -> None:
        self.body = body
        self.client = pybullet.connect(pybullet.DIRECT)
        if self.client < 0:
            raise SilemError("PyBullet has no client left; close environments that are not used")
        self._open = True
        self._load()
        self._find()
        self.read = self._make_read()
        self.step = self._make_step(self.read)
        self._start_state = -1

    def reset(self, angles: Sequence[float]) -> list[float]:
        """Put the body back to its start pose with the given (J,) joint angles at rest.

        Returns:
            The row of numbers that `Layout` describes.
        """
        if self._start_state < 0:
            self._start_state = pybullet.saveState(physicsClientId=self.client)
        else:
            pybullet.restoreState(self._start_state, physicsClientId=self.client)
        for joint, angle in zip(self.joints, angles, strict=True):
            pybullet.resetJointState(
                self.robot, joint, targetValue=angle, targetVelocity=0, physicsClientId=self.client
            )
            self._free(joint)
        return self.read()

    def close(self) -> None:
        """Disconnect the client; closing twice is allowed."""
        if self._open:
            self._open = False
            with contextlib.suppress(pybullet.error):  # at interpreter exit it may be gone
                pybullet.disconnect(physicsClientId=self.client)

    def _load(self) -> None:
        client = {"physicsClientId": self.client}
        pybullet.resetSimulation(**client)
        pybullet.setPhysicsEngineParameter(deterministicOverlappingPairs=1, **client)
        pybullet.setGravity(0, 0, -_GRAVITY_M_S2, **client)
        pybullet.setDefaultContactERP(_CONTACT_ERP, **client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=STEP_S,
            numSolverIterations=_SOLVER_ITERATIONS,
            numSubSteps=SUBSTEPS,
            **client,
        )
        floor = str(Path(pybullet_data.getDataPath()) / "plane_stadium.sdf")
        (self.floor,) = pybullet.loadSDF(floor, **client)
        pybullet.changeDynamics(
            self.floor,
            bullet.BASE,
            lateralFriction=_FLOOR_FRICTION,
            restitution=_FLOOR_RESTITUTION,
            **client,
        )
        self.robot = bullet.load(self.body, self.client)

    def _find(self) -> None:
        """Find the joints and links that the body names, and free every joint's motor."""
        infos = bullet.joint_infos(self.robot, self.client)
        joint_index = {info[1].decode(): index for index, info in enumerate(infos)}
        self.link_index = bullet.link_names(self.robot, self.client)
        self.joints = [joint_index[motor.joint] for motor in self.body.motors]
        self.limits = np.array([infos[joint][8:10] for joint in self.joints])
        for joint in range(len(infos)):
            self._free(joint)

    def _free(self, joint: int) -> None:
        """Take the force out of the motor that PyBullet puts on every joint."""
        pybullet.setJointMotorControl2(
            self.robot,
            joint,
            controlMode=pybullet.POSITION_CONTROL,
            targetPosition=0,
            targetVelocity=0,
            positionGain=0.1,
            velocityGain=0.1,
            force=0,
            physicsClientId=self.client,
        )

    def _make_read(self) -> Callable[[], list[float]]:
        """Return the function that reads the state; local names keep its overhead low."""
        client, robot, floor, joints = self.client, self.robot, self.floor, self.joints
        joint_states, link_states = pybullet.getJointStates, pybullet.getLinkStates
        contact_points = pybullet.getContactPoints
        root = self._make_read_root()
        links = [self.link_index[name] for name, _ in self.body.part_weights[1:]]
        foot_of_link = {self.link_index[name]: i for i, name in enumerate(self.body.feet)}
        no_contact = [0.0] * len(self.body.feet)

        def read() -> list[float]:
            position, velocity, _, _ = zip(*joint_states(robot, joints, client), strict=True)
            row = [*position, *velocity]
            row += root()
            for link in link_states(robot, links, physicsClientId=client):
                row += link[0]
            contact = no_contact.copy()
            for point in contact_points(robot, floor, physicsClientId=client):
                foot = foot_of_link.get(point[3])
                if foot is not None:
                    contact[foot] = 1.0
            row += contact
            return row

        return read

    def _make_read_root(self) -> Callable[[], list[float]]:
        """Return the function that reads the root's roll, pitch, yaw, velocity and position."""
        client, robot = self.client, self.robot
        euler = pybullet.getEulerFromQuaternion
        link = self.link_index[self.body.root]
        if link == bullet.BASE:
            base_pose, base_velocity = (
                pybullet.getBasePositionAndOrientation,
                pybullet.getBaseVelocity,
            )

            def read_base() -> list[float]:
                position, quaternion = base_pose(robot, client)
                return [*euler(quaternion), *base_velocity(robot, client)[0], *position]

            return read_base
        link_state = pybullet.getLinkState

        def read_link() -> list[float]:
            state = link_state(robot, link, 1, physicsClientId=client)
            return [*euler(state[1]), *state[6], *state[0]]

        return read_link

    def _make_step(self, read: Callable[[], list[float]]) -> Callable[[list[float]], list[float]]:
        client, robot, joints = self.client, self.robot, self.joints
        control, simulate = pybullet.setJointMotorControlArray, pybullet.stepSimulation
        mode = pybullet.TORQUE_CONTROL

        def step(torques: list[float]) -> list[float]:
            control(robot, joints, mode, forces=torques, physicsClientId=client)
            simulate(client)
            return read()

        return step
