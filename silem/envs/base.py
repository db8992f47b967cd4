"""Environments of a body, one by itself or E in a batch, whichever simulator moves it.

A simulator is a module of this package with a `Simulation`: E bodies and the task that they do.
The rest is here: arguments, seeds, episodes and what is told of them, pictures, what is refused.
"""

import functools
import importlib
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, SupportsFloat

import gymnasium
import numpy as np
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from silem import bodies
from silem.bodies import Body
from silem.envs.camera import Camera
from silem.util.errors import COUNT, SilemError, choose

RENDER_MODES = ("rgb_array",)
SIMULATORS = ("bullet", "mujoco")

INFO_KEY = "skeletal_features"
"""Under which an environment's infos hold g(s), where it has a g of its own."""

Infos = list[dict[str, Any]]
Generators = Sequence[np.random.Generator]
Stepped = tuple[np.ndarray, np.ndarray, np.ndarray, Infos]


def make_vec(
    body: Body | str, n_envs: int = 4, seed: int = 0, max_steps: int | None = None, **options: Any
) -> VecEnv:
    """Make E environments with the same body, stepped as one.

    Args:
        body: A body or its name, for example "HC2", or the id of a Gymnasium environment.
        n_envs: E, at least 1.
        seed: Root of all environments' random streams.
        max_steps: Steps after which an episode is cut off; None means the body's.
        **options: A Gymnasium environment's own, or a humanoid's: `n_threads` that step it
            (results do not depend on them), `speed_m_s` that earns the full reward (None means
            the body's), as `starts` states that episodes start from, positions (S, nq) and
            velocities (S, nv) (None means the standing pose, small noise), and as `bodies` E
            humanoids of other lengths, one for each environment in the place of `body`.

    Raises SilemError if an argument is not allowed; the message says what is.
    """
    found = bodies.get(body) if isinstance(body, str) else body
    if found.engine != "gymnasium":
        return BatchedEnv(found, n_envs, seed, max_steps, **options)
    COUNT.check("n_envs", n_envs)
    limit = found.max_steps if max_steps is None else max_steps
    make = functools.partial(gymnasium.make, found.name, max_episode_steps=limit, **options)
    try:
        env = DummyVecEnv([lambda: Monitor(make()) for _ in range(n_envs)])
    except (gymnasium.error.Error, TypeError, ImportError) as error:
        raise SilemError(f"{found.name} cannot be made: {error}") from error
    env.seed(seed)
    return env


class Simulation(ABC):
    """E bodies in their simulator, and the task that they do: what an environment drives."""

    observation_space: gymnasium.spaces.Box
    filmed: Body | None = None  #: the first body, where it is another one than the environment's

    @abstractmethod
    def begin(self, indices: np.ndarray, generators: Generators) -> tuple[np.ndarray, Infos]:
        """Start an episode of some bodies (n,); return first observations (n, O) and infos."""

    @abstractmethod
    def step(self, actions: np.ndarray) -> Stepped:
        """Step by actions (E, A); return observations (E, O), rewards, who fell, both (E,), infos.

        The arrays are new ones. A body that fell is left as it is.
        """

    @abstractmethod
    def summary(self, index: int, n_steps: int, max_steps: int) -> dict[str, float]:
        """Return `speed_m_s` and `upright` of an episode that has run for a number of steps."""

    @abstractmethod
    def pose(self) -> np.ndarray:
        """Return the joint positions (nq,) of the first body, as MuJoCo orders them."""

    def close(self) -> None:  # noqa: B027  not every simulator has anything to give back
        """Forget the past: what `begin` gives next is as new; closing twice is allowed."""


class WithFeatures(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Any environment, with skeletal features of one's own in its infos.

    Imitation learners compare these with the demonstrations', and act on observations as they are.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], g: Callable[[Any], Sequence[float] | np.ndarray]
    ) -> None:
        """Wrap an environment; `g` takes an observation and returns features (F,)."""
        super().__init__(env)
        self._g = g

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        observation, info = super().reset(seed=seed, options=options)
        return observation, info | {INFO_KEY: np.asarray(self._g(observation), np.float32)}

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step by an action."""
        observation, *told, info = super().step(action)
        return observation, *told, info | {INFO_KEY: np.asarray(self._g(observation), np.float32)}


class _Filmed:
    """A body's simulation, with a camera that is set up when the first picture is wanted.

    Attributes:
        body: The body.
        simulation: What steps it.
        render_mode: "rgb_array" to be able to render, or None.
        metadata: The render modes there are, and as `render_fps` the control steps per second.
        picture_size: Width and height in pixels, to be set before the first picture.
    """

    picture_size: tuple[int, int] = (640, 480)
    metadata: dict[str, Any]
    _is_reset = False  # whether there is an episode to go on with
    _camera: Camera | None = None

    def _set_up(
        self, body: Body | str, n: int, render_mode: str | None, options: dict[str, Any]
    ) -> tuple[gymnasium.spaces.Box, gymnasium.spaces.Box]:
        """Prepare N bodies, and return the spaces of their observations and actions."""
        self.body = bodies.get(body) if isinstance(body, str) else body
        if render_mode is not None:
            choose("render mode", render_mode, RENDER_MODES)
        self.render_mode = render_mode
        fps = round(1 / self.body.control_step_s)
        self.metadata = {"render_modes": list(RENDER_MODES), "render_fps": fps}
        choose("simulator", self.body.engine, SIMULATORS)
        simulator = importlib.import_module(f"silem.envs.{self.body.engine}")
        self.simulation: Simulation = simulator.Simulation(self.body, n, **options)
        actions = gymnasium.spaces.Box(-1.0, 1.0, (self.body.action_size,), np.float32)
        return self.simulation.observation_space, actions

    def _check(self, actions: Any, shape: tuple[int, ...]) -> np.ndarray:
        """Return actions as float32; raises SilemError unless they are finite and of the shape."""
        try:
            array = np.asarray(actions, dtype=np.float32)
        except (TypeError, ValueError) as error:
            raise SilemError(f"actions are not numbers: {error}") from error
        if array.shape != shape:
            raise SilemError(f"actions of shape {array.shape}; expected {shape}")
        if not math.isfinite(np.add.reduce(array, axis=None)):
            raise SilemError("actions contain NaN or infinity")
        if not self._is_reset:
            raise SilemError("step before reset")
        return array

    def _picture(self) -> np.ndarray:
        """Return a picture (H, W, 3), uint8, of the first body."""
        if not self._is_reset:
            raise SilemError("render before reset")
        if self._camera is None:
            self._camera = Camera(self.simulation.filmed or self.body, *self.picture_size)
        return self._camera.picture(self.simulation.pose())

    def close(self) -> None:
        """Give back camera and simulator; closing twice is allowed."""
        self._is_reset = False
        self.simulation.close()
        if self._camera is not None:
            self._camera.close()
            self._camera = None


class SingleEnv(_Filmed, gymnasium.Env[np.ndarray, np.ndarray]):
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
        """Make the environment of a body, or of that name; for `options` see `make_vec`.

        Pictures of `width` times `height` pixels need the render mode "rgb_array".
        """
        self.observation_space, self.action_space = self._set_up(body, 1, render_mode, options)
        self.picture_size = width, height

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; return its first observation (O,), float32, and info, as `step` does.

        A seed makes it, and what follows, repeatable.
        """
        super().reset(seed=seed)
        (observation,), (info,) = self.simulation.begin(np.zeros(1, int), [self.np_random])
        self._is_reset = True
        return observation, info

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step by one control step with an action (A,); torques are clipped at -1 and 1.

        Returns:
            Observation (O,), float32, reward, whether the body has fallen, False, and an info:
            humanoids' with "skeletal_features" (F,), others' empty.

        Raises SilemError if the action has another shape or is not finite, or before `reset`.
        """
        action = self._check(action, (self.body.action_size,))
        (observation,), rewards, fallen, (info,) = self.simulation.step(action[None])
        return observation, float(rewards[0]), bool(fallen[0]), False, info

    def render(self) -> np.ndarray | None:
        """Return a picture (H, W, 3), uint8, or None without a render mode."""
        return None if self.render_mode is None else self._picture()


class BatchedEnv(_Filmed, VecEnv):
    """E environments with the same body, behind one object.

    An environment that ends is reset at once, as stable-baselines3 expects. Its info then holds
    `terminal_observation` (O,), `TimeLimit.truncated` (whether only the step limit ended it) and,
    as from stable-baselines3's `Monitor`, `episode`: return `r`, length `l`, seconds since the
    environments were built `t`, beside it speed `speed_m_s` and share of the steps `upright`.
    Humanoids' infos, of `reset` and `step`, hold "skeletal_features" (F,).

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
        """Make the environments, see `make_vec`; `render_mode` is "rgb_array" or None."""
        COUNT.check("n_envs", n_envs)
        spaces = self._set_up(body, int(n_envs), render_mode, options)
        metadata = self.metadata
        super().__init__(int(n_envs), *spaces)
        self.metadata = metadata  # stable-baselines3 promises "human", and no frames per second
        self.max_steps = self.body.max_steps if max_steps is None else max_steps
        COUNT.check("max_steps", self.max_steps)
        self._generators: list[np.random.Generator] = []
        self._lengths, self._returns = np.zeros(n_envs, dtype=int), np.zeros(n_envs)
        self._actions: np.ndarray | None = None
        self._built_at = time.perf_counter()
        self.seed(seed)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the root of all random streams, from 0, or None to draw it, for the next `reset`."""
        if seed is not None and (not isinstance(seed, int | np.integer) or seed < 0):
            raise SilemError(f"seed is {seed!r}; allowed: whole numbers from 0")
        root = np.random.SeedSequence(None if seed is None else int(seed))
        self._next_generators = [np.random.default_rng(s) for s in root.spawn(self.num_envs)]
        return [seed] * self.num_envs

    def reset(self) -> np.ndarray:
        """Start a new episode in every environment; return first observations (E, O), float32."""
        if self._next_generators:
            self.simulation.close()
            self._generators, self._next_generators = self._next_generators, []
        self._actions = None
        observations = self._begin(np.arange(self.num_envs))
        self._is_reset = True
        return observations

    def _begin(self, indices: np.ndarray) -> np.ndarray:
        """Start an episode in some environments (n,); return their observations (n, O)."""
        self._lengths[indices], self._returns[indices] = 0, 0.0
        chosen = indices.tolist()
        observations, infos = self.simulation.begin(indices, [self._generators[i] for i in chosen])
        for index, info in zip(chosen, infos, strict=True):
            self.reset_infos[index] = info
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Take (E, A) actions for the next `step_wait`; SilemError where they cannot be taken."""
        self._actions = self._check(actions, (self.num_envs, self.body.action_size))

    def step_wait(self) -> VecEnvStepReturn:
        """Step; return observations (E, O), rewards (E,), both float32, dones (E,) and E infos."""
        if self._actions is None:
            raise SilemError("step_wait without step_async")
        actions, self._actions = self._actions, None
        observations, rewards, fallen, infos = self.simulation.step(actions)
        self._lengths += 1
        self._returns += rewards
        dones = fallen | (self._lengths >= self.max_steps)
        if np.count_nonzero(dones):
            ended = dones.nonzero()[0]
            for index in ended.tolist():
                infos[index]["terminal_observation"] = observations[index].copy()
                infos[index]["TimeLimit.truncated"] = not fallen[index]
                n_steps, t = int(self._lengths[index]), time.perf_counter() - self._built_at
                infos[index]["episode"] = {"r": float(self._returns[index]), "l": n_steps, "t": t}
                summary = self.simulation.summary(index, n_steps, self.max_steps)
                infos[index]["episode"] |= summary
            observations[ended] = self._begin(ended)
        return observations, rewards.astype(np.float32), dones, infos

    def render(self, mode: str | None = None) -> np.ndarray:
        """Return a picture (H, W, 3), uint8, of the first environment; no mode is "rgb_array"."""
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
        """Set an attribute, which there must be, of all environments, which share it."""
        if not hasattr(self, attr_name):
            raise SilemError(f"a {type(self).__name__} has no attribute {attr_name!r} to set")
        if set(self._get_indices(indices)) != set(range(self.num_envs)):
            raise SilemError(f"{attr_name!r} is shared: it can be set in all environments only")
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Refuse: there are no separate environments to call a method of."""
        raise SilemError(f"a batch has no environments with a method {method_name!r}")

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Tell once per index whether infos are what a wrapper would make them: `Monitor`'s are."""
        return [wrapper_class is Monitor for _ in self._get_indices(indices)]
