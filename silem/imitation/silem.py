"""SILEM and SILEM-minus: Algorithm 1 as a stable-baselines3 algorithm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import torch as th
from stable_baselines3.common.vec_env import VecEnv
from torch.nn import functional as F

from silem.demonstrations import Demonstrations
from silem.errors import SilemError, choose
from silem.imitation.discriminator import Discriminator, discriminator_loss
from silem.imitation.features import LearnerFeatures
from silem.imitation.transforms import (
    L2_FORMS,
    TRANSFORMS,
    AffineTransform,
    l2_penalty,
    make_transform,
)
from silem.imitation.windows import WindowTracker, episode_windows
from silem.learning.ppo import PPO


class SILEM(PPO):
    """Skeletal feature compensation for imitation learning with embodiment mismatch.

    Each iteration collects a rollout, updates the discriminator D on it, updates the transform
    T with D's weights fixed, puts D(T(o)) in the rewards' place and makes a PPO update.

    Args:
        policy: As in stable-baselines3 ("MlpPolicy").
        env: A Gymnasium or vectorised environment. Its rewards are only reported. Skeletal
            features g(s) are ``info["skeletal_features"]`` where it supplies them, else the
            observation.
        demonstrations: The expert's :class:`Demonstrations`, or a list of (T + 1, F) arrays.
        transform: f of the sequential transform: "affine" is SILEM, "identity" SILEM-minus,
            "mlp" the ablation of Table 1.
        window: States per window, the supplement's n = 4.
        n_disc_updates: N_D, discriminator steps per iteration, one pass over the rollout.
        n_transform_updates: N_G, transform steps per iteration, likewise.
        transform_lr_decay: d, factor on the transform's learning rate per iteration.
        transform_l2_scale: w_d, weight of the L2 term on A; 0 switches it off (HalfCheetah, Ant).
        transform_l2_bias: w_b, weight of the L2 term on b; likewise.
        transform_l2_form: "deviation" penalises A - 1, "plain" A itself (see `l2_penalty`).
        disc_learning_rate: Adam's rate for D.
        transform_learning_rate: Adam's rate for T at the first iteration.
        disc_hidden: Hidden units of D.
        disc_entropy_coef: Weight of D's entropy bonus.
        gradient_penalty: Weight of the penalty on D's gradient. The paper has none (0), and
            then D wins outright on a body that cannot match the expert: see "Deviations".
        **kwargs: Everything :class:`PPO` takes.

    Raises:
        SilemError: On an unknown transform or form, an L2 term on another transform than the
            affine one, unusable demonstrations, or demonstrations of another feature width than
            the learner's.
    """

    _transient: ClassVar[list[str]] = [
        *PPO._transient, "discriminator", "transform_net", "disc_optimizer",
        "transform_optimizer", "_tracker", "_windows", "_dones", "_disc_returns",
        "_expert_windows", "_torch_rng",
    ]  # fmt: skip

    def __init__(
        self,
        policy: Any,
        env: Any,
        demonstrations: Demonstrations | Sequence[np.ndarray] | None = None,
        *,
        transform: str = "affine",
        window: int = 4,
        n_disc_updates: int = 10,
        n_transform_updates: int = 5,
        transform_lr_decay: float = 1.0,
        transform_l2_scale: float = 0.0,
        transform_l2_bias: float = 0.0,
        transform_l2_form: str = "deviation",
        disc_learning_rate: float = 1e-3,
        transform_learning_rate: float = 1e-4,
        disc_hidden: Sequence[int] = (128, 128, 128),
        disc_entropy_coef: float = 1e-3,
        gradient_penalty: float = 1.0,
        **kwargs: Any,
    ) -> None:
        self.transform = choose("transform", transform, TRANSFORMS)
        self.window = window
        self.n_disc_updates = n_disc_updates
        self.n_transform_updates = n_transform_updates
        self.transform_lr_decay = transform_lr_decay
        self.transform_l2_scale = transform_l2_scale
        self.transform_l2_bias = transform_l2_bias
        self.transform_l2_form = choose("transform_l2_form", transform_l2_form, L2_FORMS)
        if (transform_l2_scale or transform_l2_bias) and transform != "affine":
            raise SilemError(f"the L2 term is the affine transform's; {transform!r} has none")
        self.disc_learning_rate = disc_learning_rate
        self.transform_learning_rate = transform_learning_rate
        self.disc_hidden = tuple(disc_hidden)
        self.disc_entropy_coef = disc_entropy_coef
        self.gradient_penalty = gradient_penalty
        self._tracker: WindowTracker | None = None
        if demonstrations is None and kwargs.get("_init_setup_model", True):
            raise SilemError("SILEM needs demonstrations: a Demonstrations or a list of arrays")
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
        self.discriminator = Discriminator(n_features, self.window, self.disc_hidden)
        self.discriminator.to(self.device)
        self.disc_optimizer = th.optim.Adam(
            self.discriminator.parameters(), lr=self.disc_learning_rate
        )
        self.transform_net = make_transform(self.transform, n_features).to(self.device)
        learned = list(self.transform_net.parameters())
        self.transform_optimizer = (
            th.optim.Adam(learned, lr=self.transform_learning_rate) if learned else None
        )
        self._torch_rng = th.Generator().manual_seed(self.seed or 0)

    def reseed(self, seed: int) -> None:
        """Restart every random stream of the model from ``seed``."""
        super().reseed(seed)
        self._torch_rng.manual_seed(seed)

    def state_modules(self) -> dict[str, th.nn.Module]:
        """Return policy, discriminator and transform, by name."""
        own = {"discriminator": self.discriminator, "transform": self.transform_net}
        return super().state_modules() | own

    def state_optimizers(self) -> dict[str, th.optim.Optimizer]:
        """Return their optimizers, by name."""
        own = {"discriminator": self.disc_optimizer}
        if self.transform_optimizer is not None:
            own["transform"] = self.transform_optimizer
        return super().state_optimizers() | own

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        own = ["discriminator", "transform_net", "disc_optimizer"]
        if self.transform_optimizer is not None:
            own.append("transform_optimizer")
        names, variables = super()._get_torch_save_params()
        return [*names, *own], variables

    def score_windows(self, windows: np.ndarray) -> np.ndarray:
        """Return D(T(o)) (B,) of learner windows (B, W, F) under the present weights."""
        with th.no_grad():
            transformed = self.transform_net(th.from_numpy(windows).to(self.device))
            return th.sigmoid(self.discriminator(transformed)).cpu().numpy()

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
        """Run lines 7 to 10 of Algorithm 1 and return line 11's rewards D(T(o)), (T, E)."""
        flat = self._windows.reshape(-1, *self._windows.shape[2:])
        learner_windows = th.from_numpy(flat).to(self.device)
        with th.no_grad():
            transformed = self.transform_net(learner_windows)  # line 8, before T changes
        stats = self.update_discriminator(transformed)  # line 9
        stats |= self.update_transform(learner_windows)  # line 10
        with th.no_grad():
            rewards = th.sigmoid(self.discriminator(transformed)).cpu().numpy()
        rewards = rewards.reshape(env_rewards.shape)
        self._imitation_stats = stats | self._disc_episode_rewards(rewards)
        self._log_imitation()
        return rewards

    def update_discriminator(self, transformed: th.Tensor) -> dict[str, float]:
        """Make N_D steps of line 9 over one pass of transformed learner windows (N, W, F).

        Returns:
            Mean loss and the share of expert and learner windows judged rightly.
        """
        losses = []
        for rows in self._passes(len(transformed), self.n_disc_updates):
            draw = th.randint(len(self._expert_windows), (len(rows),), generator=self._torch_rng)
            mixing = th.rand(len(rows), generator=self._torch_rng).to(self.device)
            loss = discriminator_loss(
                self.discriminator,
                self._expert_windows[draw],
                transformed[rows],
                entropy_coef=self.disc_entropy_coef,
                gradient_penalty=self.gradient_penalty,
                mixing=mixing,
            )
            self.disc_optimizer.zero_grad()
            loss.total.backward()
            self.disc_optimizer.step()
            losses.append(loss)
        return {
            "disc_loss": float(np.mean([loss.cross_entropy for loss in losses])),
            "disc_acc_expert": float(np.mean([loss.accuracy_expert for loss in losses])),
            "disc_acc_learner": float(np.mean([loss.accuracy_learner for loss in losses])),
        }

    def update_transform(self, learner_windows: th.Tensor) -> dict[str, float]:
        """Make N_G steps of line 10 on windows (N, W, F); D's weights stay.

        Returns:
            The mean of line 10's loss -log D(T(o)), without the L2 term, and the learning rate.
        """
        if self.transform_optimizer is None:
            return {}
        iteration = self.num_timesteps // (self.n_steps * self.n_envs) - 1
        rate = self.transform_learning_rate * self.transform_lr_decay**iteration
        self.transform_optimizer.param_groups[0]["lr"] = rate
        learned = list(self.transform_net.parameters())
        losses = []
        for rows in self._passes(len(learner_windows), self.n_transform_updates):
            logits = self.discriminator(self.transform_net(learner_windows[rows]))
            loss = F.softplus(-logits).mean()  # -log sigmoid(logit)
            losses.append(loss.item())
            if self.transform_l2_scale or self.transform_l2_bias:
                assert isinstance(self.transform_net, AffineTransform)
                loss = loss + l2_penalty(
                    self.transform_net, self.transform_l2_scale, self.transform_l2_bias,
                    self.transform_l2_form,
                )  # fmt: skip
            # gradients by T alone: D's are not even computed
            for p, gradient in zip(learned, th.autograd.grad(loss, learned), strict=True):
                p.grad = gradient
            self.transform_optimizer.step()
        return {"transform_loss": float(np.mean(losses)), "transform_learning_rate": rate}

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
        if isinstance(self.transform_net, AffineTransform):
            with th.no_grad():
                for name, values in self.transform_net.named_parameters():
                    for i, entry in enumerate(values.tolist()):
                        self.logger.record(f"transform/{name}_{i}", entry, exclude="stdout")

    def _record_episodes(self) -> None:
        super()._record_episodes()
        self.iteration_stats |= self._imitation_stats
