"""GAIfO on windows: adversarial imitation from observation, which is Algorithm 1 without T.

A window o_t = (g(s_t), ..., g(s_t+n)) of skeletal features ends at the state a transition leads to,
so its reward speaks of the action taken, and never reaches across an episode's end. The first ones
of an episode repeat its first state until there are enough states.
"""

import warnings
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import torch as th
from gymnasium import spaces
from gymnasium.wrappers import NormalizeObservation
from stable_baselines3.common.vec_env import VecEnv, unwrap_vec_normalize
from torch.nn import functional as F

from silem.algorithms.networks import Discriminator, discriminator_loss
from silem.algorithms.ppo import PPO
from silem.envs.base import INFO_KEY
from silem.motion.demonstrations import Demonstrations
from silem.util.errors import COUNT, WEIGHT, NumberKind, SilemError, choose

REWARDS = {
    "d": th.sigmoid,  # D
    "airl": lambda logits: logits,  # log D - log(1 - D)
    "gail": F.softplus,  # -log(1 - D)
}
"""The reward of a window by name, from the logit of D."""


def descend(optimizer: th.optim.Optimizer, loss: th.Tensor) -> None:
    """Step down the loss in what an optimizer learns; no other gradient is even computed."""
    learned = optimizer.param_groups[0]["params"]
    for p, gradient in zip(learned, th.autograd.grad(loss, learned), strict=True):
        p.grad = gradient
    optimizer.step()


class SurvivalWarning(UserWarning):
    """The learner's episodes can end, and the reward pays for when they do."""


class GAIfO(PPO):
    """Generative adversarial imitation from observation (Torabi et al., 2018) on windows.

    Each iteration collects a rollout, updates the discriminator D on it, puts D's judgement in
    the rewards' place and makes a PPO update. This is the paper's SILEM-minus; :class:`SILEM`
    adds the transform T, :class:`TPIL` another discriminator.

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
        reward: "d" is the paper's, D itself; it is never negative, so where episodes can end it
            pays for surviving. "airl" is log D - log(1 - D), "gail" is -log(1 - D).
        absorbing_states: Let an episode that ends, and is not cut by a time limit, go on in an
            absorbing state that D judges too (Kostrikov et al., 2019), so that the reward favours
            neither surviving nor ending. True if all demonstrations end in a terminal state, or
            one bool for each.
        **kwargs: Everything :class:`PPO` takes.

    Raises SilemError on unusable demonstrations or settings; in `learn`, on features of another
    width than the demonstrations', or that not every environment supplies alike.
    """

    _numbers: ClassVar[dict[str, NumberKind]] = PPO._numbers | {
        "window": COUNT, "n_disc_updates": COUNT, "disc_learning_rate": WEIGHT,
        "disc_entropy_coef": WEIGHT, "gradient_penalty": WEIGHT,
    }  # fmt: skip
    _learns: ClassVar[dict[str, tuple[str, str]]] = PPO._learns | {
        "discriminator": ("discriminator", "disc_optimizer")
    }
    _transient: ClassVar[list[str]] = [
        *PPO._transient, "_features", "_recent", "_windows", "_ends", "_warned", "_disc_returns",
        "_expert_windows", "_torch_rng",
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
        gradient_penalty: float = 0.1,
        reward: str = "d",
        absorbing_states: bool | Sequence[bool] | np.ndarray = False,
        **kwargs: Any,
    ) -> None:
        # as given: `_setup_model` checks them, because `load` puts arguments of its own in place
        self.demonstrations: Any = demonstrations
        self.window = window
        self.n_disc_updates = n_disc_updates
        self.disc_learning_rate = disc_learning_rate
        self.disc_hidden = disc_hidden
        self.disc_entropy_coef = disc_entropy_coef
        self.gradient_penalty = gradient_penalty
        self.reward = reward
        self.absorbing_states: Any = absorbing_states
        super().__init__(policy, env, **kwargs)

    def train(self) -> None:
        """Make one iteration of Algorithm 1 (line 5), after line 6 has collected a rollout.

        Lines 1 to 4 are `_setup_model`'s.
        """
        tau_c = self._collected_windows()  # lines 6 and 7, (N, W, F): they stay as they are
        tau = self._transformed(tau_c).detach()  # line 8, T(o); GAIfO has no T
        stats = self.update_discriminator(tau)  # line 9
        stats |= self.update_transform(tau_c)  # line 10, D's weights fixed; GAIfO has no T
        rewards = self._judged(tau, self.reward)  # line 11: D of line 9, but T(o) of line 8
        self._learn_from(rewards)  # and the advantages that follow from these rewards
        super().train()  # PPO's update of the policy
        self._report(stats, rewards)

    def update_discriminator(self, tau: th.Tensor) -> dict[str, float]:
        """Make N_D steps of line 9 over one pass of learner windows (N, W, F) as D sees them.

        Returns the steps' mean loss and shares of expert and learner windows judged rightly.
        """
        self.disc_optimizer.param_groups[0]["lr"] = self.disc_learning_rate
        steps = []
        for rows in self._passes(len(tau), self.n_disc_updates):
            draw = th.randint(len(self._expert_windows), (len(rows),), generator=self._torch_rng)
            mixing = th.rand(len(rows), generator=self._torch_rng).to(self.device)
            loss, stats = self._disc_loss(self._expert_windows[draw], tau[rows], mixing)
            descend(self.disc_optimizer, loss)
            steps.append(stats)
        return {name: float(np.mean([stats[name] for stats in steps])) for name in steps[0]}

    def update_transform(self, tau_c: th.Tensor) -> dict[str, float]:
        """Make line 10's steps on learner windows (N, W, F) and return what to log: none here."""
        return {}

    def score_windows(self, windows: np.ndarray) -> np.ndarray:
        """Return D's judgement (B,), 1 for "expert", of learner windows (B, W, F) as they are now.

        Raises SilemError if the windows have another length or feature width than D's.
        """
        windows = np.asarray(windows, dtype=np.float32)
        wanted = (self.window, self.demonstrations.n_features)
        if windows.shape[1:] != wanted:
            raise SilemError(f"windows must be (B, {wanted[0]}, {wanted[1]}), not {windows.shape}")
        shown = th.from_numpy(marked(windows) if self._absorbing else windows).to(self.device)
        return self._judged(self._transformed(shown), "d")

    def _seed_streams(self, seed: int) -> None:
        super()._seed_streams(seed)
        self._torch_rng = th.Generator().manual_seed(seed)

    def _check_settings(self) -> None:
        super()._check_settings()
        if not isinstance(self.disc_hidden, Sequence):
            raise SilemError(f"disc_hidden must be a list of layer sizes, not {self.disc_hidden!r}")
        for size in self.disc_hidden:
            COUNT.check("each size in disc_hidden", size)
        rows = self.n_steps * self.n_envs
        for name in self._numbers:
            if name.endswith("_updates") and getattr(self, name) > rows:
                raise SilemError(f"{name} is {getattr(self, name)}; a rollout has {rows} windows")
        choose("reward", self.reward, REWARDS)
        self.demonstrations = Demonstrations.of(self.demonstrations)
        marks, n = self.absorbing_states, len(self.demonstrations.features)
        if isinstance(marks, np.ndarray | np.bool_):
            marks = marks.tolist()
        self._absorbing = marks is not False
        self._ended = ended = [marks] * n if isinstance(marks, bool) else marks
        known = isinstance(ended, Sequence) and len(ended) == n
        if not known or not all(isinstance(end, bool | np.bool_) for end in ended):
            raise SilemError(f"absorbing_states must be a bool, or one for each of {n} episodes")
        if self._absorbing and not self.gamma < 1:
            raise SilemError(f"absorbing_states need a gamma below 1, not {self.gamma!r}")

    def _setup_model(self) -> None:
        super()._setup_model()
        n_features = self.demonstrations.n_features
        self._features = LearnerFeatures(n_features)
        self._recent: np.ndarray | None = None  # the windows (E, W, F) that end at present
        self._warned = False
        windows = [episode_windows(f, self.window) for f in self.demonstrations.features]
        if self._absorbing:  # those in the absorbing state come last
            ended = (w for w, end in zip(windows, self._ended, strict=True) if end)
            windows = [*map(marked, windows), *(absorbing_windows(w[-1]) for w in ended)]
        self._expert_windows = th.from_numpy(np.concatenate(windows)).to(self.device)
        self.discriminator = self._make_discriminator(n_features + self._absorbing).to(self.device)
        learned, rate = self.discriminator.parameters(), self.disc_learning_rate
        self.disc_optimizer = th.optim.Adam(learned, lr=rate)

    def _make_discriminator(self, n_features: int) -> th.nn.Module:
        """Build D, a module from windows (B, W, F) to logits (B,) that are high for the expert."""
        return Discriminator(n_features, self.window, self.disc_hidden)

    def _begin_rollout(self, env: VecEnv) -> None:
        starts = self._last_episode_starts
        assert starts is not None
        if self._recent is None or starts.all():
            first = self._features.first(env, self._last_obs)
            self._recent = np.repeat(first[:, None], self.window, axis=1)
            self._disc_returns = np.zeros(env.num_envs)
        self._windows = np.empty((self.n_steps, *self._recent.shape), dtype=np.float32)
        self._ends: list[tuple[int, int]] = []  # steps and environments with a terminal state

    def _note_step(
        self, step: int, new_obs: Any, dones: np.ndarray, infos: list[dict[str, Any]], env: VecEnv
    ) -> None:
        reached, first = self._features.reached(env, new_obs, dones, infos)
        assert self._recent is not None
        self._recent[:, :-1] = self._recent[:, 1:]
        self._recent[:, -1] = reached
        self._windows[step] = self._recent
        for environment, features in first.items():
            self._recent[environment] = features
            if not infos[environment].get("TimeLimit.truncated", False):
                self._ends.append((step, environment))

    def _collected_windows(self) -> th.Tensor:
        """Return the rollout's windows (T * E, W, F), those after episodes' ends behind them."""
        windows = self._windows.reshape(-1, *self._windows.shape[2:])
        if not np.isfinite(windows).all():
            raise SilemError("the learner's skeletal features hold NaN or infinity")
        if self._absorbing:
            after = [absorbing_windows(self._windows[end]) for end in self._ends]
            windows = np.concatenate([marked(windows), *after])
        elif self._ends and not self._warned:
            self._warned = True
            warnings.warn(
                f"episodes end before their time limit, and the reward {self.reward!r} pays for"
                " when they do: where it is positive, for surviving, so that a learner may avoid"
                " its goal. absorbing_states=True removes this bias",
                SurvivalWarning,
                stacklevel=5,  # where `learn` was called
            )
        return th.from_numpy(windows).to(self.device)

    def _transformed(self, windows: th.Tensor) -> th.Tensor:
        """Return what D is shown of learner windows (N, W, F)."""
        return windows

    def _judged(self, tau: th.Tensor, reward: str) -> np.ndarray:
        with th.no_grad():
            return REWARDS[reward](self.discriminator(tau)).cpu().numpy()

    def _learn_from(self, judged: np.ndarray) -> None:
        """Put rewards in the rollout's place: of its steps and, behind them, after ends.

        What follows an end is worth its discounted rewards in the absorbing state, for ever.
        """
        shape = self._windows.shape[:2]
        rewards, behind = np.split(judged, [shape[0] * shape[1]])
        if self._absorbing:
            discounts = self.gamma ** np.arange(1.0, self.window + 1)
            discounts[-1] /= 1.0 - self.gamma
            after = behind.reshape(-1, self.window) @ discounts
            for end, worth in zip(self._ends, after, strict=True):
                self._bootstrap[end] = worth
        self._set_rewards(rewards.reshape(shape))

    def _disc_loss(
        self, expert_windows: th.Tensor, learner_windows: th.Tensor, mixing: th.Tensor
    ) -> tuple[th.Tensor, dict[str, float]]:
        """Return the loss of one step on windows (B, W, F) each, and what to log of it."""
        return discriminator_loss(
            self.discriminator, expert_windows, learner_windows, mixing=mixing,
            entropy_coef=self.disc_entropy_coef, gradient_penalty=self.gradient_penalty,
        )  # fmt: skip

    def _passes(self, n: int, n_batches: int) -> tuple[th.Tensor, ...]:
        """Return ``n_batches`` equal index batches that go once through ``n`` rows at random."""
        size = max(1, n // n_batches)
        order = th.randperm(n, generator=self._torch_rng)
        return order[: size * n_batches].split(size)

    def _report(self, stats: dict[str, float], judged: np.ndarray) -> None:
        """Log an iteration, with the mean learned reward of the episodes that ended in it."""
        starts, finished = self.rollout_buffer.episode_starts, []
        dones = np.concatenate([starts[1:], [self._last_episode_starts]]).astype(bool)
        for rewards, done in zip(judged[: dones.size].reshape(dones.shape), dones, strict=True):
            self._disc_returns += rewards
            finished += self._disc_returns[done].tolist()
            self._disc_returns[done] = 0.0
        if finished:
            stats["disc_reward"] = float(np.mean(finished))
        for key, value in stats.items():
            self.logger.record(f"imitation/{key}", value)
        self.iteration_stats |= stats


# ---------------------------------------------------------------- windows


def episode_windows(features: np.ndarray, window: int) -> np.ndarray:
    """Cut an episode's features (T + 1, F), T >= 1, into windows (T, W, F); row t ends at t + 1."""
    last = np.arange(1, len(features))
    states = last[:, None] + np.arange(1 - window, 1)[None, :]
    return features[np.maximum(states, 0)]


def marked(windows: np.ndarray) -> np.ndarray:
    """Return windows (..., F) with one feature more, 0: no state of theirs is absorbing."""
    return np.concatenate([windows, np.zeros_like(windows[..., :1])], axis=-1)


def absorbing_windows(last: np.ndarray) -> np.ndarray:
    """Return the windows (W, W, F + 1) of an episode that has ended, after its last one, (W, F).

    It stays in the absorbing state, which has no features but a mark that tells it from all others
    (Kostrikov et al., 2019). Row k ends k + 1 states after the terminal one, and the last row
    holds the absorbing state alone, as all windows after it would.
    """
    states = np.concatenate([marked(last), np.zeros_like(marked(last))])
    states[len(last) :, -1] = 1.0
    return episode_windows(states, len(last))[-len(last) :]


class LearnerFeatures:
    """g for the learner: its observation, or what the environment's ``info`` holds beside it.

    Environments that supply ``info["skeletal_features"]`` (F,) from ``reset`` and ``step`` have a
    g of their own; for all others g is the identity. Which of the two holds is decided at the first
    reset, for all environments and for good. F must be that of the demonstrations. Raises
    SilemError: features are of another width, come from some environments or calls only, or there
    are none: observations that are no arrays, or that change by themselves.
    """

    def __init__(self, n_features: int) -> None:
        self.n_features = n_features
        self._in_infos: bool | None = None

    def first(self, env: VecEnv, observations: Any) -> np.ndarray:
        """Return the features (E, F) of the states the environments are in after a reset."""
        infos = env.unwrapped.reset_infos
        if self._in_infos is None:
            self._in_infos = any(INFO_KEY in info for info in infos)
        if not self._in_infos:
            _check_observations(env)
        return self._read(observations, infos, "reset", range(env.num_envs))

    def reached(
        self, env: VecEnv, observations: Any, dones: np.ndarray, infos: list[dict[str, Any]]
    ) -> tuple[np.ndarray, dict[int, np.ndarray]]:
        """Return the features (E, F) of the states a step led to, terminal ones included.

        With them, per environment whose episode ended, come the features (F,) of the new episode's
        first state. ``observations``, ``dones`` and ``infos`` are the step's.
        """
        ended = np.flatnonzero(dones).tolist()
        terminal = observations
        if ended and not self._in_infos:
            terminal = np.array(observations)
            for i in ended:
                terminal[i] = infos[i]["terminal_observation"]
        reached = self._read(terminal, infos, "step", range(len(dones)))
        if not ended:
            return reached, {}
        first = self._read(observations, env.unwrapped.reset_infos, "reset", ended)
        return reached, dict(zip(ended, first, strict=True))

    def _read(self, observations: Any, infos: Any, call: str, which: Sequence[int]) -> np.ndarray:
        """Return the features (len(which), F) of some environments."""
        for i in which:
            if (INFO_KEY in infos[i]) != self._in_infos:
                has = "lacks" if self._in_infos else "supplies"
                told = (
                    f"environment {i} {has} info[{INFO_KEY!r}] at {call}, unlike at the first reset"
                )
                raise SilemError(f"{told}; all must supply it from both reset and step, or none")
        rows = [infos[i][INFO_KEY] if self._in_infos else observations[i] for i in which]
        try:
            features = np.array(rows)
        except ValueError as error:  # of several lengths
            raise SilemError(f"the learner's skeletal features are no vectors: {error}") from error
        if (kind := features.dtype).kind not in "fiu":
            raise SilemError(f"the learner's features are no vectors of numbers but {kind}")
        features = features.astype(np.float32, copy=False).reshape(len(which), -1)
        if features.shape[1] != self.n_features:
            told = f"the demonstrations have {self.n_features} features per state, the learner's"
            raise SilemError(f"{told} environment supplies {features.shape[1]}; g must be the same")
        return features


def _check_observations(env: VecEnv) -> None:
    """Raise SilemError unless the observations can serve as features."""
    if isinstance(env.observation_space, spaces.Dict):
        told = "a dictionary of observations is no vector of features; the environment must supply"
        raise SilemError(f"{told} info[{INFO_KEY!r}] from reset and step")
    wrapper, remedy = unwrap_vec_normalize(env), "leave it away"
    changes = "NormalizeObservation" if any(env.env_is_wrapped(NormalizeObservation)) else ""
    if wrapper is not None and wrapper.norm_obs:
        changes, remedy = "VecNormalize", f"{remedy} or pass it norm_obs=False"
    if changes:
        told = f"{changes} changes the observations that are compared with the demonstrations as it"
        told += f" goes; {remedy} (the policy normalises its observations itself), or have the"
        raise SilemError(f"{told} environment supply info[{INFO_KEY!r}]")
