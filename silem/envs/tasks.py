"""The locomotion task: observation, reward and alive rule, for a batch of environments.

Observation and reward are those of PyBullet's HalfCheetah and Ant tasks: forward progress, an
alive bonus of +1 or -1, and small costs for electricity, stalling and joints at their limits.
"""

from __future__ import annotations

import math

import numpy as np

from silem.bodies import Body
from silem.envs.simulator import STEP_S, Layout, part_weights

_TARGET_X_M = 1e3  # the body runs towards a point a kilometre away
_ELECTRICITY_COST = -2.0
_STALL_COST = -0.1
_LIMIT_COST = -0.1
_AT_LIMIT = 0.99  # share of a joint's range beyond which it counts as at its limit
_VELOCITY_SCALE = 0.3  # of the torso's velocity in the observation
_JOINT_VELOCITY_SCALE = 0.1
_CLIP = 5.0
_TORSO = 8  # numbers of the torso, which lead the observation


class LocomotionTask:
    """Observation and reward of E environments with the same body.

    The observation (O,) is: the torso's height above its start, sine and cosine of the angle to
    the target, 0.3 times the torso's velocity in m/s in its own heading (forward, left, up), roll
    and pitch in rad; then per motor the angle, scaled to -1..1 between its limits, and 0.1 times
    the velocity in rad/s; then 1 or 0 per foot for floor contact. As in PyBullet's tasks the
    contacts, in the observation and in the alive rule, are those of one step before.

    Attributes:
        torques: (J,) torque in N m of each motor at action 1.
    """

    def __init__(self, body: Body, limits: np.ndarray, n_envs: int) -> None:
        """Prepare the task.

        Args:
            body: The body.
            limits: (J, 2) lower and upper joint limits in rad.
            n_envs: E.
        """
        self.body = body
        self.torques = np.array([motor.torque_n_m for motor in body.motors])
        self._layout = Layout.of(body)
        self._weights = part_weights(body)
        self._lower, self._range = limits[:, 0], limits[:, 1] - limits[:, 0]
        self._forbidden = [body.feet.index(name) for name in body.alive.no_contact]
        self._contact = np.zeros((n_envs, len(body.feet)))
        self._start_height = np.zeros(n_envs)
        self._potential = np.zeros(n_envs)

    def begin(self, index: int, row: np.ndarray) -> np.ndarray:
        """Start an episode of environment `index`.

        Args:
            index: Number of the environment.
            row: (R,) its simulator's numbers at the start.

        Returns:
            (O,) the first observation, float32.
        """
        rows = row[None]
        self._contact[index] = 0
        self._start_height[index] = row[self._layout.position.stop - 1]
        place = rows[:, self._layout.parts] @ self._weights
        self._potential[index] = self._potentials(place)[0]
        chosen = slice(index, index + 1)
        return self._observe(rows, place, *self._joints(rows), chosen)[0]

    def step(
        self, actions: np.ndarray, rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Score one step of all environments.

        Args:
            actions: (E, A) actions, as the policy gave them, float32.
            rows: (E, R) the simulators' numbers after the step.

        Returns:
            Observations (E, O), rewards (E,), both float32, and whether upright (E,).
        """
        place = rows[:, self._layout.parts] @ self._weights
        angles, velocities = self._joints(rows)
        observations = self._observe(rows, place, angles, velocities, slice(None))
        upright = self._upright(rows)
        potential = self._potentials(place)
        rewards = (
            np.where(upright, 1.0, -1.0)
            + (potential - self._potential)
            + _ELECTRICITY_COST * np.abs(actions * velocities).mean(axis=1)
            + _STALL_COST * np.square(actions).mean(axis=1)
            + _LIMIT_COST * np.count_nonzero(np.abs(angles) > _AT_LIMIT, axis=1)
        )
        self._potential = potential
        self._contact = rows[:, self._layout.contact]
        return observations, rewards.astype(np.float32), upright

    def terminated(self, upright: np.ndarray, rewards: np.ndarray) -> np.ndarray:
        """Return (E,) whether each episode ends because of how the body fares."""
        return ~upright if self.body.alive.terminates else np.zeros(len(upright), dtype=bool)

    def _potentials(self, place: np.ndarray) -> np.ndarray:
        """Minus the distance from the (E, 2) mean place of the parts to the target, per step."""
        return np.hypot(_TARGET_X_M - place[:, 0], place[:, 1]) / -STEP_S

    def _upright(self, rows: np.ndarray) -> np.ndarray:
        rule, layout = self.body.alive, self._layout
        upright = np.ones(len(rows), dtype=bool)
        if math.isfinite(rule.min_height_m):
            upright &= rows[:, layout.position.stop - 1] > rule.min_height_m
        if math.isfinite(rule.max_pitch_rad):
            upright &= np.abs(rows[:, layout.rpy.start + 1]) < rule.max_pitch_rad
        if self._forbidden:
            upright &= ~self._contact[:, self._forbidden].any(axis=1)
        return upright

    def _joints(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (E, J) scaled angles and (E, J) scaled velocities, float32."""
        angles = 2 * (rows[:, self._layout.joint_position] - self._lower) / self._range - 1
        velocities = _JOINT_VELOCITY_SCALE * rows[:, self._layout.joint_velocity]
        return angles.astype(np.float32), velocities.astype(np.float32)

    def _observe(
        self,
        rows: np.ndarray,
        place: np.ndarray,
        angles: np.ndarray,
        velocities: np.ndarray,
        chosen: slice,
    ) -> np.ndarray:
        layout = self._layout
        joints = 2 * len(self.torques)
        observations = np.empty((len(rows), self.body.observation_size), dtype=np.float32)
        roll, pitch, yaw = rows[:, layout.rpy].T
        vx, vy, vz = rows[:, layout.velocity].T
        bearing = np.arctan2(-place[:, 1], _TARGET_X_M - place[:, 0]) - yaw
        cos, sin = np.cos(yaw), np.sin(yaw)
        columns = observations.T
        columns[0] = rows[:, layout.position.stop - 1] - self._start_height[chosen]
        columns[1] = np.sin(bearing)
        columns[2] = np.cos(bearing)
        columns[3] = _VELOCITY_SCALE * (cos * vx + sin * vy)
        columns[4] = _VELOCITY_SCALE * (cos * vy - sin * vx)
        columns[5] = _VELOCITY_SCALE * vz
        columns[6] = roll
        columns[7] = pitch
        observations[:, _TORSO : _TORSO + joints : 2] = angles
        observations[:, _TORSO + 1 : _TORSO + joints : 2] = velocities
        observations[:, _TORSO + joints :] = self._contact[chosen]
        return np.clip(observations, -_CLIP, _CLIP, out=observations)
