"""What all environments share, single and batched: arguments, seeds, pictures, what is refused.

A simulator's environments say how an episode begins and goes on.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from silem import bodies
from silem.bodies import Body
from silem.envs.camera import Camera
from silem.util.errors import SilemError, choose

RENDER_MODES = ("rgb_array",)


def check_actions(actions: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return actions of the given shape as float32.

    Raises:
        SilemError: If the shape is another, or a number is not finite.
    """
    try:
        array = np.asarray(actions, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise SilemError(f"actions are not numbers: {error}") from error
    if array.shape != shape:
        raise SilemError(f"actions of shape {array.shape}; expected {shape}")
    if not math.isfinite(np.add.reduce(array, axis=None)):
        raise SilemError("actions contain NaN or infinity")
    return array


class Filmed:
    """A body's environment, with a camera that is set up when the first picture is wanted.

    Attributes:
        body: The body.
        render_mode: "rgb_array" to be able to render, or None.
        metadata: The render modes there are, and as `render_fps` the control steps per second.
        picture_size: Width and height in pixels, to be set before the first picture.
    """

    body: Body
    render_mode: str | None
    metadata: dict[str, Any]
    picture_size: tuple[int, int] = (640, 480)
    _kind: type[Body]
    _space: Callable[[Any], gymnasium.spaces.Box]  # of a body's observations
    _is_reset: bool = False  # whether there is an episode to go on with
    _camera: Camera | None = None

    def _set_up(
        self, body: Body | str, render_mode: str | None
    ) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
        """Take the body and return the spaces of its observations and actions."""
        self.body = bodies.of_kind(body, self._kind)
        if render_mode is not None:
            choose("render mode", render_mode, RENDER_MODES)
        self.render_mode = render_mode
        fps = round(1 / self.body.control_step_s)
        self.metadata = {"render_modes": list(RENDER_MODES), "render_fps": fps}
        actions = gymnasium.spaces.Box(-1.0, 1.0, (self.body.action_size,), np.float32)
        return self._space(self.body), actions

    def _prepare(self, n: int, **options: Any) -> None:
        """Prepare N bodies; the options are those of the simulator's environments."""
        if options:
            raise TypeError(f"{type(self).__name__} takes no {', '.join(options)}")

    def _qpos(self) -> np.ndarray:
        """Return the joint positions (nq,) of the body, or of the first of several."""
        raise NotImplementedError

    def _picture(self) -> np.ndarray:
        """Return a picture (H, W, 3), uint8; raises SilemError where there can be none."""
        if not self._is_reset:
            raise SilemError("render before reset")
        if self._camera is None:
            self._camera = Camera(self.body, *self.picture_size)
        return self._camera.picture(self._qpos())

    def close(self) -> None:
        """Give back the camera; closing twice is allowed."""
        self._is_reset = False
        if self._camera is not None:
            self._camera.close()
            self._camera = None


class SingleEnv(Filmed, gymnasium.Env[np.ndarray, np.ndarray]):
    """One body as a Gymnasium environment; `gymnasium.make("silem/HC0-v0")` limits its steps."""

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012

    def __init__(
        self,
        body: Body | str,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        **options: Any,
    ) -> None:
        """Make the environment.

        Args:
            body: A body or its name.
            render_mode: "rgb_array" to be able to render, or None.
            width: Of the pictures, in pixels.
            height: Of the pictures, in pixels.
            **options: What the class names.

        Raises:
            SilemError: If an argument is not allowed.
        """
        self.observation_space, self.action_space = self._set_up(body, render_mode)
        self.picture_size = width, height
        self._prepare(1, **options)

    def _begin(self) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; return its first observation (O,) and info."""
        raise NotImplementedError

    def _advance(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, dict[str, Any]]:
        """Step by one control step; return observation (O,), reward, whether it fell, info."""
        raise NotImplementedError

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; a seed makes it, and what follows, repeatable.

        Returns:
            The first observation (O,), float32, and the body's info (see `step`).
        """
        super().reset(seed=seed)
        begun = self._begin()
        self._is_reset = True
        return begun

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step by one control step.

        Args:
            action: (A,); torques are clipped at -1 and 1.

        Returns:
            Observation (O,), float32, reward, whether the body has fallen, False, and an info:
            humanoids' with "skeletal_features" (F,), others' empty.

        Raises:
            SilemError: If the action has another shape or is not finite, or before `reset`.
        """
        checked = check_actions(action, (self.body.action_size,))
        if not self._is_reset:
            raise SilemError("step before reset")
        observation, reward, fallen, info = self._advance(checked)
        return observation, reward, fallen, False, info

    def render(self) -> np.ndarray | None:
        """Return a picture (H, W, 3), uint8, or None without a render mode.

        Raises:
            SilemError: Before `reset`, or where nothing can be drawn.
        """
        return None if self.render_mode is None else self._picture()


class BatchedEnv(Filmed, VecEnv):
    """E environments with the same body, behind one object.

    An environment that ends is reset at once, as stable-baselines3 expects. Its info then holds
    `terminal_observation` (O,), `TimeLimit.truncated` (whether only the step limit ended it) and,
    as from stable-baselines3's `Monitor`, `episode`: return `r`, length `l`, seconds since the
    environments were built `t`, beside it mean speed `speed_m_s` and share of the steps upright
    `upright`.

    After `seed(s)`, `reset()` makes everything that follows equal, bit for bit, to a newly made
    instance with that seed, whatever happened before.

    Attributes:
        max_steps: Steps after which an episode is cut off.
    """

    def __init__(
        self,
        body: Body | str,
        n_envs: int = 4,
        seed: int = 0,
        max_steps: int | None = None,
        render_mode: str | None = "rgb_array",
        **options: Any,
    ) -> None:
        """Make the environments.

        Args:
            body: A body or its name.
            n_envs: E, at least 1.
            seed: Root of all environments' random streams.
            max_steps: Steps after which an episode is cut off; None means the body's.
            render_mode: "rgb_array" or None.
            **options: What the class names.

        Raises:
            SilemError: If an argument is not allowed.
        """
        spaces = self._set_up(body, render_mode)
        max_steps = self.body.max_steps if max_steps is None else max_steps
        for name, value in (("n_envs", n_envs), ("max_steps", max_steps)):
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
                raise SilemError(f"{name} is {value!r}; allowed: whole numbers from 1")
        self.max_steps = int(max_steps)
        self._generators: list[np.random.Generator] = []
        self._built_at = time.perf_counter()
        self._actions: np.ndarray | None = None
        metadata = self.metadata
        super().__init__(int(n_envs), *spaces)
        self.metadata = metadata  # stable-baselines3 promises "human", and no frames per second
        self.seed(seed)
        self._prepare(self.num_envs, **options)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the root of all random streams, None to draw one, for the next `reset`.

        Raises:
            SilemError: If the seed is negative or not a whole number.
        """
        if seed is not None and (not isinstance(seed, int | np.integer) or seed < 0):
            raise SilemError(f"seed is {seed!r}; allowed: whole numbers from 0")
        root = np.random.SeedSequence(None if seed is None else int(seed))
        self._next_generators = [np.random.default_rng(s) for s in root.spawn(self.num_envs)]
        return [seed] * self.num_envs

    def _restart(self, is_seeded: bool) -> np.ndarray:
        """Start an episode everywhere, fill `reset_infos`, return first observations (E, O)."""
        raise NotImplementedError

    def _advance(self, actions: np.ndarray) -> VecEnvStepReturn:
        """Do what `step_wait` does, with these actions (E, A)."""
        raise NotImplementedError

    def reset(self) -> np.ndarray:
        """Start a new episode in every environment; return first observations (E, O), float32."""
        is_seeded = bool(self._next_generators)
        if is_seeded:
            self._generators, self._next_generators = self._next_generators, []
        self._actions = None
        observations = self._restart(is_seeded)
        self._is_reset = True
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Take (E, A) actions for the next `step_wait`.

        Raises:
            SilemError: If they have another shape or are not finite.
        """
        self._actions = check_actions(actions, (self.num_envs, self.body.action_size))

    def step_wait(self) -> VecEnvStepReturn:
        """Step every environment by one control step.

        Returns:
            Observations (E, O) and rewards (E,), float32, dones (E,) and E infos.

        Raises:
            SilemError: If the environments were not reset, or there is no action.
        """
        if self._actions is None or not self._is_reset:
            raise SilemError("step before reset, or step_wait without step_async")
        actions, self._actions = self._actions, None
        return self._advance(actions)

    def _last_info(
        self, observation: np.ndarray, terminated: bool, episode: dict[str, float]
    ) -> dict[str, Any]:
        """Return the info of an episode that ends with an observation (O,)."""
        return {
            "terminal_observation": observation,
            "TimeLimit.truncated": not terminated,
            "episode": episode | {"t": time.perf_counter() - self._built_at},
        }

    def render(self, mode: str | None = None) -> np.ndarray:
        """Return a picture (H, W, 3), uint8, of the first environment; no mode is "rgb_array".

        Raises:
            SilemError: For any other mode, in environments without a render mode, before the first
                reset, or where nothing can be drawn.
        """
        choose("render mode", mode or "rgb_array", RENDER_MODES)
        if self.render_mode is None:
            raise SilemError("no pictures with render_mode None; allowed: render_mode='rgb_array'")
        return self._picture()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return the picture of the first environment, the only one that is drawn."""
        return [self.render()]

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute, which all environments share, once per index."""
        value = getattr(self, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of all environments, which share it.

        Raises:
            SilemError: If there is no such attribute, or it is to be set in some of them only.
        """
        if not hasattr(self, attr_name):
            raise SilemError(f"a {type(self).__name__} has no attribute {attr_name!r} to set")
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise SilemError(f"{attr_name!r} is shared: it can be set in all environments only")
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Refuse: there are no separate environment objects to call.

        Raises:
            SilemError: Always.
        """
        raise SilemError(
            f"a {type(self).__name__} has no environments with a method {method_name!r}"
        )

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Tell once per index whether the environments do what a wrapper does.

        There are no wrappers, but an episode's last info is what `Monitor` would put there.
        """
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]
