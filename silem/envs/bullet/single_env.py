"""One body as a Gymnasium environment, over the same simulator and task as the batched one."""

from __future__ import annotations

from typing import Any, SupportsFloat

import gymnasium
import numpy as np

from silem import bodies
from silem.bodies import BulletBody
from silem.envs.base import check_actions
from silem.envs.bullet.camera import Camera
from silem.envs.bullet.simulator import STEP_S, Simulator
from silem.envs.bullet.task import LocomotionTask, as_observations
from silem.envs.bullet.vec_env import spaces, start_angles
from silem.envs.filmed import Filmed
from silem.util.errors import SilemError, choose


class BulletEnv(Filmed, gymnasium.Env[np.ndarray, np.ndarray]):
    """One body on its track; `gymnasium.make("silem/HC0-v0")` makes it with a limit of steps."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": round(1 / STEP_S)}  # noqa: RUF012

    def __init__(
        self, body: str, render_mode: str | None = None, width: int = 640, height: int = 480
    ) -> None:
        """Make the environment; the simulator is built by the first `reset`.

        Args:
            body: Name of the body.
            render_mode: "rgb_array" to be able to render, or None.
            width: Of the pictures, in pixels.
            height: Of the pictures, in pixels.

        Raises:
            SilemError: If the body or the render mode is unknown.
        """
        self.body = bodies.of_kind(body, BulletBody)
        if render_mode is not None:
            choose("render mode", render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self.observation_space, self.action_space = spaces(self.body)
        self.picture_size = (width, height)
        self._simulator: Simulator | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; a seed makes it, and what follows, repeatable.

        Returns:
            The first observation (O,), float32, and an empty info.
        """
        super().reset(seed=seed)
        if self._simulator is None:
            self._simulator = Simulator(self.body)
            self._task = LocomotionTask(self.body, self._simulator.limits)
        state = self._simulator.reset(start_angles(self.np_random, self.body))
        return as_observations(self._task.begin(state)), {}

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step by one control step.

        Args:
            action: (A,); beyond -1..1 the torque is clipped, the cost is not.

        Returns:
            Observation (O,), float32, reward, whether the body has fallen, False, an empty info.

        Raises:
            SilemError: If the action has another shape or is not finite, or before `reset`.
        """
        row = check_actions(action, (self.body.action_size,)).tolist()
        if self._simulator is None:
            raise SilemError("step before reset")
        self._simulator.advance(row)
        observation, reward, fallen = self._task.step(row, self._simulator.read())
        return as_observations(observation), reward, fallen, False, {}

    def render(self) -> np.ndarray | None:
        """Return a picture (H, W, 3), uint8, or None without a render mode.

        Raises:
            SilemError: Before `reset`.
        """
        return None if self.render_mode is None else self._picture()

    def _is_reset(self) -> bool:
        return self._simulator is not None

    def _make_camera(self) -> Camera:
        assert self._simulator is not None
        return Camera(self._simulator, *self.picture_size)

    def close(self) -> None:
        """Disconnect the simulator; closing twice is allowed."""
        if self._simulator is not None:
            self._simulator.close()
        self._simulator = self._camera = None
