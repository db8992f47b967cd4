"""Rolling out a fixed policy: evaluation by the true reward, and recording demonstrations.

Policies act stochastically, as in training and in the demonstrations.
"""

from collections.abc import Generator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from stable_baselines3.common.utils import set_random_seed
from tqdm import tqdm

from silem import algorithms, bodies
from silem.algorithms.gaifo import GAIfO, LearnerFeatures, episode_windows
from silem.bodies import Body
from silem.envs import make_vec
from silem.envs.base import INFO_KEY
from silem.motion.demonstrations import Demonstrations
from silem.study.runs import POLICY, RunRecord
from silem.study.training import unclipped
from silem.util import seeding
from silem.util.errors import SilemError

EVALUATION_SEED = seeding.child_seed(0, "evaluation")
"""The seed of every evaluation, whatever the method and the trial: all meet the same starts."""

_DEMONSTRATION_SEED = seeding.child_seed(0, "demonstrations")
_MAX_ENVS = 8


class Policy(Protocol):
    """Whatever acts: a stable-baselines3 model or policy, or a `RandomPolicy`."""

    def predict(self, observation: Any, *, deterministic: bool = False) -> tuple[Any, Any]:
        """Return actions (E, A) for observations (E, O), and a state that is not used."""


class RandomPolicy:
    """The untrained Gaussian policy N(0, std) of a body, the paper's lower mark in Figure 2.

    Its actions are not clipped, so that the task charges them as they are, as PyBullet's does.
    """

    def __init__(self, body: Body | str, seed: int = 0, std: float = 1.0) -> None:
        moved = bodies.get(body) if isinstance(body, str) else body
        self._n_actions, self._seed, self._std = moved.action_size, seed, std
        self.reseed(0)

    def reseed(self, seed: int) -> None:
        """Restart the random actions; trials differ for the same `seed`."""
        self._generator = seeding.generator(self._seed, "random policy", seed)

    def predict(self, observation: Any, *, deterministic: bool = False) -> tuple[Any, None]:
        """Return random actions (E, A), whatever the observations (E, O)."""
        size = (len(observation), self._n_actions)
        return self._std * self._generator.standard_normal(size, dtype=np.float32), None


def load_policy(record: RunRecord) -> Policy:
    """Return a finished run's policy, ready to `predict`; SilemError if it is not as recorded."""
    config = record.run_config()
    if config.method == "random":
        return RandomPolicy(config.learner, config.seed, config.hyper.action_std)
    policy, env = algorithms.load_policy(record.file(POLICY)), make_vec(config.learner, 1)
    env.close()
    for kind in ("observation_space", "action_space"):
        found, wanted = getattr(policy, kind).shape, getattr(env, kind).shape
        if found != wanted:
            raise SilemError(f"{POLICY} is of another body: its {kind} is {found}, not {wanted}")
    if not config.hyper.clip_actions:
        policy.action_space = unclipped(policy.action_space)
    return policy


class Episode(NamedTuple):
    """One finished episode."""

    features: np.ndarray  # skeletal features of all states, (T + 1, F) float32
    episode_return: float  # sum of the true rewards
    speed_m_s: float | None  # mean, forward; None where the environment does not say
    upright: float | None  # fraction of the steps with the alive bonus, or None likewise

    @property
    def n_steps(self) -> int:
        """How long it was."""
        return len(self.features) - 1


class Evaluation(NamedTuple):
    """What a policy achieved over `n_episodes` episodes, by the true reward."""

    n_episodes: int
    return_mean: float
    return_std: float
    returns: list[float]
    speed_m_s: float | None  # None where the environment does not say
    upright: float | None
    steps_mean: float | None  # of an episode
    disc_reward_mean: float | None  # per episode; None where there is no discriminator


def episodes(
    policy: Policy,
    body: Body | str,
    n_episodes: int,
    seed: int,
    *,
    progress: bool = False,
    **options: Any,
) -> Generator[Episode, None, None]:
    """Roll out a policy for exactly `n_episodes` episodes, yielded in the order they end in.

    Every environment's number of episodes is fixed beforehand, so that short episodes are not
    over-represented. The random numbers of policy and environments restart from `seed`; `options`
    are the environments' (see `silem.envs.make_vec`). Raises SilemError: the body is unknown, or
    `n_episodes` is below 1.
    """
    if n_episodes < 1:
        raise SilemError(f"episodes must be 1 or more, not {n_episodes}")
    n_envs = min(_MAX_ENVS, n_episodes)
    left = np.full(n_envs, n_episodes // n_envs)
    left[: n_episodes % n_envs] += 1
    env = make_vec(body, n_envs=n_envs, seed=seeding.child_seed(seed, "env"), **options)
    name = body if isinstance(body, str) else body.name
    bar = tqdm(total=n_episodes, desc=f"episodes of {name}", disable=not progress, leave=False)
    try:
        reseed = getattr(policy, "reseed", set_random_seed)  # torch's generator draws for others
        reseed(seeding.child_seed(seed, "policy"))
        observations = np.asarray(env.reset())
        first = np.asarray(env.reset_infos[0].get(INFO_KEY, observations[0]))
        of_learner = LearnerFeatures(first.size)
        states = [[row] for row in of_learner.first(env, observations)]
        while left.any():
            actions, _ = policy.predict(observations, deterministic=False)
            stepped, _, dones, infos = env.step(actions)
            observations = np.asarray(stepped)
            reached, restarted = of_learner.reached(env, observations, dones, infos)
            for i in np.flatnonzero(left).tolist():
                states[i].append(reached[i].copy())
                if dones[i]:
                    info = infos[i]["episode"]
                    told = (info.get("speed_m_s"), info.get("upright"))
                    features = np.stack(states[i]).astype(np.float32)
                    yield Episode(features, float(info["r"]), *told)
                    states[i] = [restarted[i]]
                    left[i] -= 1
                    bar.update()
    finally:
        bar.close()
        env.close()


def evaluate(
    policy: Policy,
    body: Body | str,
    n_episodes: int,
    seed: int = EVALUATION_SEED,
    model: GAIfO | None = None,
    *,
    progress: bool = False,
    **options: Any,
) -> Evaluation:
    """Evaluate a policy over `episodes` by the true reward, and by a `model`'s discriminator."""
    found, scores = [], []
    for episode in episodes(policy, body, n_episodes, seed, progress=progress, **options):
        found.append((*episode[1:], episode.n_steps))
        if model is not None:
            windows = episode_windows(episode.features, model.window)
            scores.append(float(model.score_windows(windows).sum()))
    returns, speeds, uprights, steps = zip(*found, strict=True)
    mean, std = float(np.mean(returns)), float(np.std(returns))
    rounded = [round(value, 3) for value in returns]
    told = _mean(speeds), _mean(uprights), _mean(steps), _mean(scores)
    return Evaluation(n_episodes, mean, std, rounded, *told)


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def record_episodes(
    policy: Policy, body: str, n_trajectories: int = 20, *, run_id: str = "", progress: bool = False
) -> Demonstrations:
    """Record `episodes` of an expert's policy, `run_id` or no run's (""), without actions."""
    recorded = episodes(policy, body, n_trajectories, _DEMONSTRATION_SEED, progress=progress)
    features, returns, *_ = zip(*recorded, strict=True)
    return Demonstrations(features, returns, body, run_id)
