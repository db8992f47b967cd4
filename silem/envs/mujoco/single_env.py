"""One humanoid as a Gymnasium environment, over the same simulation and task as the batch."""

from __future__ import annotations

from typing import Any

import numpy as np

from silem.bodies import Body, MujocoBody
from silem.envs.base import SingleEnv
from silem.envs.mujoco.camera import MujocoCamera
from silem.envs.mujoco.simulator import Simulation, StartStates, body_of, start_state
from silem.envs.mujoco.task import observation_space, observe, rewards, target_speed


class MujocoEnv(SingleEnv):
    """One humanoid that learns to walk."""

    body: MujocoBody

    def __init__(
        self,
        body: Body | str,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        *,
        speed_m_s: float | None = None,
        starts: StartStates | None = None,
    ) -> None:
        """Make the environment; the simulation is built by the first `reset`.

        Args:
            body: A body or its name.
            render_mode: "rgb_array" to be able to render, or None.
            width: Of the pictures, in pixels.
            height: Of the pictures, in pixels.
            speed_m_s: Speed that earns the full reward; None means the body's.
            starts: States that episodes start from; None means the standing pose, small noise.

        Raises:
            SilemError: If the body or the render mode is unknown, or the speed not above 0.
        """
        learner = body_of(body)
        self._speed_m_s, self._starts = target_speed(learner, speed_m_s), starts
        self._simulation: Simulation | None = None
        super().__init__(learner, observation_space(learner), render_mode, (width, height))

    def _begin(self) -> tuple[np.ndarray, dict[str, Any]]:
        if self._simulation is None:
            self._simulation = Simulation(self.body, 1)
        self._simulation.place(0, *start_state(self.np_random, self.body, self._starts))
        reading = self._simulation.read()
        features = reading.features()
        return observe(reading, features)[0], {"skeletal_features": features[0]}

    def _advance(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, dict[str, Any]]:
        assert self._simulation is not None
        actions = action.clip(-1.0, 1.0)[None]
        failed = bool(self._simulation.advance(actions)[0])
        reading = self._simulation.read()
        reward = rewards(reading, actions, self.body.standing_head_m, self._speed_m_s)[0]
        fallen = failed or bool(reading.head_m[0] < self.body.fall_head_m)
        features = reading.features()
        info = {"skeletal_features": features[0]}
        return observe(reading, features)[0], 0.0 if failed else float(reward), fallen, info

    def _is_reset(self) -> bool:
        return self._simulation is not None

    def _make_camera(self) -> MujocoCamera:
        assert self._simulation is not None
        return MujocoCamera(self._simulation, *self.picture_size)

    def close(self) -> None:
        """Give back simulation and renderer; closing twice is allowed."""
        super().close()
        self._simulation = None
