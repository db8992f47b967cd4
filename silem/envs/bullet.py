"""N PyBullet clients behind one stable-baselines3 VecEnv."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from silem import bodies
from silem.bodies import Body
from silem.envs.rendering import Camera
from silem.envs.simulator import Simulator
from silem.envs.tasks import OBSERVATION_BOUND, LocomotionTask, as_observations
from silem.errors import SilemError, choose

JOINT_NOISE_RAD = 0.1  # joints start within +- this of the model's pose
MAX_STEPS = 1000


def spaces(body: Body) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
    """Return a body's observation space and action space."""
    observation = gymnasium.spaces.Box(
        -OBSERVATION_BOUND, OBSERVATION_BOUND, (body.observation_size,), np.float32
    )
    return observation, gymnasium.spaces.Box(-1.0, 1.0, (body.action_size,), np.float32)


def start_angles(generator: np.random.Generator, body: Body) -> list[float]:
    """Draw (J,) joint angles in rad for an episode's start."""
    angles = generator.uniform(-JOINT_NOISE_RAD, JOINT_NOISE_RAD, body.action_size)
    return angles.tolist()


def checked_actions(actions: Any, shape: tuple[int, ...]) -> list[list[float]]:
    """Return actions of the given shape as rows of A numbers.

    Raises:
        SilemError: If the shape is another, or a number is not finite.
    """
    try:
        array = np.asarray(actions, dtype=np.float32)
    except (TypeError, ValueError) as error:
        raise SilemError(f"actions are not numbers: {error}") from error
    if array.shape != shape:
        raise SilemError(f"actions of shape {array.shape}; expected {shape}")
    rows: list[list[float]] = array.reshape(-1, shape[-1]).tolist()
    if not math.isfinite(sum(map(sum, rows))):
        raise SilemError("actions contain NaN or infinity")
    return rows


class BulletVecEnv(VecEnv):
    """E environments with the same body, stepped in turn in one process.

    An environment that ends is reset at once, as stable-baselines3 expects. Its info then holds
    `terminal_observation` (O,), `TimeLimit.truncated` (whether only the step limit ended it) and
    `episode`: return `r`, length `l`, seconds since the environments were built `t`, mean forward
    speed of the torso `speed_m_s`, and share of steps upright `upright`.

    After `seed(s)`, `reset()` builds all clients afresh, so everything that follows equals, bit
    for bit, a newly made instance with that seed, whatever happened before.

    Attributes:
        body: The body.
        max_steps: Steps after which an episode is cut off.
        simulators: The E simulators; empty before the first `reset` and after `close`.
    """

    def __init__(
        self,
        body: Body | str,
        n_envs: int = 4,
        seed: int = 0,
        max_steps: int = MAX_STEPS,
        render_mode: str | None = "rgb_array",
    ) -> None:
        """Make the environments; the clients are built by the first `reset`.

        Args:
            body: A body or its name.
            n_envs: E, at least 1.
            seed: Root of all environments' random streams.
            max_steps: Steps after which an episode is cut off.
            render_mode: "rgb_array" or None.

        Raises:
            SilemError: If an argument is not allowed.
        """
        self.body = bodies.get(body) if isinstance(body, str) else body
        for name, value in (("n_envs", n_envs), ("max_steps", max_steps)):
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
                raise SilemError(f"{name} is {value!r}; allowed: whole numbers from 1")
        self.render_mode = render_mode
        self.max_steps = int(max_steps)
        self.simulators: list[Simulator] = []
        self._generators: list[np.random.Generator] = []
        self._camera: Camera | None = None
        self._actions: list[list[float]] | None = None
        self._built_at = time.perf_counter()
        super().__init__(int(n_envs), *spaces(self.body))
        self.seed(seed)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the root seed; it takes effect at the next `reset`.

        Args:
            seed: Root of all environments' random streams; None draws one.

        Raises:
            SilemError: If the seed is negative or not a whole number.
        """
        if seed is not None and (not isinstance(seed, int | np.integer) or seed < 0):
            raise SilemError(f"seed is {seed!r}; allowed: whole numbers from 0")
        root = np.random.SeedSequence(None if seed is None else int(seed))
        self._next_generators = [np.random.default_rng(s) for s in root.spawn(self.num_envs)]
        return [seed] * self.num_envs

    def reset(self) -> np.ndarray:
        """Start a new episode in every environment.

        Returns:
            (E, O) first observations, float32.
        """
        if self._next_generators or not self.simulators:
            self._rebuild()
        self.reset_infos = [{} for _ in range(self.num_envs)]
        self._actions = None
        return np.stack([self._begin(index) for index in range(self.num_envs)])

    def step_async(self, actions: np.ndarray) -> None:
        """Take (E, A) actions for the next `step_wait`.

        Raises:
            SilemError: If they have another shape or are not finite.
        """
        self._actions = checked_actions(actions, (self.num_envs, self.body.action_size))

    def step_wait(self) -> VecEnvStepReturn:
        """Step every environment by one control step.

        Returns:
            Observations (E, O) and rewards (E,), float32, dones (E,) and E infos.

        Raises:
            SilemError: If the environments were not reset, or there is no action.
        """
        if not self.simulators or self._actions is None:
            raise SilemError("step before reset, or step_wait without step_async")
        actions, self._actions = self._actions, None
        # One kind of work after the other, so that its code is still in the processor's caches.
        for simulator, action in zip(self.simulators, actions, strict=True):
            simulator.advance(action)
        states = [simulator.read() for simulator in self.simulators]
        moves = zip(self._tasks, actions, states, strict=True)
        results = [task.step(action, state) for task, action, state in moves]
        raw_observations, rewards, dones = zip(*results, strict=True)
        observations = as_observations(raw_observations)
        infos: list[dict[str, Any]] = [{} for _ in dones]
        if True in dones:
            for index in np.flatnonzero(dones).tolist():
                infos[index] = self._last_info(index, observations[index].copy())
                observations[index] = self._begin(index)
        return observations, np.array(rewards, dtype=np.float32), np.array(dones), infos

    def render(self, mode: str | None = None) -> np.ndarray:
        """Return a picture (H, W, 3), uint8, of the first environment.

        Args:
            mode: "rgb_array" or None, which means the same.

        Raises:
            SilemError: For any other mode, or before the first reset.
        """
        choose("render mode", mode or "rgb_array", ["rgb_array"])
        if not self.simulators:
            raise SilemError("render before reset")
        if self._camera is None:
            self._camera = Camera(self.simulators[0])
        return self._camera.picture()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """Return the picture of the first environment, the only one that is drawn."""
        return [self.render()]

    def close(self) -> None:
        """Disconnect all clients; closing twice is allowed."""
        for simulator in self.simulators:
            simulator.close()
        self.simulators, self._camera = [], None

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute, which all environments share, once per index."""
        value = getattr(self, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Refuse: the environments share their attributes.

        Raises:
            SilemError: Always.
        """
        raise SilemError(f"{attr_name!r} of a BulletVecEnv cannot be set per environment")

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Refuse: there are no separate environment objects to call.

        Raises:
            SilemError: Always.
        """
        raise SilemError(f"a BulletVecEnv has no environments with a method {method_name!r}")

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Return False once per index: there are no wrappers."""
        return [False for _ in self._get_indices(indices)]

    def _rebuild(self) -> None:
        """Build all clients afresh, with the random streams of the latest seed."""
        self.close()
        self._generators = self._next_generators or self._generators
        self._next_generators = []
        self.simulators = [Simulator(self.body) for _ in range(self.num_envs)]
        self._tasks = [
            LocomotionTask(self.body, sim.limits, self.max_steps) for sim in self.simulators
        ]

    def _begin(self, index: int) -> np.ndarray:
        """Start an episode of one environment and return its first observation (O,)."""
        angles = start_angles(self._generators[index], self.body)
        state = self.simulators[index].reset(angles)
        return as_observations(self._tasks[index].begin(state))

    def _last_info(self, index: int, observation: np.ndarray) -> dict[str, Any]:
        """Return the info of an episode that has just ended with this observation (O,)."""
        task = self._tasks[index]
        return {
            "terminal_observation": observation,
            "TimeLimit.truncated": not task.terminated,
            "episode": task.summary() | {"t": time.perf_counter() - self._built_at},
        }
