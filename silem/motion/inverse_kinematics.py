"""Inverse kinematics of a humanoid: the pose that brings its landmarks to their targets.

mink states one step as a quadratic program, with joint limits and the floor as hard constraints;
here its steps are repeated, with damping by Levenberg and Marquardt's rule, until the pose is at a
minimum. Self-collision is not looked at.
"""

from __future__ import annotations

import mink
import mujoco
import numpy as np

from silem.bodies.body import MujocoBody
from silem.motion.features import Landmarks
from silem.motion.soles import FloorLimit, Soles
from silem.motion.targets import SIDES, TARGETS

SOLVER = "daqp"

_COSTS = {  # of position (per m) and orientation (per rad): what is out of reach, the hands lose
    "torso": (5.0, 5.0),
    "left_hand": (1.0, 0.0),
    "right_hand": (1.0, 0.0),
    "left_foot": (10.0, 0.0),
    "right_foot": (10.0, 0.0),
}
_STANDING_COST = 0.004  # towards the standing pose, in what the targets leave open
_PREVIOUS_COST = 0.025  # towards the frame before
_BELOW_FLOOR_COST = 100.0  # counts in whether a step is accepted

_MAX_STEPS = 200
_CONVERGED = 1e-6  # relative decrease of the cost
_DAMPING = (1e-6, 1e4)  # lowest and highest
_LESS, _MORE = 0.25, 8.0  # factors on the damping after a step that did and did not help


class PoseSolver:
    """Finds a body's pose for one frame after the other, each starting from the one before.

    Attributes:
        soles: The body's soles.
        standing_pose: (nq,) the body's standing pose, where the solver starts.
        standing_points: (P, 3) landmarks in the standing pose.
        standing_axes: (3, 3) forward, left and up of the torso in that pose, as rows.
    """

    def __init__(self, model: mujoco.MjModel, body: MujocoBody) -> None:
        landmarks, skeleton = Landmarks(model, body.skeleton), body.skeleton
        self.standing_pose = np.array(body.standing_pose)
        self._configuration = mink.Configuration(model, self.standing_pose)
        self.soles = Soles(model, [getattr(skeleton, f"{side}_foot") for side in SIDES])
        self.standing_points = landmarks.points(self._configuration.data)
        self.standing_axes = landmarks.torso_axes(self._configuration.data)
        self._torso_columns = ["xyz".index(axis) for axis in skeleton.axes]
        self._frames = [
            mink.FrameTask(getattr(skeleton, name), "body", *_COSTS[name]) for name in TARGETS
        ]
        self._previous = mink.PostureTask(model, _PREVIOUS_COST)
        posture = mink.PostureTask(model, _STANDING_COST)
        posture.set_target(self.standing_pose)
        self._tasks = [*self._frames, self._previous, posture]
        self._limits = [mink.ConfigurationLimit(model), FloorLimit(model, self.soles)]

    def solve(self, positions: np.ndarray, torso_axes: np.ndarray) -> np.ndarray:
        """Return the pose for one frame, (nq,).

        Args:
            positions: (5, 3) where the landmarks of `TARGETS` should be in the world, in m.
            torso_axes: (3, 3) where the torso's forward, left and up should point, as rows.
        """
        matrix = np.empty((3, 3))
        matrix[:, self._torso_columns] = torso_axes.T
        rotation = mink.SO3.from_matrix(matrix)  # has no cost except at the torso
        for task, position in zip(self._frames, positions, strict=True):
            task.set_target(mink.SE3.from_rotation_and_translation(rotation, position))
        self._previous.set_target(self._configuration.q)
        self._descend()
        return self._configuration.q

    def _descend(self) -> None:
        """Step until the cost no longer falls.

        Full steps would overshoot again and again at a leg that is nearly straight and at a target
        just out of reach: a step that does not help is taken back, and a shorter one tried.
        """
        configuration, cost = self._configuration, self._cost()
        lowest, highest = damping, _ = _DAMPING
        for _ in range(_MAX_STEPS):
            before = configuration.q
            step = mink.solve_ik(
                configuration, self._tasks, 1.0, SOLVER, damping=damping, limits=self._limits
            )
            configuration.integrate_inplace(step, 1.0)
            decrease = cost - self._cost()
            if decrease > 0:
                cost -= decrease
                damping = max(damping * _LESS, lowest)
                if decrease < _CONVERGED * cost:
                    return
            else:
                configuration.update(before)
                damping *= _MORE
                if damping > highest:
                    return

    def _cost(self) -> float:
        """Return the sum of the squared errors of all tasks and of the depth below the floor."""
        configuration = self._configuration
        errors = [task.cost * task.compute_error(configuration) for task in self._tasks]
        depths = np.minimum(self.soles.heights(configuration.data), 0.0)
        errors.append(_BELOW_FLOOR_COST * depths)
        return float(sum(error @ error for error in errors))
