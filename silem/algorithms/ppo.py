"""PPO: stable-baselines3's class and interface, without autograd where the policy allows it."""

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3 import PPO as SB3PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.save_util import recursive_getattr
from stable_baselines3.common.utils import explained_variance, obs_as_tensor, set_random_seed
from stable_baselines3.common.vec_env import VecEnv

from silem.algorithms import state
from silem.algorithms.fast_mlp import Batch, FlatActorCritic, Losses
from silem.algorithms.networks import RunningNormalizer
from silem.util import errors
from silem.util.errors import BOUND, COUNT, FACTOR, RATE, SEED, WEIGHT, NumberKind, SilemError

_EPISODE_STATS = {"r": "return_mean", "speed_m_s": "speed_m_s", "l": "episode_length"}
_OF_THE_FILE = {"self", "policy", "args", "kwargs", "normalize_observations", "_init_setup_model"}


class PPO(SB3PPO):
    """Proximal policy optimisation (Schulman et al., 2017) on stable-baselines3's interface.

    The tanh MLP of ``MlpPolicy`` is rolled out and updated by :class:`FlatActorCritic`; any other
    policy, preprocessing or buffer, a clipped value loss and gSDE go through stable-baselines3's
    own code. The arguments are those of ``stable_baselines3.PPO``, with "cpu" as the default
    ``device``, and ``normalize_observations``, which puts :class:`RunningNormalizer` in front of an
    ``MlpPolicy``. Raises SilemError: a number is not of its kind.
    """

    _numbers: ClassVar[dict[str, NumberKind]] = {
        "n_steps": COUNT, "batch_size": COUNT, "n_epochs": COUNT, "gamma": FACTOR,
        "gae_lambda": FACTOR, "ent_coef": WEIGHT, "vf_coef": WEIGHT, "max_grad_norm": BOUND,
        "learning_rate": RATE, "clip_range": RATE, "clip_range_vf": RATE, "target_kl": RATE,
        "stats_window_size": COUNT, "seed": SEED,
    }  # fmt: skip
    _schedules: ClassVar[set[str]] = {"learning_rate", "clip_range", "clip_range_vf"}  # may be
    _optional: ClassVar[set[str]] = {"clip_range_vf", "target_kl", "seed"}  # may be None
    # what learns: its module and its optimizer among the attributes, which `save` keeps as such
    _learns: ClassVar[dict[str, tuple[str, str]]] = {"policy": ("policy", "policy.optimizer")}
    _transient: ClassVar[list[str]] = ["_fast", "_rng", "_bootstrap", "_episodes", "_begun"]

    def __init__(
        self, policy: Any, env: Any, *args: Any, normalize_observations: bool = True, **kwargs: Any
    ) -> None:
        for name in kwargs:
            errors.choose(f"argument of {type(self).__name__}", name, sorted(self._arguments()))
        self.normalize_observations = normalize_observations
        if normalize_observations and policy in ("MlpPolicy", ActorCriticPolicy):
            chosen = {"features_extractor_class": RunningNormalizer}
            kwargs["policy_kwargs"] = chosen | (kwargs.get("policy_kwargs") or {})
        kwargs.setdefault("device", "cpu")
        self._fast: FlatActorCritic | None = None
        self._begun: list[Any] = []
        self._midway = False  # in a rollout, or in one that was broken off
        self.iteration_stats: dict[str, float] = {}
        self._check_numbers(kwargs)  # before stable-baselines3 divides by them
        super().__init__(policy, env, *args, **kwargs)

    @classmethod
    def load(  # type: ignore[override]
        cls,
        path: Any,
        env: Any = None,
        device: th.device | str = "cpu",
        custom_objects: dict[str, Any] | None = None,
        **kwargs: Any,
    ) -> Any:
        """Load a model that ``save`` wrote, running whatever code the file holds.

        **Load only files you trust**: stable-baselines3's format contains pickles. To give a
        policy away, or to take one, use :meth:`export_policy` and `silem.load_policy`.

        The arguments are stable-baselines3's; ``env`` None is enough to predict, and ``kwargs`` are
        also what the constructor takes, in place of what was saved.

        Raises SilemError: an argument is unknown or of no use, the networks that the arguments
        describe are not those of the file, or the file cannot be read.
        """
        names = cls._arguments() - _OF_THE_FILE | {"print_system_info", "force_reset"}
        for name in kwargs:
            errors.choose(f"argument of {cls.__name__}.load", name, sorted(names))
        if "stats_window_size" in kwargs:
            kwargs["_stats_window_size"] = kwargs.pop("stats_window_size")
        try:
            return super().load(path, env, device, custom_objects, **kwargs)
        except SilemError:
            raise
        except (OSError, RuntimeError, ValueError) as error:
            reason = errors.reason(error)
            if isinstance(error, RuntimeError):
                reason = f"it holds other networks than asked for: {reason}"
            elif "object name" in reason or "Names of parameters" in reason:
                reason = f"another class than {cls.__name__} saved it"
            raise SilemError(f"cannot load {path}: {reason}") from error

    @classmethod
    def _arguments(cls) -> set[str]:
        """Return the names of all that the constructors take."""
        made = (c.__init__ for c in cls.__mro__ if issubclass(c, SB3PPO))
        return {name for init in made for name in inspect.signature(init).parameters}

    def export_policy(self, path: Path | str, **about: str) -> None:
        """Write the policy, for `silem.load_policy`: a safetensors file, with metadata ``about``.

        Raises SilemError: the policy is no multi-layer perceptron on a flat Box of observations, or
        the file cannot be written.
        """
        state.export_policy(self.policy, Path(path), about)

    def set_random_seed(self, seed: int | None = None) -> None:
        """Restart all random streams, and the environments'; None takes torch's next number."""
        super().set_random_seed(seed)
        self._seed_streams(int(th.randint(2**31, ())) if seed is None else seed)

    def reseed(self, seed: int) -> None:
        """Restart every random stream of the model from ``seed``; the environments' go on."""
        set_random_seed(seed)  # torch, and the global NumPy stream of SB3's own path
        self._seed_streams(seed)

    def _seed_streams(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def state_arrays(self) -> dict[str, np.ndarray]:
        """Return what training needs at an iteration's start, with new episodes and `reseed`."""
        return state.collect(self._learners())

    def load_state_arrays(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore :meth:`state_arrays`; raises SilemError on missing or misshaped arrays."""
        state.restore(self._learners(), arrays)

    def _learners(self) -> state.Learners:
        return {
            name: (getattr(self, module), recursive_getattr(self, optimizer))
            for name, (module, optimizer) in self._learns.items()
        }

    def _setup_learn(self, *args: Any, **kwargs: Any) -> Any:
        if self._midway or self._was_reset():
            self._last_obs = None  # stable-baselines3 then begins new episodes
        prepared = super()._setup_learn(*args, **kwargs)
        self._note_begun()
        return prepared

    def begin_episodes(self, env: VecEnv) -> None:
        """Reset the environments as at `learn`'s start: an imitator's windows begin anew too."""
        self._last_obs = env.reset()  # type: ignore[assignment]
        self._last_episode_starts = np.ones(env.num_envs, dtype=bool)
        self._note_begun()

    def _note_begun(self) -> None:
        """Remember the episodes under way: a reset puts other infos in the place of theirs."""
        assert self.env is not None
        self._begun = list(self.env.unwrapped.reset_infos)

    def _was_reset(self) -> bool:
        """Tell whether the environments were reset behind the model's back, to evaluate it, say."""
        assert self.env is not None
        now, then = self.env.unwrapped.reset_infos, self._begun
        return len(now) != len(then) or any(a is not b for a, b in zip(now, then, strict=True))

    def collect_rollouts(
        self,
        env: VecEnv,
        callback: BaseCallback,
        rollout_buffer: RolloutBuffer,
        n_rollout_steps: int,
    ) -> bool:
        """Fill the rollout buffer as stable-baselines3 does; False if the callback ends training.

        Values at time limits are kept apart from the rewards, so that an imitation learner can put
        other rewards in their place before it learns. A rollout before which somebody else has
        reset the environments begins with new episodes. Raises SilemError: the callback has reset
        the environments in the middle of the rollout.
        """
        self._refresh_twin()
        self.policy.set_training_mode(False)
        rollout_buffer.reset()
        self._bootstrap = np.zeros((n_rollout_steps, env.num_envs), dtype=np.float32)
        self._episodes: list[dict[str, float]] = []
        if self.use_sde:
            self.policy.reset_noise(env.num_envs)
        callback.on_rollout_start()
        if self._was_reset():
            self.begin_episodes(env)
        self._begin_rollout(env)
        # A rollout that a callback or an error breaks off leaves the environments ahead of what
        # the model saw of them: `learn` begins with new episodes then.
        self._midway = True
        for step in range(n_rollout_steps):
            if self.use_sde and self.sde_sample_freq > 0 and step % self.sde_sample_freq == 0:
                self.policy.reset_noise(env.num_envs)
            actions, values, log_probs = self._sample(self._last_obs)
            new_obs, rewards, dones, infos = env.step(self._env_actions(actions))
            self.num_timesteps += env.num_envs
            self._note_begun()
            callback.update_locals(locals())
            if not callback.on_step():
                return False
            if self._was_reset():
                told = "a callback has reset the training environments in the middle of a rollout"
                raise SilemError(f"{told}; an evaluation needs environments of its own")
            self._update_info_buffer(infos, dones)
            self._note_episode_ends(step, dones, infos)
            self._note_step(step, new_obs, dones, infos, env)
            seen: Any = self._last_obs, actions, rewards, self._last_episode_starts
            rollout_buffer.add(*seen, *map(th.from_numpy, (values, log_probs)))
            self._last_obs, self._last_episode_starts = new_obs, dones  # type: ignore[assignment]
        self._midway = False
        self._set_rewards(rollout_buffer.rewards)
        callback.update_locals(locals())
        callback.on_rollout_end()
        return True

    def train(self) -> None:
        """Update the policy on the rollout: PPO's epochs of clipped minibatch steps.

        Raises SilemError: rewards, values or, afterwards, parameters hold NaN or infinity.
        """
        if not np.isfinite(self.rollout_buffer.returns).all():  # NumPy would go on in silence
            raise SilemError("the rollout's rewards or values hold NaN or infinity")
        self._refresh_twin()
        if self._fast is None:
            super().train()
        else:
            self._train_fast(self._fast)
        buffer = self.rollout_buffer
        for module in self.policy.modules():
            if isinstance(module, RunningNormalizer):
                seen = buffer.observations  # SB3's train has flattened it already
                module.update(seen if buffer.generator_ready else buffer.swap_and_flatten(seen))
        self._record_episodes()

    def _refresh_twin(self) -> None:
        """Have the NumPy twin of the policy, where there is one, agree with the torch policy.

        The invariant: the twin owns the memory. Parameters and Adam's moments live in its flat
        vectors, of which torch's tensors are views: either side sees the other's steps at once, and
        what is copied into the tensors. Not so tensors replaced by others (an optimizer's
        ``load_state_dict``, ``p.data =``, another policy) and observation moments, of which it has
        a rounded copy. So it adopts and copies those anew before every rollout and every update;
        between these nothing may change them. Where it does not reproduce the policy, there is no
        twin, and stable-baselines3's own code runs.
        """
        plain = type(self.rollout_buffer) is RolloutBuffer and self.clip_range_vf is None
        if not plain or not FlatActorCritic.supports(self.policy):
            self._fast = None
        elif self._fast is None or self._fast.policy is not self.policy:
            self._fast = FlatActorCritic(self.policy)
        else:
            self._fast.sync()

    def _excluded_save_params(self) -> list[str]:
        learned = [name for names in self._learns.values() for name in names]
        return [*super()._excluded_save_params(), *self._transient, *learned]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return [name for names in self._learns.values() for name in names], []

    def _check_numbers(self, values: dict[str, Any]) -> None:
        for name, kind in self._numbers.items():
            value = values.get(name, 1)
            free = name in self._schedules if callable(value) else name in self._optional
            if not free or not (callable(value) or value is None):
                kind.check(name, value)

    def _check_settings(self) -> None:
        """Check the arguments, whether the constructor or `load` put them in their places."""
        self._check_numbers(vars(self))

    def _setup_model(self) -> None:
        self._check_settings()
        super()._setup_model()
        self._refresh_twin()

    def _begin_rollout(self, env: VecEnv) -> None:
        """Prepare an imitation learner's own record of the rollout."""

    def _note_step(
        self, step: int, new_obs: Any, dones: np.ndarray, infos: list[dict[str, Any]], env: VecEnv
    ) -> None:
        """Let an imitation learner see each step."""

    def _set_rewards(self, rewards: np.ndarray) -> None:
        """Put rewards (T, E) into the rollout buffer, continued where episodes were cut."""
        buffer = self.rollout_buffer
        buffer.rewards = rewards + self._bootstrap
        last_values = th.from_numpy(self._values(self._last_obs))
        assert self._last_episode_starts is not None
        buffer.compute_returns_and_advantage(last_values, self._last_episode_starts)

    def _sample(self, observations: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if self._fast is not None:
            return self._fast.sample(self._fast.normalize(observations), self._rng)
        with th.no_grad():
            drawn = self.policy(obs_as_tensor(observations, self.device))
        actions, values, log_probs = (tensor.cpu().numpy() for tensor in drawn)
        return actions, values, log_probs

    def _values(self, observations: Any) -> np.ndarray:
        """Return the values of one observation or of several, (1,) or (E,)."""
        if self._fast is not None:
            return self._fast.values(self._fast.normalize(observations))
        with th.no_grad():
            values = self.policy.predict_values(self.policy.obs_to_tensor(observations)[0])
        return values.cpu().numpy()[:, 0]

    def _env_actions(self, actions: np.ndarray) -> np.ndarray:
        if not isinstance(self.action_space, spaces.Box):
            return actions
        actions = actions.reshape(-1, *self.action_space.shape)
        if self.policy.squash_output:
            return self.policy.unscale_action(actions)
        return np.clip(actions, self.action_space.low, self.action_space.high)

    def _note_episode_ends(self, step: int, dones: np.ndarray, infos: list[dict[str, Any]]) -> None:
        for i in np.flatnonzero(dones):
            info = infos[i]
            self._episodes.append(info.get("episode", {}))
            if info.get("TimeLimit.truncated", False):
                (worth,) = self._values(info["terminal_observation"])
                self._bootstrap[step, i] = self.gamma * worth

    def _train_fast(self, fast: FlatActorCritic) -> None:
        self._update_learning_rate(self.policy.optimizer)
        assert callable(self.clip_range)
        clip_range = self.clip_range(self._current_progress_remaining)
        buffer = self.rollout_buffer
        flat = buffer.swap_and_flatten  # environments one after another
        scalars = (flat(x)[:, 0] for x in (buffer.log_probs, buffer.advantages, buffer.returns))
        rollout = Batch(fast.normalize(flat(buffer.observations)), flat(buffer.actions), *scalars)
        losses: list[Losses] = []
        for _ in range(self.n_epochs):
            last_epoch = len(losses)
            for batch in self._minibatches(rollout):
                losses.append(fast.gradient(batch, clip_range, self.ent_coef, self.vf_coef))
                far = self.target_kl is not None and losses[-1].approx_kl > 1.5 * self.target_kl
                if far:
                    break
                fast.adam_step(self.max_grad_norm)
            self._n_updates += 1
            if far:
                break
        if not np.isfinite(fast.params).all():
            raise SilemError("the policy diverged: its parameters hold NaN or infinity")
        self._log_update(losses, losses[last_epoch:], clip_range)

    def _minibatches(self, rollout: Batch) -> Iterator[Batch]:
        """Yield one epoch's minibatches, in random order."""
        order = self._rng.permutation(len(rollout.actions))
        shuffled = [array[order] for array in rollout]
        for start in range(0, len(order), self.batch_size):
            batch = Batch(*(array[start : start + self.batch_size] for array in shuffled))
            advantages, n = batch.advantages, len(batch.advantages)
            if self.normalize_advantage and n > 1:  # as by mean and std(ddof=1), in half the time
                advantages = advantages - advantages.sum() / n
                std = np.sqrt((advantages * advantages).sum() / (n - 1))
                advantages = advantages / (std + 1e-8)
            yield batch._replace(advantages=advantages)

    def _log_update(
        self, losses: list[Losses], last_epoch: list[Losses], clip_range: float
    ) -> None:
        """Log what stable-baselines3's PPO does, under its names: of the KL, the last epoch's."""
        log_std, buffer = self.policy.log_std.detach().numpy(), self.rollout_buffer
        last = losses[-1]
        loss = last.policy_gradient_loss + self.ent_coef * last.entropy_loss
        logged = dict(zip(Losses._fields, np.mean(losses, axis=0), strict=True)) | {
            "approx_kl": np.mean([each.approx_kl for each in last_epoch]),
            "loss": loss + self.vf_coef * last.value_loss,
            "std": float(np.exp(log_std).mean()),
            "explained_variance": explained_variance(buffer.values.ravel(), buffer.returns.ravel()),
            "clip_range": clip_range,
        }
        for key, number in logged.items():
            self.logger.record(f"train/{key}", number)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")

    def _record_episodes(self) -> None:
        """Fill ``iteration_stats`` with what this iteration's finished episodes showed."""
        self.iteration_stats = {}
        for key, name in _EPISODE_STATS.items():
            if values := [episode[key] for episode in self._episodes if key in episode]:
                self.iteration_stats[name] = float(np.mean(values))
        if hasattr(self.policy, "log_std"):
            self.iteration_stats["policy_std"] = float(self.policy.log_std.detach().exp().mean())
