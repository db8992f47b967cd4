"""One humanoid as a Gymnasium environment, over the same simulation and task as the batch."""

from __future__ import annotations

from typing import Any, SupportsFloat

import gymnasium
import numpy as np

from silem.bodies import Body
from silem.envs.base import check_actions
from silem.envs.filmed import Filmed
from silem.envs.mujoco import task as walking
from silem.envs.mujoco.camera import MujocoCamera
from silem.envs.mujoco.simulator import Simulation, StartStates, body_of, start_state
from silem.envs.mujoco.vec_env import features_of, spaces
from silem.util.errors import SilemError, choose


class MujocoEnv(Filmed, gymnasium.Env[np.ndarray, np.ndarray]):
    """One humanoid that learns to walk; `gymnasium.make("silem/Humanoid-v0")` limits its steps."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 40}  # noqa: RUF012

    def __init__(
        self,
        body: Body | str,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        *,
        speed_m_s: float = walking.DEMONSTRATOR_SPEED_M_S,
        starts: StartStates | None = None,
    ) -> None:
        """Make the environment; the simulation is built by the first `reset`.

        Args:
            body: A body or its name.
            render_mode: "rgb_array" to be able to render, or None.
            width: Of the pictures, in pixels.
            height: Of the pictures, in pixels.
            speed_m_s: Speed that earns the full reward.
            starts: States that episodes start from; None means the standing pose, small noise.

        Raises:
            SilemError: If the body or the render mode is unknown.
        """
        self.body = body_of(body)
        if render_mode is not None:
            choose("render mode", render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self.observation_space, self.action_space = spaces(self.body)
        self.picture_size, self._speed_m_s, self._starts = (width, height), speed_m_s, starts
        self._simulation: Simulation | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; a seed makes it, and what follows, repeatable.

        Returns:
            The first observation (O,), float32, and an info with "skeletal_features" (F,).
        """
        super().reset(seed=seed)
        if self._simulation is None:
            self._simulation = Simulation(self.body, 1)
        self._simulation.place(0, *start_state(self.np_random, self.body, self._starts))
        reading = self._simulation.read()
        features = features_of(reading)
        return walking.observe(reading, features)[0], {"skeletal_features": features[0]}

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step by one control step.

        Args:
            action: (A,); clipped to -1..1.

        Returns:
            Observation (O,), float32, reward, whether the body has fallen, False, and an info
            with "skeletal_features" (F,).

        Raises:
            SilemError: If the action has another shape or is not finite, or before `reset`.
        """
        actions = check_actions(action, (self.body.action_size,)).clip(-1.0, 1.0)[None]
        if self._simulation is None:
            raise SilemError("step before reset")
        (failed,) = self._simulation.advance(actions)
        reading = self._simulation.read()
        reward = walking.rewards(reading, actions, self.body.standing_head_m, self._speed_m_s)[0]
        fallen = failed or bool(reading.head_m[0] < self.body.fall_head_m)
        features = features_of(reading)
        observation = walking.observe(reading, features)[0]
        info = {"skeletal_features": features[0]}
        return observation, 0.0 if failed else float(reward), fallen, False, info

    def render(self) -> np.ndarray | None:
        """Return a picture (H, W, 3), uint8, or None without a render mode.

        Raises:
            SilemError: Before `reset`, or without offscreen rendering.
        """
        return None if self.render_mode is None else self._picture()

    def _is_reset(self) -> bool:
        return self._simulation is not None

    def _make_camera(self) -> MujocoCamera:
        assert self._simulation is not None
        return MujocoCamera(self._simulation, *self.picture_size)

    def close(self) -> None:
        """Give back the renderer; closing twice is allowed."""
        if isinstance(self._camera, MujocoCamera):
            self._camera.close()
        self._simulation = self._camera = None
