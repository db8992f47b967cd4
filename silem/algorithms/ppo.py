"""PPO: stable-baselines3's class and interface, without autograd where the policy allows it."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import torch as th
from gymnasium import spaces
from stable_baselines3 import PPO as SB3PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import explained_variance, obs_as_tensor, set_random_seed
from stable_baselines3.common.vec_env import VecEnv

from silem.algorithms import state, update
from silem.algorithms.fast_mlp import FlatActorCritic, Losses
from silem.algorithms.normalizer import RunningNormalizer

_EPISODE_STATS = {"r": "return_mean", "speed_m_s": "speed_m_s", "l": "episode_length"}


class PPO(SB3PPO):
    """Proximal policy optimisation (Schulman et al., 2017) on stable-baselines3's interface.

    Takes every argument of ``stable_baselines3.PPO``. The tanh MLP of ``MlpPolicy`` is rolled
    out and updated by :class:`FlatActorCritic`; any other policy, a clipped value loss and
    gSDE go through stable-baselines3's own code.

    Args:
        policy: As in stable-baselines3.
        env: As in stable-baselines3.
        normalize_observations: Put :class:`RunningNormalizer` in front of an ``MlpPolicy``.
        **kwargs: Every other argument of ``stable_baselines3.PPO``.
    """

    def __init__(
        self, policy: Any, env: Any, *args: Any, normalize_observations: bool = True, **kwargs: Any
    ) -> None:
        self.normalize_observations = normalize_observations
        if normalize_observations and policy == "MlpPolicy":
            chosen = {"features_extractor_class": RunningNormalizer}
            kwargs["policy_kwargs"] = chosen | (kwargs.get("policy_kwargs") or {})
        kwargs.setdefault("device", "cpu")
        self._fast: FlatActorCritic | None = None
        self._rng = np.random.default_rng(kwargs.get("seed"))
        self.iteration_stats: dict[str, float] = {}
        super().__init__(policy, env, *args, **kwargs)

    _transient: ClassVar[list[str]] = [
        "_fast", "_rng", "_bootstrap", "_episodes",
    ]  # fmt: skip

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), *self._transient]

    def _setup_model(self) -> None:
        super()._setup_model()
        self._rng = np.random.default_rng(self.seed)
        fast = FlatActorCritic.supports(self.policy) and self.clip_range_vf is None
        self._fast = FlatActorCritic(self.policy) if fast else None

    def reseed(self, seed: int) -> None:
        """Restart every random stream of the model from ``seed``."""
        self._rng = np.random.default_rng(seed)
        set_random_seed(seed)  # torch, and the global NumPy stream of SB3's own path

    def state_arrays(self) -> dict[str, np.ndarray]:
        """Return all that training needs at an iteration's start, as named arrays.

        Random streams and episodes under way are not part of it: a checkpoint is taken where
        the environments are reset and :meth:`reseed` is called.
        """
        return state.collect(self.state_modules(), self.state_optimizers())

    def load_state_arrays(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore :meth:`state_arrays`; raises SilemError on missing or misshaped arrays."""
        state.restore(self.state_modules(), self.state_optimizers(), arrays)
        if self._fast is not None:
            self._fast.sync()

    def policy_arrays(self) -> dict[str, np.ndarray]:
        """Return what ``predict`` needs: the policy's weights and observation moments."""
        return state.collect({"policy": self.policy}, {})

    def load_policy_arrays(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore :meth:`policy_arrays`; raises SilemError on missing or misshaped arrays."""
        state.restore({"policy": self.policy}, {}, arrays)

    def state_modules(self) -> dict[str, th.nn.Module]:
        """Return the modules that a checkpoint holds, by name."""
        return {"policy": self.policy}

    def state_optimizers(self) -> dict[str, th.optim.Optimizer]:
        """Return the optimizers that a checkpoint holds, by name."""
        return {"policy": self.policy.optimizer}

    def collect_rollouts(
        self,
        env: VecEnv,
        callback: BaseCallback,
        rollout_buffer: RolloutBuffer,
        n_rollout_steps: int,
    ) -> bool:
        """Fill the rollout buffer as stable-baselines3 does, and remember what bootstraps it.

        Values at time limits are kept apart from the rewards, so that an imitation learner can
        put other rewards in their place before the advantages are computed.

        Returns:
            False if the callback ended training, else True.
        """
        self.policy.set_training_mode(False)
        rollout_buffer.reset()
        self._bootstrap = np.zeros((n_rollout_steps, env.num_envs), dtype=np.float32)
        self._episodes: list[dict[str, float]] = []
        if self.use_sde:
            self.policy.reset_noise(env.num_envs)
        callback.on_rollout_start()
        self._begin_rollout(env)
        for step in range(n_rollout_steps):
            if self.use_sde and self.sde_sample_freq > 0 and step % self.sde_sample_freq == 0:
                self.policy.reset_noise(env.num_envs)
            actions, values, log_probs = self._sample(self._last_obs)
            new_obs, rewards, dones, infos = env.step(self._env_actions(actions))
            self.num_timesteps += env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                return False
            self._update_info_buffer(infos, dones)
            if isinstance(self.action_space, spaces.Discrete):
                actions = actions.reshape(-1, 1)
            self._note_episode_ends(step, dones, infos)
            self._note_step(step, new_obs, dones, infos, env)
            update.store(
                rollout_buffer, step, observations=self._last_obs, actions=actions,
                rewards=rewards, episode_starts=self._last_episode_starts, values=values,
                log_probs=log_probs,
            )  # fmt: skip
            self._last_obs, self._last_episode_starts = new_obs, dones  # type: ignore[assignment]
        rollout_buffer.rewards = self._learning_rewards(rollout_buffer.rewards) + self._bootstrap
        last_values = th.from_numpy(self._values(self._last_obs))
        rollout_buffer.compute_returns_and_advantage(last_values, dones)
        callback.update_locals(locals())
        callback.on_rollout_end()
        return True

    def train(self) -> None:
        """Update the policy on the rollout: PPO's epochs of clipped minibatch steps."""
        if self._fast is None:
            super().train()
        else:
            self._train_fast(self._fast)
        extractor = self.policy.features_extractor
        if isinstance(extractor, RunningNormalizer):
            buffer = self.rollout_buffer
            seen = buffer.observations  # SB3's train has flattened it already
            extractor.update(seen if buffer.generator_ready else buffer.swap_and_flatten(seen))
            if self._fast is not None:
                self._fast.refresh_moments()
        self._record_episodes()

    def _begin_rollout(self, env: VecEnv) -> None:
        """Prepare an imitation learner's own record of the rollout."""

    def _note_step(
        self, step: int, new_obs: Any, dones: np.ndarray, infos: list[dict[str, Any]], env: VecEnv
    ) -> None:
        """Let an imitation learner see each step."""

    def _learning_rewards(self, env_rewards: np.ndarray) -> np.ndarray:
        """Return the rewards (T, E) to learn from; an imitation learner puts its own here."""
        return env_rewards

    def _sample(self, observations: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if self._fast is not None:
            return self._fast.sample(self._fast.normalize(observations), self._rng)
        with th.no_grad():
            drawn = self.policy(obs_as_tensor(observations, self.device))
        actions, values, log_probs = (tensor.cpu().numpy() for tensor in drawn)
        return actions, values, log_probs

    def _values(self, observations: Any) -> np.ndarray:
        if self._fast is not None:
            return self._fast.values(self._fast.normalize(observations))
        with th.no_grad():
            values = self.policy.predict_values(obs_as_tensor(observations, self.device))
        return values.cpu().numpy()[:, 0]

    def _env_actions(self, actions: np.ndarray) -> np.ndarray:
        if not isinstance(self.action_space, spaces.Box):
            return actions
        if self.policy.squash_output:
            return self.policy.unscale_action(actions)
        return np.clip(actions, self.action_space.low, self.action_space.high)

    def _note_episode_ends(self, step: int, dones: np.ndarray, infos: list[dict[str, Any]]) -> None:
        if not dones.any():
            return
        for i in np.flatnonzero(dones):
            info = infos[i]
            self._episodes.append(info.get("episode", {}))
            if info.get("TimeLimit.truncated", False):
                terminal = info["terminal_observation"]
                batch = (
                    {key: value[None] for key, value in terminal.items()}
                    if isinstance(terminal, dict)
                    else np.asarray(terminal)[None]
                )
                self._bootstrap[step, i] = self.gamma * self._values(batch)[0]

    def _train_fast(self, fast: FlatActorCritic) -> None:
        fast.sync()
        self._update_learning_rate(self.policy.optimizer)
        assert callable(self.clip_range)
        clip_range = self.clip_range(self._current_progress_remaining)
        rollout = update.flatten(self.rollout_buffer, fast)
        losses: list[Losses] = []
        for _ in range(self.n_epochs):
            order = self._rng.permutation(len(rollout.actions))
            for batch in rollout.minibatches(order, self.batch_size, self.normalize_advantage):
                loss = fast.gradient(batch, clip_range, self.ent_coef, self.vf_coef)
                losses.append(loss)
                if self.target_kl is not None and loss.approx_kl > 1.5 * self.target_kl:
                    break
                fast.adam_step(self.max_grad_norm)
            self._n_updates += 1
            if self.target_kl is not None and losses[-1].approx_kl > 1.5 * self.target_kl:
                break
        log_std = self.policy.log_std.detach().numpy()
        for key, value in update.summary(losses, log_std, self.ent_coef, self.vf_coef).items():
            self.logger.record(f"train/{key}", value)
        buffer = self.rollout_buffer
        variance = explained_variance(buffer.values.flatten(), buffer.returns.flatten())
        self.logger.record("train/explained_variance", variance)
        self.logger.record("train/clip_range", clip_range)
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")

    def _record_episodes(self) -> None:
        """Fill ``iteration_stats`` with what this iteration's finished episodes showed."""
        stats: dict[str, float] = {}
        for key, name in _EPISODE_STATS.items():
            values = [episode[key] for episode in self._episodes if key in episode]
            if values:
                stats[name] = float(np.mean(values))
        if hasattr(self.policy, "log_std"):
            stats["policy_std"] = float(self.policy.log_std.detach().exp().mean())
        self.iteration_stats = stats
