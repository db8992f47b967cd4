"""One body as a Gymnasium environment, over the same simulator and task as the batched one."""

from __future__ import annotations

from typing import Any

import numpy as np

from silem.bodies import Body, BulletBody
from silem.envs.base import SingleEnv
from silem.envs.bullet.camera import Camera
from silem.envs.bullet.simulator import Simulator, body_of, start_angles
from silem.envs.bullet.task import LocomotionTask, as_observations, observation_space


class BulletEnv(SingleEnv):
    """One body on its track."""

    body: BulletBody

    def __init__(
        self,
        body: Body | str,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
    ) -> None:
        """Make the environment; the simulator is built by the first `reset`.

        Args:
            body: A body or its name.
            render_mode: "rgb_array" to be able to render, or None.
            width: Of the pictures, in pixels.
            height: Of the pictures, in pixels.

        Raises:
            SilemError: If the body or the render mode is unknown.
        """
        learner = body_of(body)
        self._simulator: Simulator | None = None
        space = observation_space(learner)
        super().__init__(learner, space, render_mode, (width, height))

    def _begin(self) -> tuple[np.ndarray, dict[str, Any]]:
        if self._simulator is None:
            self._simulator = Simulator(self.body)
            self._task = LocomotionTask(self.body, self._simulator.limits)
        state = self._simulator.reset(start_angles(self.np_random, self.body))
        return as_observations(self._task.begin(state)), {}

    def _advance(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, dict[str, Any]]:
        assert self._simulator is not None
        row = action.tolist()
        self._simulator.advance(row)
        observation, reward, fallen = self._task.step(row, self._simulator.read())
        return as_observations(observation), reward, fallen, {}

    def _is_reset(self) -> bool:
        return self._simulator is not None

    def _make_camera(self) -> Camera:
        assert self._simulator is not None
        return Camera(self._simulator, *self.picture_size)

    def close(self) -> None:
        """Disconnect the simulator; closing twice is allowed."""
        super().close()
        if self._simulator is not None:
            self._simulator.close()
        self._simulator = None
