"""Adversarial imitation from observation on stable-baselines3's PPO: what the methods share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import torch as th
from stable_baselines3.common.vec_env import VecEnv

from silem.algorithms.discriminator import Discriminator, discriminator_loss
from silem.algorithms.features import LearnerFeatures
from silem.algorithms.ppo import PPO
from silem.algorithms.windows import WindowTracker, episode_windows
from silem.motion.demonstrations import Demonstrations
from silem.util.errors import SilemError


class AdversarialImitation(PPO):
    """PPO whose rewards are a discriminator's judgement of windows of skeletal features.

    Each iteration collects a rollout, updates the discriminator D on it, puts its output in the
    rewards' place and makes a PPO update. By itself this is SILEM-minus; :class:`SILEM` and
    :class:`TPIL` add what compensates for another body.

    Args:
        policy: As in stable-baselines3 ("MlpPolicy").
        env: A Gymnasium or vectorised environment. Its rewards are only reported. Skeletal
            features g(s) are ``info["skeletal_features"]`` where it supplies them, else the
            observation.
        demonstrations: The expert's :class:`Demonstrations`, or a list of (T + 1, F) arrays.
        window: States per window, the supplement's n = 4.
        n_disc_updates: N_D, discriminator steps per iteration, one pass over the rollout.
        disc_learning_rate: Adam's rate for D.
        disc_hidden: Hidden units of D.
        disc_entropy_coef: Weight of D's entropy bonus.
        gradient_penalty: Weight of the penalty on D's gradient. The paper has none (0), and
            then D wins outright on a body that cannot match the expert: see "Deviations".
        **kwargs: Everything :class:`PPO` takes.

    Raises:
        SilemError: On unusable demonstrations, or demonstrations of another feature width than
            the learner's.
    """

    _transient: ClassVar[list[str]] = [
        *PPO._transient, "discriminator", "disc_optimizer", "_tracker", "_windows", "_dones",
        "_disc_returns", "_expert_windows", "_torch_rng",
    ]  # fmt: skip

    def __init__(
        self,
        policy: Any,
        env: Any,
        demonstrations: Demonstrations | Sequence[np.ndarray] | None = None,
        *,
        window: int = 4,
        n_disc_updates: int = 10,
        disc_learning_rate: float = 1e-3,
        disc_hidden: Sequence[int] = (128, 128, 128),
        disc_entropy_coef: float = 1e-3,
        gradient_penalty: float = 1.0,
        **kwargs: Any,
    ) -> None:
        self.window = window
        self.n_disc_updates = n_disc_updates
        self.disc_learning_rate = disc_learning_rate
        self.disc_hidden = tuple(disc_hidden)
        self.disc_entropy_coef = disc_entropy_coef
        self.gradient_penalty = gradient_penalty
        self._tracker: WindowTracker | None = None
        if demonstrations is None and kwargs.get("_init_setup_model", True):
            name = type(self).__name__
            raise SilemError(f"{name} needs demonstrations: a Demonstrations or a list of arrays")
        if demonstrations is not None and not isinstance(demonstrations, Demonstrations):
            demonstrations = Demonstrations.from_arrays(demonstrations)
        # None only while stable-baselines3's load fills the attributes in
        self.demonstrations: Demonstrations = demonstrations  # type: ignore[assignment]
        super().__init__(policy, env, **kwargs)

    def _setup_model(self) -> None:
        super()._setup_model()
        n_features = self.demonstrations.n_features
        windows = [episode_windows(f, self.window) for f in self.demonstrations.features]
        self._expert_windows = th.from_numpy(np.concatenate(windows)).to(self.device)
        self.features = LearnerFeatures(n_features)
        self.discriminator = self._make_discriminator(n_features).to(self.device)
        self.disc_optimizer = th.optim.Adam(
            self.discriminator.parameters(), lr=self.disc_learning_rate
        )
        self._torch_rng = th.Generator().manual_seed(self.seed or 0)

    def reseed(self, seed: int) -> None:
        """Restart every random stream of the model from ``seed``."""
        super().reseed(seed)
        self._torch_rng.manual_seed(seed)

    def state_modules(self) -> dict[str, th.nn.Module]:
        """Return policy, discriminator and what else learns, by name."""
        return super().state_modules() | {"discriminator": self.discriminator}

    def state_optimizers(self) -> dict[str, th.optim.Optimizer]:
        """Return their optimizers, by name."""
        return super().state_optimizers() | {"discriminator": self.disc_optimizer}

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        names, variables = super()._get_torch_save_params()
        return [*names, "discriminator", "disc_optimizer"], variables

    def score_windows(self, windows: np.ndarray) -> np.ndarray:
        """Return D's judgement (B,), 1 for "expert", of learner windows (B, W, F) as they are now.

        It is the reward of the actions that led to the windows' last states.

        Raises:
            SilemError: If the windows have another length or feature width than D's.
        """
        wanted = (self.window, self.features.n_features)
        if windows.shape[1:] != wanted:
            raise SilemError(f"windows must be (B, {wanted[0]}, {wanted[1]}), not {windows.shape}")
        return self._judge(self._shown(th.from_numpy(windows).to(self.device)))

    def _make_discriminator(self, n_features: int) -> th.nn.Module:
        """Build D, a module from windows (B, W, F) to logits (B,) that are high for the expert."""
        return Discriminator(n_features, self.window, self.disc_hidden)

    def _shown(self, learner_windows: th.Tensor) -> th.Tensor:
        """Return what D is shown of learner windows (N, W, F), without gradients."""
        return learner_windows

    def _update_compensation(self, learner_windows: th.Tensor) -> dict[str, float]:
        """Update what compensates for the learner's body, after D; return what to log."""
        return {}

    def _begin_rollout(self, env: VecEnv) -> None:
        starts = self._last_episode_starts
        assert starts is not None
        if self._tracker is None or starts.all():
            first = self.features.first(env, self._last_obs)
            self._tracker = WindowTracker(self.window, first)
            self._disc_returns = np.zeros(env.num_envs)
        shape = (self.n_steps, env.num_envs, self.window, self.features.n_features)
        self._windows = np.empty(shape, dtype=np.float32)
        self._dones = np.zeros(shape[:2], dtype=bool)

    def _note_step(
        self, step: int, new_obs: Any, dones: np.ndarray, infos: list[dict[str, Any]], env: VecEnv
    ) -> None:
        reached, first = self.features.reached(env, new_obs, dones, infos)
        assert self._tracker is not None
        self._windows[step] = self._tracker.push(reached)
        self._dones[step] = dones
        for environment, features in first.items():
            self._tracker.restart(environment, features)

    def _learning_rewards(self, env_rewards: np.ndarray) -> np.ndarray:
        """Run lines 7 to 10 of Algorithm 1 and return line 11's rewards, D's judgement (T, E)."""
        flat = self._windows.reshape(-1, *self._windows.shape[2:])
        if not np.isfinite(flat).all():
            raise SilemError("the learner's skeletal features hold NaN or infinity")
        learner_windows = th.from_numpy(flat).to(self.device)
        shown = self._shown(learner_windows)  # line 8, before anything changes
        stats = self.update_discriminator(shown)  # line 9
        stats |= self._update_compensation(learner_windows)  # line 10
        rewards = self._judge(shown).reshape(env_rewards.shape)
        self._imitation_stats = stats | self._disc_episode_rewards(rewards)
        self._log_imitation()
        return rewards

    def _judge(self, shown: th.Tensor) -> np.ndarray:
        with th.no_grad():
            return th.sigmoid(self.discriminator(shown)).cpu().numpy()

    def update_discriminator(self, shown: th.Tensor) -> dict[str, float]:
        """Make N_D steps of line 9 over one pass of learner windows (N, W, F) as D sees them.

        Returns:
            Means over the steps of the loss and of the share of expert and learner windows
            judged rightly.
        """
        steps = []
        for rows in self._passes(len(shown), self.n_disc_updates):
            draw = th.randint(len(self._expert_windows), (len(rows),), generator=self._torch_rng)
            mixing = th.rand(len(rows), generator=self._torch_rng).to(self.device)
            loss, stats = self._disc_loss(self._expert_windows[draw], shown[rows], mixing)
            self.disc_optimizer.zero_grad()
            loss.backward()
            self.disc_optimizer.step()
            steps.append(stats)
        return {name: float(np.mean([stats[name] for stats in steps])) for name in steps[0]}

    def _disc_loss(
        self, expert_windows: th.Tensor, learner_windows: th.Tensor, mixing: th.Tensor
    ) -> tuple[th.Tensor, dict[str, float]]:
        """Return the loss of one step on windows (B, W, F) each, and what to log of it."""
        loss = discriminator_loss(
            self.discriminator,
            expert_windows,
            learner_windows,
            entropy_coef=self.disc_entropy_coef,
            gradient_penalty=self.gradient_penalty,
            mixing=mixing,
        )
        return loss.total, {
            "disc_loss": loss.cross_entropy,
            "disc_acc_expert": loss.accuracy_expert,
            "disc_acc_learner": loss.accuracy_learner,
        }

    def _passes(self, n: int, n_batches: int) -> tuple[th.Tensor, ...]:
        """Return ``n_batches`` equal index batches that go once through ``n`` rows at random."""
        size = max(1, n // n_batches)
        order = th.randperm(n, generator=self._torch_rng)
        return order[: size * n_batches].split(size)

    def _disc_episode_rewards(self, rewards: np.ndarray) -> dict[str, float]:
        """Return the mean discriminator reward of the episodes that ended in this rollout."""
        finished = []
        for step_rewards, dones in zip(rewards, self._dones, strict=True):
            self._disc_returns += step_rewards
            if dones.any():
                finished += list(self._disc_returns[dones])
                self._disc_returns[dones] = 0.0
        return {"disc_reward": float(np.mean(finished))} if finished else {}

    def _log_imitation(self) -> None:
        for key, value in self._imitation_stats.items():
            self.logger.record(f"imitation/{key}", value)

    def _record_episodes(self) -> None:
        super()._record_episodes()
        self.iteration_stats |= self._imitation_stats
