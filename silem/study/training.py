"""Building a run's model and training it in segments (see `silem.study.checkpoint`)."""

from __future__ import annotations

import dataclasses
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv
from torch import nn
from tqdm import tqdm

from silem.algorithms import PPO, SILEM, TPIL, GAIfO
from silem.algorithms.gaifo import SurvivalWarning
from silem.bodies import MujocoBody
from silem.envs import make_vec
from silem.envs.mujoco import body_of
from silem.motion import demonstrations as demos
from silem.motion import retargeted
from silem.motion.demonstrations import Demonstrations
from silem.study.checkpoint import CHECKPOINT, PROGRESS, Checkpoint, Stopwatch
from silem.study.config import RunConfig
from silem.study.record import CURVE_COLUMNS, curve_row
from silem.study.settings import HUMAN, METHODS, Budget
from silem.util import files, seeding
from silem.util.errors import SilemError

_PROGRESS_EVERY_S = 2.0
_ALGORITHMS = {"PPO": PPO, "GAIfO": GAIfO, "SILEM": SILEM, "TPIL": TPIL}


def task_options(config: RunConfig) -> dict[str, Any]:
    """Return what a run's task takes from its demonstrations, for `silem.envs.make_vec`.

    A captured man's mean speed, in whole cm/s, is what earns a humanoid the full reward (Figure 3b
    of the paper); where nobody was captured the task's default stands.
    """
    if not config.demonstrations or not isinstance(config.learner, MujocoBody):
        return {}
    speed_m_s = demos.captured_speed_m_s(config.demonstrations)
    return {} if speed_m_s is None else {"speed_m_s": round(speed_m_s, 2)}


def make_env(config: RunConfig) -> VecEnv:
    """Build a run's training environments."""
    options = task_options(config)
    if config.hyper.starts == "demonstration":
        # inverse kinematics and motion capture come with it, which no other run needs
        from silem.motion.retargeting import demonstration_states

        name = config.demonstrations if options else HUMAN
        if not name.endswith(retargeted("", config.body)):
            name = retargeted(name, config.body)
        options["starts"] = demonstration_states(name, body_of(config.learner))
    seed = seeding.child_seed(config.seed, "env")
    env = make_vec(config.learner, config.budget.n_envs, seed, **options)
    if not config.hyper.clip_actions:
        env.action_space = unclipped(env.action_space)
    return env


def unclipped(space: spaces.Space[Any]) -> spaces.Box:
    """Return a space of actions whose bounds, finite for stable-baselines3, none ever reaches."""
    bound = float(np.finfo(np.float32).max)
    return spaces.Box(-bound, bound, space.shape, np.float32)


def arguments(config: RunConfig) -> dict[str, Any]:
    """Return what the algorithm of a run is built with, beside policy, environments and data.

    PPO is that of OpenAI baselines' ppo1, the paper's: separate policy and value networks, linear
    decay of the learning rate to 0, no gradient clipping, no entropy bonus.
    """
    hyper, budget = config.hyper, config.budget
    layers = list(hyper.policy_hidden)
    ppo = dict(
        learning_rate=_annealed(hyper.learning_rate),
        n_steps=budget.steps_per_iteration // budget.n_envs,
        batch_size=hyper.minibatch_size,
        n_epochs=hyper.n_epochs,
        gamma=hyper.gamma,
        gae_lambda=hyper.gae_lambda,
        clip_range=_annealed(hyper.clip_range) if hyper.anneal_clip else hyper.clip_range,
        normalize_advantage=True,
        ent_coef=0.0,
        vf_coef=0.5,
        max_grad_norm=float("inf"),
        policy_kwargs={
            "net_arch": {"pi": layers, "vf": layers},
            "activation_fn": nn.Tanh,
            "log_std_init": hyper.log_std_init,
            "optimizer_kwargs": {"eps": hyper.adam_eps},
        },
        seed=seeding.child_seed(config.seed, "initial weights"),
        device="cpu",
        verbose=0,
    )
    # What an expert has too says how PPO learns; the others are the imitator's, by the same names.
    others = {*hyper.used_by("ppo"), "n_trajectories"}
    own = {n: getattr(hyper, n) for n in hyper.used_by(config.method) if n not in others}
    return own | ({"transform": config.transform} if config.transform else {}) | ppo


def _annealed(start: float) -> Callable[[float], float]:
    """Return a schedule that falls linearly from its start to 0."""
    return lambda progress_remaining: start * progress_remaining


def settings(
    body: str, method: str = "silem", *, budget: str | Budget = "book", seed: int = 0, **hyper: Any
) -> dict[str, Any]:
    """Return the settings of a cell as the arguments that its algorithm takes.

    ``SILEM("MlpPolicy", env, demonstrations, **silem.settings("HC2"))`` is what a run of that cell
    trains: the paper's best combination where it prints one, this project's choice elsewhere.

    The arguments are those of `RunConfig.create`.

    Raises:
        SilemError: As there; or the method learns nothing.
    """
    config = RunConfig.create(body, method, None, budget, seed, **hyper)
    if not METHODS[method].algorithm:
        raise SilemError(f"method {method!r} learns nothing, so it has no settings")
    return arguments(config)


def make_model(config: RunConfig, env: VecEnv, demonstrations: Demonstrations | None) -> PPO:
    """Build the untrained model of a run of any method but ``random``.

    The demonstrations are at least as many as the run uses; None for an expert.
    """
    make: Any = _ALGORITHMS[METHODS[config.method].algorithm]
    data = [demonstrations.first(config.hyper.n_trajectories)] if demonstrations else []
    return make("MlpPolicy", env, *data, **arguments(config))


class Segments(BaseCallback):
    """Cuts a training into segments, keeps its learning curve and shows progress (see `train`)."""

    def __init__(
        self, config: RunConfig, folder: Path, start: Checkpoint, spent: Stopwatch, bar: tqdm[Any]
    ) -> None:
        super().__init__()
        self._config, self._folder, self._start = config, folder, start
        self._spent, self._bar = spent, bar
        self._rows = list(start.curve)
        self._return: float | None = None
        self._shown = time.perf_counter()

    @property
    def curve(self) -> np.ndarray:
        """The learning curve so far, (iterations, columns)."""
        return np.array(self._rows).reshape(-1, len(CURVE_COLUMNS))

    @property
    def _ppo(self) -> PPO:
        assert isinstance(self.model, PPO)
        return self.model

    def _iteration(self) -> int:
        return self.model.num_timesteps // self._config.budget.steps_per_iteration

    def _on_rollout_start(self) -> None:
        due = self._iteration() % self._config.budget.checkpoint_every == 0
        self._end_iteration(save=due)
        if due:
            self._begin_segment(self._iteration())

    def _begin_segment(self, iteration: int) -> None:
        model, seed, env = self._ppo, self._config.seed, self.training_env
        env.seed(seeding.child_seed(seed, "env", iteration))
        # As at learn()'s start; an imitation learner sees by the episode starts that all its
        # windows begin anew.
        model._last_obs = np.asarray(env.reset())
        model._last_episode_starts = np.ones(env.num_envs, dtype=bool)
        model.reseed(seeding.child_seed(seed, "model", iteration))

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        self._end_iteration(save=True)

    def _end_iteration(self, *, save: bool) -> None:
        """Keep the numbers of the iteration that has just been finished, if any was."""
        iteration, stats = self._iteration(), self._ppo.iteration_stats
        if iteration == self._start.iteration:
            return
        self._rows.append(curve_row(iteration, self.model.num_timesteps, stats))
        self._bar.update()
        self._return = stats.get("return_mean", self._return)  # most iterations end no episode
        if time.perf_counter() - self._shown > _PROGRESS_EVERY_S:
            self._show(iteration)
        if save:
            arrays, spent = self._ppo.state_arrays(), self._spent()
            now = dict(iteration=iteration, curve=self.curve, model=arrays, **spent)
            dataclasses.replace(self._start, **now).save(self._folder / CHECKPOINT)

    def _show(self, iteration: int) -> None:
        self._shown = time.perf_counter()
        if self._return is not None:
            self._bar.set_postfix_str(f"return {self._return:.0f}")
        total = self._config.budget.n_iterations
        content = {"iteration": iteration, "n_iterations": total, "return": self._return}
        files.write_json(self._folder / PROGRESS, content)


def train(
    model: PPO, config: RunConfig, folder: Path, start: Checkpoint, spent: Stopwatch, progress: bool
) -> np.ndarray:
    """Train a model of `make_model` from a checkpoint's iteration to the end of its budget.

    Checkpoints and the progress file go to `folder`. Returns the curve, (iterations, columns).
    """
    if start.iteration:
        model.load_state_arrays(start.model)
    model.num_timesteps = start.iteration * config.budget.steps_per_iteration
    remaining = config.budget.n_steps - model.num_timesteps
    bar = tqdm(
        total=config.budget.n_iterations, initial=start.iteration, desc=config.run_id, unit="it",
        disable=not progress,
    )  # fmt: skip
    with bar, warnings.catch_warnings():
        # a run's reward is the paper's; the book tells what it does where episodes end
        warnings.simplefilter("ignore", SurvivalWarning)
        segments = Segments(config, folder, start, spent, bar)
        if remaining:
            # reset_num_timesteps=False: the learning rate decays over the whole budget, and a
            # resumed run goes on where it was.
            model.learn(remaining, callback=segments, reset_num_timesteps=False)
    return segments.curve
