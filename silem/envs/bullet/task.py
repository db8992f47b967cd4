"""The locomotion task: observation, reward and alive rule of one environment.

Observation and reward are those of PyBullet's HalfCheetah and Ant tasks: forward progress, an
alive bonus of +1 or -1, and small costs for electricity, stalling and joints at their limits.
This runs after every simulated step. At a few dozen numbers plain Python is twice as fast as
NumPy's calls, whose code the simulator has pushed out of the processor's caches.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import gymnasium
import numpy as np

from silem.bodies import BulletBody
from silem.bodies.body import AT_LIMIT as _AT_LIMIT
from silem.bodies.body import VELOCITY_SCALE as _VELOCITY_SCALE
from silem.envs.bullet.simulator import State

OBSERVATION_BOUND = 5.0  # observations are clipped to +- this

_TARGET_M = 1e3  # the body runs along x towards a point a kilometre away
_ELECTRICITY_COST = -2.0
_STALL_COST = -0.1
_LIMIT_COST = -0.1
_JOINT_VELOCITY_SCALE = 0.1


def observation_space(body: BulletBody) -> gymnasium.spaces.Box:
    """Return the space of observations (O,): see `LocomotionTask`."""
    bound, shape = OBSERVATION_BOUND, (body.observation_size,)
    return gymnasium.spaces.Box(-bound, bound, shape, np.float32)


class LocomotionTask:
    """Observation and reward of one body, and the tally of its running episode.

    It is made of a body, the limits in rad of its motors' joints, and the steps after which an
    episode ends without having terminated.

    The observation (O,) is: the root's height above its start; sine and cosine of the angle to
    the target; 0.3 times the root's velocity in m/s in its own heading (forward, left, up); roll
    and pitch in rad; then per motor the angle, scaled to -1..1 between its limits, and 0.1 times
    the velocity in rad/s; then 1 or 0 per foot for floor contact. As in PyBullet's tasks the
    contacts, in the observation and in the alive rule, are those of one step before. Whoever
    hands an observation out clips it, see `as_observations`.

    Attributes:
        terminated: Whether the last step ended the episode, by the alive rule or because it left
            numbers that are not finite; the observation is then zero and the reward -1.
    """

    def __init__(
        self, body: BulletBody, limits: Sequence[tuple[float, float]], max_steps: float = math.inf
    ) -> None:
        self._max_steps, self._step_s = max_steps, body.control_step_s
        self._terminates = body.alive.terminates
        self._min_height_m, self._max_pitch_rad = body.alive.min_height_m, body.alive.max_pitch_rad
        self._no_contact = [body.feet.index(name) for name in body.alive.no_contact]
        self._weights = [part.weight / body.n_parts for part in body.parts]
        scales = [2 / (upper - lower) for lower, upper in limits]
        self._ranges = [(s, -lower * s - 1) for s, (lower, _) in zip(scales, limits, strict=True)]
        self._at_rest = [0.0] * len(limits)
        self._no_foot = [0.0] * len(body.feet)

    def begin(self, state: State) -> list[float]:
        """Start an episode and return its first observation (O,), not yet clipped."""
        self.length = self._n_upright = 0
        self.terminated = False
        self._return = 0.0
        self._contact = self._no_foot
        self._start_x_m, _, self._start_height_m = self._position = state.parts[0]
        observation, self._distance_m, _ = self._observe(state, self._at_rest)
        return observation

    def step(self, action: Sequence[float], state: State) -> tuple[list[float], float, bool]:
        """Score the step by an action (J,), as the policy gave it, to a state.

        Returns:
            Observation (O,), not yet clipped, reward, and whether the episode ends here.
        """
        observation, distance_m, costs = self._observe(state, action)
        upright = self._is_upright(state)
        progress = (self._distance_m - distance_m) / self._step_s
        reward = progress + costs + (1.0 if upright else -1.0)
        self.terminated = self._terminates and not upright
        if not math.isfinite(reward):  # the physics exploded
            observation, reward, self.terminated = [0.0] * len(observation), -1.0, True
        else:
            self._position = state.parts[0]
        self._distance_m = distance_m
        self._contact = state.contact
        self._n_upright += upright
        self._return += reward
        self.length = length = self.length + 1
        return observation, reward, self.terminated or length >= self._max_steps

    def summary(self) -> dict[str, float]:
        """Return the episode so far: return `r`, length `l`, `speed_m_s` and `upright`."""
        distance_m = self._position[0] - self._start_x_m
        return {
            "r": self._return,
            "l": self.length,
            "speed_m_s": distance_m / (self.length * self._step_s),
            "upright": self._n_upright / self.length,
        }

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
        cos, sin = math.cos(yaw), math.sin(yaw)
        observation = [
            parts[0][2] - self._start_height_m,
            (aside * cos - ahead * sin) / distance,
            (ahead * cos + aside * sin) / distance,
            _VELOCITY_SCALE * (vx * cos + vy * sin),
            _VELOCITY_SCALE * (vy * cos - vx * sin),
            _VELOCITY_SCALE * vz,
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
            if not -_AT_LIMIT <= angle <= _AT_LIMIT:
                n_at_limit += 1
        observation += self._contact
        costs = (_ELECTRICITY_COST * power + _STALL_COST * stall) / len(action)
        return observation, distance, costs + _LIMIT_COST * n_at_limit


def as_observations(observations: Sequence[Sequence[float]] | Sequence[float]) -> np.ndarray:
    """Return observations as a float32 array, clipped to the bounds of the observation space."""
    array = np.array(observations, dtype=np.float32)
    return array.clip(-OBSERVATION_BOUND, OBSERVATION_BOUND, out=array)
