"""Building a run's model, and training it in segments between checkpoints."""

import dataclasses
import hashlib
import json
import math
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv
from torch import nn
from tqdm import tqdm

from silem.algorithms import PPO, SILEM, TPIL, GAIfO
from silem.algorithms.gaifo import SurvivalWarning
from silem.bodies import MujocoBody, of_kind
from silem.envs import make_vec
from silem.motion import demonstrations as demos
from silem.motion.demonstrations import Demonstrations, retargeted
from silem.study.config import RunConfig
from silem.study.runs import CHECKPOINT, CURVE_COLUMNS, PROGRESS, curve_row
from silem.study.settings import HUMAN, METHODS, Budget
from silem.util import files, seeding
from silem.util.errors import SilemError, reason

_PROGRESS_EVERY_S = 2.0
_MODEL, _CURVE, _SHA256 = "model/", "curve", "sha256"
_TEXTS = ("run_id", "demonstrations_sha256")  # of a checkpoint's metadata; the others are JSON
_OF_RUNS = ("clip_actions", "n_trajectories", "starts")  # `make_env` and `make_model` see to them
_ALGORITHMS = {"PPO": PPO, "GAIfO": GAIfO, "SILEM": SILEM, "TPIL": TPIL}


def task_options(config: RunConfig) -> dict[str, Any]:
    """Return what a run's task takes from its demonstrations, for `silem.envs.make_vec`.

    A captured man's mean speed, in whole cm/s, earns a humanoid the full reward (Figure 3b); his
    retargeted motion itself is slower on shorter legs.
    """
    if not isinstance(config.learner, MujocoBody):
        return {}
    about = demos.manifest().get(config.demonstrations, {})  # which a person's own file is not in
    captured = demos.entry(about["retargeted_from"]) if "retargeted_from" in about else about
    if "capture_rate_hz" not in captured:
        return {}
    return {"speed_m_s": round(captured["speed_m_s"], 2)}


def make_env(config: RunConfig) -> VecEnv:
    """Build a run's training environments."""
    options = task_options(config)
    if config.hyper.starts == "demonstration":
        # inverse kinematics and motion capture come with it, which no other run needs
        from silem.motion.retargeting import demonstration_states

        name = retargeted(config.demonstrations if options else HUMAN, config.body)
        options["starts"] = demonstration_states(name, of_kind(config.learner, MujocoBody))
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
    others = {*hyper.used_by("ppo"), *_OF_RUNS}
    own = {n: getattr(hyper, n) for n in hyper.used_by(config.method) if n not in others}
    return own | ({"transform": config.transform} if config.transform else {}) | ppo


def _annealed(start: float) -> Callable[[float], float]:
    """Return a schedule that falls linearly from its start to 0."""
    return lambda progress_remaining: start * progress_remaining


def settings(
    body: str, method: str = "silem", *, budget: str | Budget = "book", seed: int = 0, **hyper: Any
) -> dict[str, Any]:
    """Return the settings of a cell, by `RunConfig.create`, as the arguments of its algorithm.

    ``SILEM("MlpPolicy", env, demonstrations, **silem.settings("HC2"))`` learns as a run of that
    cell does: by the paper's best combination where it prints one, this project's choice elsewhere.
    A run adds its first ``n_trajectories`` of the demonstrations, the budget's environments (with
    the body's parameters, ``clip_actions`` and ``starts``), and new episodes at checkpoints.

    Raises SilemError: As there; the method learns nothing; or only a run takes one of ``hyper``.
    """
    config = RunConfig.create(body, method, None, budget, seed, **hyper)
    if not METHODS[method].algorithm:
        raise SilemError(f"method {method!r} learns nothing, so it has no settings")
    if own := hyper.keys() & {"study", *_OF_RUNS, *config.parameters}:
        raise SilemError(f"{', '.join(sorted(own))}: no argument of the class but a RunConfig's")
    return arguments(config)


def make_model(config: RunConfig, env: VecEnv, demonstrations: Demonstrations | None) -> PPO:
    """Build the untrained model of a run of any method but ``random``."""
    make: Any = _ALGORITHMS[METHODS[config.method].algorithm]
    settings = arguments(config)
    if not demonstrations:
        return make("MlpPolicy", env, **settings)
    shown = demonstrations.first(config.hyper.n_trajectories)
    if config.hyper.absorbing_states:  # of the expert's episodes, those that no time limit cut
        settings["absorbing_states"] = [
            bool(shown.expert_run_id) and len(states) <= config.learner.max_steps
            for states in shown.features
        ]
    return make("MlpPolicy", env, shown, **settings)


@dataclass(frozen=True)
class Checkpoint:
    """Everything a training goes on from, in one safetensors file.

    Training is cut into segments of ``budget.checkpoint_every`` iterations. At every segment's
    start, interrupted or not, the environments are reset and all random streams restart from the
    run's seed and the iteration. So a checkpoint needs neither random states nor episodes under
    way, and a resumed run equals an uninterrupted one bit for bit.
    """

    run_id: str
    iteration: int  # finished
    wall_time_s: float  # over all sessions, as what follows
    processor_time_s: float | None  # None where an earlier session did not count
    commits: tuple[str, ...]  # of the code
    processors: tuple[str, ...]  # older checkpoints do not say
    demonstrations_sha256: str  # of their file; "" where none are used
    curve: np.ndarray  # (iteration, columns), NaN for blank
    model: dict[str, np.ndarray]  # its `state_arrays`
    began: tuple[float, float] = field(
        default_factory=lambda: (time.perf_counter(), time.process_time()), compare=False
    )

    def spent(self) -> dict[str, Any]:
        """Return seconds by the clock and of the processor until now, over all sessions."""
        before, processor_s = self.processor_time_s, time.process_time() - self.began[1]
        return {
            "wall_time_s": self.wall_time_s + time.perf_counter() - self.began[0],
            "processor_time_s": None if before is None else before + processor_s,
        }

    def save(self, path: Path) -> None:
        """Write the checkpoint; a crash, or SilemError if it diverged, leaves the one before."""
        for name, array in self.model.items():
            if not np.isfinite(array).all():
                why = f"{self.run_id} diverged before iteration {self.iteration}: {name} holds NaN"
                raise SilemError(f"{why} or infinity; the checkpoint before is kept")
        arrays = {_MODEL + name: array for name, array in self.model.items()}
        arrays[_CURVE] = self.curve
        told = {n: v for n, v in vars(self).items() if n not in ("curve", "model", "began")}
        metadata = {n: v if n in _TEXTS else json.dumps(v) for n, v in told.items()}
        metadata[_SHA256] = _digest(arrays, metadata)
        files.write_tensors(path, arrays, metadata)

    @classmethod
    def load(cls, path: Path, config: RunConfig, demonstrations_sha256: str) -> "Checkpoint":
        """Read a checkpoint of a given run, or return what it starts from where there is none yet.

        Raises SilemError: the file is damaged, another run's, or was made with other
        demonstrations. Nothing is deleted.
        """
        if not path.exists():
            no_curve = np.empty((0, len(CURVE_COLUMNS)))
            return cls(config.run_id, 0, 0.0, 0.0, (), (), demonstrations_sha256, no_curve, {})
        try:
            arrays, metadata = files.read_tensors(path)
            if metadata.pop(_SHA256, "") != _digest(arrays, metadata):
                raise SilemError(f"the checksum of {path} differs")
            told: dict[str, Any]
            told = {n: t if n in _TEXTS else json.loads(t) for n, t in metadata.items()}
            told["processors"] = tuple(told.get("processors", ()))
            told["commits"], curve = tuple(told["commits"]), arrays.pop(_CURVE)
            model = {name.removeprefix(_MODEL): array for name, array in arrays.items()}
            found = cls(**told, curve=curve, model=model)
            if found.run_id != config.run_id:
                raise SilemError(f"{path} is a checkpoint of {found.run_id}, not {config.run_id}")
            if found.demonstrations_sha256 != demonstrations_sha256:
                raise SilemError(f"{path} was made with other demonstrations (bring those back)")
            if found.curve.shape != (found.iteration, len(CURVE_COLUMNS)):
                raise SilemError(f"{path} is of another version: its curve is another")
            return found
        except (KeyError, TypeError, ValueError) as error:  # a SilemError is one
            advice = "move it away, or run with --force, to start this run anew"
            raise SilemError(f"unusable checkpoint: {reason(error)}; {advice}") from error


def _digest(arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> str:
    """Return a SHA-256 of all that a checkpoint holds."""
    about = {name: [array.dtype.str, array.shape] for name, array in arrays.items()}
    digest = hashlib.sha256(json.dumps([about, dict(metadata)], sort_keys=True).encode())
    for name in sorted(arrays):
        digest.update(np.asarray(arrays[name], order="C").tobytes())
    return digest.hexdigest()


class Segments(BaseCallback):
    """Cuts a training into segments, keeps its learning curve and shows progress (see `train`)."""

    def __init__(
        self, config: RunConfig, folder: Path, start: Checkpoint, bar: "tqdm[Any]", until: float
    ) -> None:
        super().__init__()
        self._config, self._folder, self._start, self._bar = config, folder, start, bar
        self._until, self._saved = until, time.monotonic()
        self._rows = list(start.curve)
        self._return: float | None = None
        self._shown = 0.0

    @property
    def curve(self) -> np.ndarray:
        """The learning curve so far, (iterations, columns)."""
        return np.array(self._rows).reshape(-1, len(CURVE_COLUMNS))

    def _on_rollout_start(self) -> None:
        seed, env, model = self._config.seed, self.training_env, cast(PPO, self.model)
        iteration = model.num_timesteps // self._config.budget.steps_per_iteration
        due = iteration % self._config.budget.checkpoint_every == 0
        self._end_iteration(save=due)
        if due:  # begin a segment
            env.seed(seeding.child_seed(seed, "env", iteration))
            model.begin_episodes(env)
            model.reseed(seeding.child_seed(seed, "model", iteration))

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        self._end_iteration(save=True)

    def _end_iteration(self, *, save: bool) -> None:
        """Keep the numbers of the iteration that has just been finished, if any was."""
        model, budget = cast(PPO, self.model), self._config.budget
        iteration, stats = model.num_timesteps // budget.steps_per_iteration, model.iteration_stats
        if iteration == self._start.iteration:
            return
        self._rows.append(curve_row(iteration, model.num_timesteps, stats))
        self._bar.update()
        self._return = stats.get("return_mean", self._return)  # most iterations end no episode
        spent, now = self._start.spent(), time.monotonic()
        if save or now - self._shown > _PROGRESS_EVERY_S:
            self._shown = now
            if self._return is not None:
                self._bar.set_postfix_str(f"return {self._return:.0f}")
            said = spent | {"n_iterations": budget.n_iterations, "return": self._return}
            files.write_json(self._folder / PROGRESS, said | {"iteration": iteration})
        if save:
            arrays = model.state_arrays()
            reached = spent | {"iteration": iteration, "curve": self.curve, "model": arrays}
            dataclasses.replace(self._start, **reached).save(self._folder / CHECKPOINT)
            segment_s = time.monotonic() - self._saved
            self._saved += segment_s
            if self._saved + segment_s > self._until:
                raise KeyboardInterrupt("time is up")


def train(
    model: PPO,
    config: RunConfig,
    folder: Path,
    start: Checkpoint,
    progress: bool,
    until: float = math.inf,
) -> np.ndarray:
    """Train a model from a checkpoint on, with others to `folder`; return the curve.

    Raises KeyboardInterrupt: at a checkpoint from which the next cannot be reached before `until`.
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
        segments = Segments(config, folder, start, bar, until)
        if remaining:
            # reset_num_timesteps=False: the learning rate decays over the whole budget, and a
            # resumed run goes on where it was.
            model.learn(remaining, callback=segments, reset_num_timesteps=False)
    return segments.curve
