"""Rolling out a fixed policy: evaluation by the true reward, and demonstrations with their gait.

Policies act stochastically, as in training and in the demonstrations.
"""

import random
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch as th
from stable_baselines3.common.utils import set_random_seed
from tqdm import tqdm

from silem import algorithms, bodies
from silem.algorithms.gaifo import GAIfO, LearnerFeatures, episode_windows
from silem.bodies import Body, BulletBody
from silem.bodies.body import AT_LIMIT, VELOCITY_SCALE
from silem.envs import make_vec
from silem.envs.base import INFO_KEY
from silem.motion import demonstrations as demos
from silem.motion.demonstrations import Demonstrations
from silem.study import runs
from silem.study.runs import POLICY, RunRecord
from silem.study.training import unclipped
from silem.util import seeding
from silem.util.errors import COUNT, SilemError

EVALUATION_SEED = seeding.child_seed(0, "evaluation")
"""The seed of every evaluation, whatever the method and the trial: all meet the same starts."""

_DEMONSTRATION_SEED = seeding.child_seed(0, "demonstrations")
_MAX_ENVS = 8
_FORWARD, _PITCH, _FIRST_ANGLE = 3, 7, 8  # columns of `silem.envs.bullet.LocomotionTask`


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
    config = record.run_config
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


@contextmanager
def seeded(policy: Policy, seed: int) -> Iterator[None]:
    """Have a policy draw from `seed` meanwhile; afterwards all other streams go on as they were."""
    kept = random.getstate(), np.random.get_state(), th.get_rng_state()  # noqa: NPY002
    set_random_seed(seed)  # stable-baselines3's models and policies draw from torch's generator
    if hasattr(policy, "reseed") and not isinstance(policy, algorithms.PPO):  # whose streams train
        policy.reseed(seed)
    try:
        yield
    finally:
        random.setstate(kept[0])
        np.random.set_state(kept[1])  # noqa: NPY002
        th.set_rng_state(kept[2])


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
    COUNT.check("n_episodes", n_episodes)
    n_envs = min(_MAX_ENVS, n_episodes)
    left = np.full(n_envs, n_episodes // n_envs)
    left[: n_episodes % n_envs] += 1
    env = make_vec(body, n_envs=n_envs, seed=seeding.child_seed(seed, "env"), **options)
    name = body if isinstance(body, str) else body.name
    bar = tqdm(total=n_episodes, desc=f"episodes of {name}", disable=not progress, leave=False)
    try:
        with seeded(policy, seeding.child_seed(seed, "policy")):
            observations: Any = env.reset()
            own = env.reset_infos[0].get(INFO_KEY)
            of_learner = LearnerFeatures(np.size(observations[0] if own is None else own))
            states = [[row] for row in of_learner.first(env, observations)]
            while left.any():
                actions, _ = policy.predict(observations, deterministic=False)
                observations, _, dones, infos = env.step(actions)
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


def demonstrate(
    record: RunRecord,
    n_trajectories: int = 20,
    *,
    name: str | None = None,
    force: bool = False,
    progress: bool = False,
) -> Path:
    """Record and publish state-only demonstrations of a finished run's stochastic policy.

    Failed episodes stay in; the manifest says how many, and a runner's `Gait`. Imitators find the
    file, which is returned, by `name`; None means the expert's body, whose demonstrator it then is.
    Raises SilemError: the run is no expert's, or another's are there already, and no `force`.
    """
    body = record.config["body"]
    name = body if name is None else name
    if record.config["method"] != "ppo":
        raise SilemError(f"{record.run_id} is no expert's run (its method is not ppo)")
    COUNT.check("n_trajectories", n_trajectories)
    path = demos.file_of(name)
    with demos.publishing():
        if path.exists() and not force:
            there = Demonstrations.load(path)
            n, whose = len(there.features), there.expert_run_id or "another expert"
            if whose != record.run_id or n != n_trajectories:
                told = f"{path} holds {n} trajectories of {whose} already"
                again = f"silem demonstrations --run {record.run_id} --trajectories"
                again += f" {n_trajectories} {f'--name {name} ' if name != body else ''}"
                raise SilemError(f"{told}; {runs.instead_of(path, again)}")
            if demos.is_published(name):
                return path
        else:
            there = record_episodes(
                load_policy(record), body, n_trajectories, run_id=record.run_id, progress=progress
            )
        runner = isinstance(bodies.get(body), BulletBody)
        return demos.publish(name, there, gait(there)._asdict() if runner else None)


def describe(name: str) -> str:
    """Say in one line what the manifest knows of demonstrations that an expert made."""
    about = demos.entry(name)
    text = "{n_trajectories} trajectories of {expert_run_id}"
    text += ", return {return_mean:.0f} ± {return_std:.0f}"
    if "pitch_rad" in about:
        text += ", worst {return_worst:.0f}, failed and kept: {n_failed}; {speed_m_s:.2f} m/s"
        text += ", pitch {pitch_rad:.2f} ± {pitch_std_rad:.2f} rad"
        text += ", a joint at a limit {limit_share:.0%} of the time"
    return text.format(**about)


class Gait(NamedTuple):
    """How a runner moves, by its features, and what the manifest says of an expert's returns."""

    speed_m_s: float
    pitch_rad: float  # mean over all states; positive is nose down
    pitch_std_rad: float
    limit_share: float  # of the states, those with any joint at its limit
    joints_at_limit: float  # mean number of joints at their limits, which the task charges
    return_worst: float | None  # None where the returns are unknown
    n_failed: int | None  # episodes, none of which is left out


def gait(demonstrations: Demonstrations) -> Gait:
    """Measure the gait of a runner's demonstrations over all states; SilemError for others."""
    states = np.concatenate(demonstrations.features)
    at_limits = joints_at_limit(states, demonstrations.body)
    pitch = pitch_rad(states)
    returns = np.array(demonstrations.returns)
    return Gait(
        speed_m_s=float(states[:, _FORWARD].mean(dtype=np.float64)) / VELOCITY_SCALE,
        pitch_rad=float(pitch.mean()),
        pitch_std_rad=float(pitch.std()),
        limit_share=float((at_limits > 0).mean()),
        joints_at_limit=float(at_limits.mean()),
        return_worst=float(returns.min()) if len(returns) else None,
        n_failed=int(failed(returns).sum()) if len(returns) else None,
    )


def pitch_rad(features: np.ndarray) -> np.ndarray:
    """Return the torso's pitch of every state, (..., F) to (...); positive is nose down."""
    return np.asarray(features[..., _PITCH], dtype=np.float64)


def joints_at_limit(features: np.ndarray, body: str) -> np.ndarray:
    """Count the joints at their limits in a runner's every state, (..., F) to (...)."""
    found = bodies.get(body)
    if not isinstance(found, BulletBody):
        raise SilemError(f"a gait is measured on HalfCheetahs and Ants, not on {body}")
    if features.shape[-1] != found.observation_size:
        raise SilemError(f"{features.shape[-1]} features, {body} has {found.observation_size}")
    angles = features[..., _FIRST_ANGLE : _FIRST_ANGLE + 2 * len(found.motors) : 2]
    return np.asarray((np.abs(angles) > AT_LIMIT).sum(axis=-1))


def failed(returns: np.ndarray) -> np.ndarray:
    """Tell of every episode, (N,), whether it returns less than half of what the median does."""
    median = float(np.median(returns))
    return np.asarray(returns < median - abs(median) / 2)
