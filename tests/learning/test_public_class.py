"""What users do with the classes: load, stop, wrap, feed odd environments; nothing is silent."""

from __future__ import annotations

import dataclasses
import inspect
import os
import pickle
import random
import warnings

import gymnasium as gym
import numpy as np
import pytest
import stable_baselines3 as sb3
import torch as th
from gymnasium import spaces
from point_mass import PointMass, expert_of_point_mass
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback, EvalCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.utils import set_random_seed
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecNormalize
from test_windows import Counter, CounterWithFeatures

import silem
from silem import SILEM, TPIL, GAIfO, SilemError
from silem.algorithms.gaifo import SurvivalWarning
from silem.algorithms.networks import RunningNormalizer
from silem.study.settings import HyperParameters

DEMOS = expert_of_point_mass()
SMALL = dict(n_steps=60, batch_size=60, seed=0)


def point_mass(method: type = GAIfO, n_envs: int = 2, **kwargs) -> GAIfO:
    settings = SMALL | dict(disc_hidden=(16,)) | kwargs
    return method("MlpPolicy", make_vec_env(PointMass, n_envs, seed=0), DEMOS, **settings)


class Compared(BaseCallback):
    """Holds the values and log-probabilities of a rollout against the torch policy's own."""

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        buffer, policy = self.model.rollout_buffer, self.model.policy
        shape = (-1, *self.model.observation_space.shape)
        obs = th.as_tensor(buffer.observations.reshape(shape)).to(th.float32)
        actions = th.as_tensor(buffer.actions.reshape(len(obs), -1))
        if not isinstance(self.model.action_space, spaces.Box):
            actions = actions[:, 0]
        with th.no_grad():
            values, log_probs, _ = policy.evaluate_actions(obs, actions)
        near = dict(rtol=1e-3, atol=1e-4)
        np.testing.assert_allclose(buffer.values.ravel(), values.ravel().numpy(), **near)
        np.testing.assert_allclose(buffer.log_probs.ravel(), log_probs.numpy(), **near)
        self.compared = True


def compare(model: silem.PPO, n_iterations: int = 1) -> None:
    callback = Compared()
    n = n_iterations * model.n_steps * model.n_envs
    model.learn(n, callback=callback, reset_num_timesteps=False)
    assert callback.compared


def trained() -> silem.PPO:
    """A model whose observation moments are far from a new one's."""
    return silem.PPO("MlpPolicy", make_vec_env("Pendulum-v1", 2, seed=1), **SMALL).learn(480)


def new() -> silem.PPO:
    return silem.PPO("MlpPolicy", make_vec_env("Pendulum-v1", 2, seed=1), **SMALL)


def by_load(source: silem.PPO, path) -> silem.PPO:
    source.save(path)
    return silem.PPO.load(path, env=make_vec_env("Pendulum-v1", 2, seed=1))


def by_set_parameters(source: silem.PPO, path) -> silem.PPO:
    model = new()
    model.set_parameters(source.get_parameters())
    return model


def by_set_parameters_in_the_middle(source: silem.PPO, path) -> silem.PPO:
    model = new().learn(240)
    model.set_parameters(source.get_parameters())
    return model


def by_state_arrays(source: silem.PPO, path) -> silem.PPO:
    model = new()
    model.load_state_arrays(source.state_arrays())
    return model


def by_another_policy(source: silem.PPO, path) -> silem.PPO:
    source.export_policy(path.with_suffix(".safetensors"))
    model = new()
    model.policy = silem.load_policy(path.with_suffix(".safetensors"))
    return model


def by_replaced_tensors(source: silem.PPO, path) -> silem.PPO:
    model = new().learn(120)
    for p, other in zip(model.policy.parameters(), source.policy.parameters(), strict=True):
        p.data = other.detach().clone()
    model.policy.features_extractor.load_state_dict(source.policy.features_extractor.state_dict())
    return model


WAYS_IN = [
    by_load, by_set_parameters, by_set_parameters_in_the_middle, by_state_arrays,
    by_another_policy, by_replaced_tensors,
]  # fmt: skip


@pytest.mark.parametrize("way_in", WAYS_IN)
def test_twin_and_torch_agree_whichever_way_parameters_come_in(way_in, tmp_path) -> None:
    source = trained()
    model = way_in(source, tmp_path / "model.zip")
    obs = model.get_env().reset()
    expected = source.predict(obs, deterministic=True)[0]
    # torch's kernels may round otherwise on memory that is aligned otherwise
    np.testing.assert_allclose(model.predict(obs, deterministic=True)[0], expected, rtol=1e-5)
    assert model._fast is not None
    compare(model)  # the first rollout after it
    compare(model, 2)  # and those after updates, which have to reach torch
    assert not np.array_equal(model.predict(obs, deterministic=True)[0], expected)


class Replaces(BaseCallback):
    """Puts other tensors into the policy's parameters between rollout and update."""

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        for p in self.model.policy.parameters():
            p.data = p.detach().clone()
        self.before = [p.detach().clone() for p in self.model.policy.parameters()]


def test_update_reaches_tensors_that_a_callback_has_put_in_place() -> None:
    model, callback = new(), Replaces()
    model.learn(240, callback=callback)
    after = zip(callback.before, model.policy.parameters(), strict=True)
    assert all(not th.equal(old, p) for old, p in after)


def test_torchs_optimizer_goes_on_in_the_twins_memory() -> None:
    model = new().learn(120)
    twin, before = model._fast, [p.detach().clone() for p in model.policy.parameters()]
    assert twin is not None
    model.clip_range_vf = lambda _: 0.2  # which stable-baselines3's own update alone can do
    model.learn(120, reset_num_timesteps=False)
    assert model._fast is None
    after = list(model.policy.parameters())
    assert all(not th.equal(a, b) for a, b in zip(before, after, strict=True))
    flat = np.concatenate([p.detach().numpy().ravel() for p in after])
    np.testing.assert_array_equal(twin.params, flat)
    assert twin._steps.tolist() == [40.0] * len(after)  # 2 rollouts, 10 epochs of 2 minibatches


def test_frozen_parameters_stay_and_hooks_are_heard() -> None:
    """As in stable-baselines3, whose own path runs."""
    frozen, hooked, squashed = new(), new(), new()
    for p in frozen.policy.mlp_extractor.value_net.parameters():
        p.requires_grad = False
    before = [p.detach().clone() for p in frozen.policy.parameters()]
    frozen.learn(240)
    kept = [th.equal(*pair) for pair in zip(before, frozen.policy.parameters(), strict=True)]
    assert kept == [not p.requires_grad for p in frozen.policy.parameters()]
    hooked.policy.value_net.register_forward_hook(lambda module, inputs, output: output + 3.0)
    head = squashed.policy.action_net
    squashed.policy.action_net = th.nn.Sequential(head, th.nn.Tanh())
    for model in (hooked, squashed):
        compare(model)
        assert model._fast is None


class Noise(gym.Env):
    """Observes samples of a space, whatever is done."""

    def __init__(self, observation_space: spaces.Space, action_space: spaces.Space) -> None:
        self.observation_space, self.action_space = observation_space, action_space

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        super().reset(seed=seed)
        self.steps = 0
        return self.observation_space.sample(), {}

    def step(self, action: np.ndarray) -> tuple:
        assert self.action_space.contains(np.asarray(action, self.action_space.dtype))
        self.steps += 1
        return self.observation_space.sample(), 1.0, False, self.steps == 10, {}


BOX, PAIR = spaces.Box(-1, 1, (3,)), spaces.Box(-0.5, 0.5, (2,))
IMAGE = spaces.Box(0, 255, (1, 36, 36), np.uint8)


@pytest.mark.parametrize(
    ("observation_space", "action_space", "settings", "twin"),
    [
        (BOX, PAIR, {}, True),
        (spaces.Box(-1, 1, (3,), np.float64), PAIR, {}, True),
        (spaces.Box(0, 255, (5,), np.uint8), PAIR, {}, True),
        (spaces.Box(-5, 5, (2, 3)), PAIR, {}, True),
        (BOX, spaces.Box(-1, 1, (2, 2)), {}, True),
        (IMAGE, PAIR, {}, False),
        (IMAGE, PAIR, {"policy_kwargs": {"normalize_images": False}}, True),
        (spaces.Discrete(4), PAIR, {}, False),
        (spaces.MultiDiscrete([3, 4]), PAIR, {}, False),
        (spaces.MultiBinary(4), PAIR, {}, False),
        (BOX, spaces.Discrete(3), {}, False),
        (BOX, PAIR, {"policy_kwargs": {"activation_fn": th.nn.ReLU}}, False),
        (BOX, PAIR, {"policy_kwargs": {"share_features_extractor": False}}, False),
        (BOX, PAIR, {"policy_kwargs": {"optimizer_class": th.optim.AdamW}}, False),
        (BOX, PAIR, {"clip_range_vf": 0.2}, False),
    ],
)
def test_twin_takes_only_what_it_reproduces(
    observation_space: spaces.Space, action_space: spaces.Space, settings: dict, twin: bool
) -> None:
    observation_space.seed(0)
    env = DummyVecEnv([lambda: Noise(observation_space, action_space)] * 2)
    settings = dict(n_steps=16, batch_size=16, seed=0, normalize_observations=False) | settings
    model = silem.PPO("MlpPolicy", env, **settings)
    assert (model._fast is not None) == twin
    compare(model, 2)


def test_the_policys_class_is_the_same_as_its_name() -> None:
    made = silem.PPO(sb3.ppo.MlpPolicy, make_vec_env("Pendulum-v1", 2, seed=1), **SMALL)
    for name, array in made.learn(120).state_arrays().items():
        np.testing.assert_array_equal(array, new().learn(120).state_arrays()[name])


class Counts(RolloutBuffer):
    added = got = 0

    def add(self, *args, **kwargs) -> None:
        self.added += 1
        super().add(*args, **kwargs)

    def get(self, *args, **kwargs):
        self.got += 1
        return super().get(*args, **kwargs)


def test_a_buffer_of_ones_own_is_used() -> None:
    env = make_vec_env("Pendulum-v1", 2, seed=1)
    model = silem.PPO("MlpPolicy", env, rollout_buffer_class=Counts, **SMALL)
    compare(model)
    assert (model.rollout_buffer.added, model.rollout_buffer.got) == (60, model.n_epochs)


def drawn(seed: int | None = None, reseeded: int | None = None) -> list[np.ndarray]:
    """The first iteration's actions, and what D's batches would be drawn by."""
    model = point_mass(seed=seed)
    if reseeded is not None:
        model.set_random_seed(reseeded)
    expert = th.randint(10**9, (3,), generator=model._torch_rng)
    model.learn(120)
    return [model.rollout_buffer.actions, expert.numpy()]


def test_seeds_reach_every_stream() -> None:
    """Also those given later, and torch's where none is, as in stable-baselines3."""
    set_random_seed(5)
    first, second = drawn(), drawn()
    set_random_seed(5)
    again = drawn()
    for a, b, c in zip(first, again, second, strict=True):
        np.testing.assert_array_equal(a, b)
        assert not np.array_equal(a, c)
    for a, b, c in zip(*(drawn(0, s) for s in (3, 3, 4)), strict=True):
        np.testing.assert_array_equal(a, b)
        assert not np.array_equal(a, c)


def windows_are_whole(windows: np.ndarray) -> bool:
    """Tell whether windows of `Counter` are successive states of one episode each."""
    for window in windows.reshape(-1, *windows.shape[-2:]):
        steps = np.diff(window[:, 1])
        first = window[:, 1] == 0  # an episode's first state may be repeated
        if (window[:, 0] != window[0, 0]).any() or not (
            (steps == 1) | ((steps == 0) & first[1:])
        ).all():
            return False
    return True


class StopAt(BaseCallback):
    def __init__(self, calls: int) -> None:
        super().__init__()
        self.left = calls

    def _on_step(self) -> bool:
        self.left -= 1
        return self.left > 0


FIVE = dict(n_steps=5, batch_size=5, n_disc_updates=5, seed=0)


def counters(n_envs: int = 2, made: type = Counter, **settings) -> GAIfO:
    demos = [np.zeros((5, 2), dtype=np.float32)]
    return GAIfO("MlpPolicy", DummyVecEnv([made] * n_envs), demos, **FIVE | settings)


@pytest.mark.parametrize("stop_after", range(1, 10))
def test_windows_stay_whole_after_a_callback_stopped_a_rollout(stop_after: int) -> None:
    model = counters()
    model.learn(20, callback=StopAt(stop_after))
    for _ in range(2):
        model.learn(10, reset_num_timesteps=False)
        assert windows_are_whole(model._windows)
        observed = model.rollout_buffer.observations  # each from the state before it
        begins = model.rollout_buffer.episode_starts != 0
        follows = (observed[1:] == observed[:-1] + np.array([0, 1])).all(axis=-1)
        assert (follows | begins[1:]).all()


class Breaks(Counter):
    """Raises at its seventh step, once."""

    total = 0

    def step(self, action: np.ndarray) -> tuple:
        self.total += 1
        if self.total == 7:
            raise KeyboardInterrupt
        return super().step(action)


def test_windows_stay_whole_after_an_interrupt() -> None:
    model = counters(1, Breaks)
    with pytest.raises(KeyboardInterrupt):
        model.learn(40)
    model.learn(20, reset_num_timesteps=False)
    assert windows_are_whole(model._windows)


@pytest.mark.parametrize(
    ("n_steps", "made"), [(3, DummyVecEnv), (4, DummyVecEnv), (4, SubprocVecEnv)]
)
def test_windows_stay_whole_after_somebody_else_used_the_environments(
    n_steps: int, made: type
) -> None:
    model = counters(n_steps=n_steps, batch_size=2 * n_steps)  # episodes have 3
    model.set_env(made([Counter] * 2))
    env = model.get_env()
    model.learn(2 * n_steps)
    for use in (env.reset, lambda: evaluate_policy(model, env, n_eval_episodes=2, warn=False)):
        use()
        model.learn(2 * n_steps, reset_num_timesteps=False)
        assert windows_are_whole(model._windows)
    before = model._windows[-1, :, -1]
    model.learn(2 * n_steps, reset_num_timesteps=False)  # and goes on where nobody did
    assert (model._windows[0, :, -1, 0] - before[:, 0] == (before[:, 1] == 3)).all()
    callback = EvalCallback(env, n_eval_episodes=1, eval_freq=2, warn=False, verbose=0)
    with pytest.raises(SilemError, match="needs environments of its own"):
        model.learn(2 * n_steps, callback=callback)
    model.learn(2 * n_steps, reset_num_timesteps=False)
    assert windows_are_whole(model._windows)
    env.close()


def test_broken_windows_would_be_noticed() -> None:
    """Negative control of `windows_are_whole`."""
    whole = np.array([[[1, 0], [1, 0], [1, 1]], [[1, 0], [1, 1], [1, 2]]])
    assert windows_are_whole(whole)
    assert not windows_are_whole(np.array([[[1, 2], [2, 0], [2, 1]]]))  # across an end
    assert not windows_are_whole(np.array([[[1, 0], [1, 1], [1, 3]]]))  # a hole
    assert not windows_are_whole(np.array([[[1, 1], [1, 1], [1, 2]]]))  # a state twice


def test_normalised_observations_are_refused_as_features() -> None:
    env = VecNormalize(make_vec_env(PointMass, 2, seed=0))
    with pytest.raises(SilemError, match=r"norm_obs=False.*skeletal_features"):
        GAIfO("MlpPolicy", env, DEMOS, **SMALL).learn(120)
    model = GAIfO("MlpPolicy", make_vec_env(PointMass, 2, seed=0), DEMOS, **SMALL).learn(120)
    model.set_env(env)
    with pytest.raises(SilemError, match="VecNormalize"):
        model.learn(120)
    for made in (DummyVecEnv, SubprocVecEnv):
        wrapped = made([lambda: gym.wrappers.NormalizeObservation(PointMass())])
        with pytest.raises(SilemError, match=r"^NormalizeObservation changes the observations"):
            GAIfO("MlpPolicy", wrapped, DEMOS, **SMALL).learn(120)
        wrapped.close()


def test_normalised_rewards_or_own_features_are_no_trouble() -> None:
    plain = GAIfO("MlpPolicy", make_vec_env(PointMass, 2, seed=0), DEMOS, **SMALL).learn(240)
    env = VecNormalize(make_vec_env(PointMass, 2, seed=0), norm_obs=False)
    wrapped = GAIfO("MlpPolicy", env, DEMOS, **SMALL).learn(240)
    for name, array in plain.state_arrays().items():  # the environment's reward is not learned from
        np.testing.assert_array_equal(wrapped.state_arrays()[name], array)
    own = VecNormalize(DummyVecEnv([CounterWithFeatures]))
    model = GAIfO("MlpPolicy", own, [np.zeros((5, 3))], **FIVE).learn(5)
    np.testing.assert_array_equal(model._windows[0, 0, :, 1], [0, 0, 0, -1])  # raw


class Dictionary(CounterWithFeatures):
    observation_space = spaces.Dict({"place": spaces.Box(-1e6, 1e6, (2,))})

    def _observation(self) -> dict:
        return {"place": super()._observation()}

    def _info(self) -> dict:
        return {"skeletal_features": np.append(-self._observation()["place"], 7.0)}


class DictionaryAlone(Dictionary):
    def _info(self) -> dict:
        return {}


@pytest.mark.parametrize("method", [GAIfO, SILEM])
def test_dictionaries_of_observations_learn_from_features_in_infos(method: type) -> None:
    demos = [np.zeros((5, 3), dtype=np.float32)]
    env = DummyVecEnv([Dictionary] * 2)
    model = method("MultiInputPolicy", env, demos, **FIVE).learn(20)
    np.testing.assert_array_equal(model._windows[0, 0, -1, 2], 7.0)
    assert windows_are_whole(-model._windows[..., :2])
    with pytest.raises(SilemError, match=r"dictionary.*skeletal_features"):
        env = DummyVecEnv([DictionaryAlone] * 2)
        method("MultiInputPolicy", env, demos, **FIVE).learn(20)


def test_dictionaries_of_observations_are_evaluated() -> None:
    env_id = "tests/Dictionary-v0"
    if env_id not in gym.registry:
        gym.register(env_id, Dictionary, max_episode_steps=5)
    demos = [np.zeros((5, 3), dtype=np.float32)]
    model = SILEM("MultiInputPolicy", DummyVecEnv([Dictionary] * 2), demos, **FIVE).learn(20)
    found = silem.evaluate(model, env_id, 2, model=model)
    assert found.n_episodes == 2 and np.isfinite(found.disc_reward_mean)


def test_an_evaluation_leaves_every_stream_where_it_was() -> None:
    model = silem.PPO("MlpPolicy", "Pendulum-v1", n_steps=64, batch_size=64, seed=0).learn(64)

    def drawn(evaluated: bool) -> list[float]:
        model.reseed(3)
        random.seed(4)
        if evaluated:
            silem.evaluate(model, "Pendulum-v1", 1)
        draws = model._rng.random(), th.rand(1).item(), np.random.rand(), random.random()  # noqa: NPY002
        return [float(draw) for draw in draws]

    assert drawn(True) == drawn(False)
    first, second = (silem.evaluate(model, "Pendulum-v1", 1).returns for _ in range(2))
    assert first == second


class Poisoned(gym.Wrapper):
    """Its fifth reward is none."""

    reward, steps = float("nan"), 0

    def step(self, action: np.ndarray) -> tuple:
        self.steps += 1
        observation, reward, *rest = self.env.step(action)
        return observation, self.reward if self.steps == 5 else reward, *rest


@pytest.mark.parametrize("reward", [float("nan"), float("inf")])
def test_rewards_that_are_none_stop_the_training(reward: float) -> None:
    env = Poisoned(gym.make("Pendulum-v1"))
    env.reward = reward
    with pytest.raises(SilemError, match="rewards or values hold NaN or infinity"):
        silem.PPO("MlpPolicy", env, n_steps=64, batch_size=64, seed=0).learn(128)


def test_what_diverges_stops_the_training() -> None:
    model = point_mass()
    with th.no_grad():
        next(model.discriminator.parameters()).fill_(float("nan"))
    with pytest.raises(SilemError, match="hold NaN or infinity"):
        model.learn(120)
    model = point_mass(silem.SILEM, learning_rate=1e30)
    with np.errstate(all="ignore"), pytest.raises(SilemError, match="hold NaN or infinity"):
        model.learn(600)


class ResetsAtStarts(BaseCallback):
    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        self.training_env.reset()


def test_windows_stay_whole_after_a_callback_has_reset_the_environments() -> None:
    model = counters()
    for _ in range(3):
        model.learn(10, callback=ResetsAtStarts(), reset_num_timesteps=False)
        assert windows_are_whole(model._windows)
        assert model.rollout_buffer.episode_starts[0].all()


def test_steps_that_count_a_decay_stay_as_many(tmp_path) -> None:
    for decay in (1.0, 0.9):
        point_mass(SILEM, transform_lr_decay=decay).learn(120).save(tmp_path / "model.zip")
        if decay == 1.0:
            assert (
                SILEM.load(tmp_path / "model.zip", n_transform_updates=1).n_transform_updates == 1
            )
            continue
        with pytest.raises(SilemError, match="n_transform_updates cannot change"):
            SILEM.load(tmp_path / "model.zip", n_transform_updates=1)


class FromResetAlone(CounterWithFeatures):
    def step(self, action: np.ndarray) -> tuple:
        return *super().step(action)[:4], {}


class FromStepAlone(CounterWithFeatures):
    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        return super().reset(seed=seed)[0], {}


class FromTheFirstResetAlone(CounterWithFeatures):
    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        obs, info = super().reset(seed=seed)
        return obs, info if self.episode == 1 else {}


class OfNoVector(CounterWithFeatures):
    def _info(self) -> dict:
        return {"skeletal_features": "left foot"}


class OfNoNumbers(CounterWithFeatures):
    def _info(self) -> dict:
        return {"skeletal_features": 1j * super()._info()["skeletal_features"]}


class OfNoFloats(CounterWithFeatures):
    def _info(self) -> dict:
        return {"skeletal_features": [10**400, 0, 0]}


@pytest.mark.parametrize(
    ("envs", "message"),
    [
        ([FromResetAlone], "environment 0 lacks .* at step"),
        ([FromStepAlone], "environment 0 supplies .* at step"),
        ([CounterWithFeatures, Counter], "environment 1 lacks .* at reset"),
        ([Counter, CounterWithFeatures], "environment 0 lacks .* at reset"),
        ([FromTheFirstResetAlone], "environment 0 lacks .* at reset"),
        ([OfNoVector], "no vectors of numbers but <U9"),
        ([OfNoNumbers], "no vectors of numbers but complex128"),
        ([OfNoFloats], "no vectors of numbers but object"),
    ],
)
@pytest.mark.parametrize("width", [2, 3])
def test_features_given_by_some_only_are_refused(envs: list, message: str, width: int) -> None:
    demos = [np.zeros((5, width), dtype=np.float32)]
    model = GAIfO("MlpPolicy", DummyVecEnv(envs), demos, **FIVE)
    wrong_width = "features per state" if "no vectors" not in message else message
    with pytest.raises(SilemError, match=f"{message}|{wrong_width}"):
        model.learn(20)


def test_subprocesses_give_the_same_windows() -> None:
    demos = [np.zeros((5, 3), dtype=np.float32)]
    found = []
    for vec_env in (DummyVecEnv, SubprocVecEnv):
        env = vec_env([CounterWithFeatures] * 2)
        model = GAIfO("MlpPolicy", env, demos, **FIVE).learn(20)
        found.append(model._windows)
        env.close()
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("method", [GAIfO, SILEM, TPIL])
def test_load_takes_what_the_constructor_takes(method: type, tmp_path) -> None:
    point_mass(method).learn(120).save(tmp_path / "model.zip")
    other = [1.0 + DEMOS[0], DEMOS[0][:20]]
    env = make_vec_env(PointMass, 3, seed=0)
    model = method.load(
        tmp_path / "model.zip", env=env, demonstrations=other, disc_learning_rate=5e-3,
        n_disc_updates=3, learning_rate=1e-3, seed=4,
    )  # fmt: skip
    assert len(model._expert_windows) == 50 + 19
    np.testing.assert_array_equal(model._expert_windows[:50, -1], other[0][1:])
    model.learn(180)
    assert model.disc_optimizer.param_groups[0]["lr"] == 5e-3
    assert model.policy.optimizer.param_groups[0]["lr"] == 1e-3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(demonstrations=[np.zeros((5, 7))]), "networks"),
        (dict(demonstrations=DEMOS[0]), r"one array.*\[array\]"),
        (dict(gradient_penalty=-1.0), "gradient_penalty must be a finite number from 0, not -1"),
        (dict(disc_hidden=(16, 16)), "networks"),
        (dict(transform="mlp"), "networks"),
        (dict(demos=DEMOS), "argument of SILEM.load 'demos'.*demonstrations"),
        (dict(normalize_observations=False), "argument of SILEM.load"),
        (dict(policy_kwargs={}), "cannot load .*policy kwargs"),
        (dict(seed=-1), "seed must be a whole number"),
    ],
)
def test_load_refuses_what_does_not_fit(arguments: dict, message: str, tmp_path) -> None:
    point_mass(SILEM).save(tmp_path / "model.zip")
    with pytest.raises(SilemError, match=message):
        SILEM.load(tmp_path / "model.zip", **arguments)


def test_defaults_are_those_of_runs_but_for_the_decay_which_is_a_budgets() -> None:
    runs = {field.name: field.default for field in dataclasses.fields(HyperParameters)}
    given = [inspect.signature(made.__init__).parameters for made in (GAIfO, SILEM, TPIL)]
    own = {name: p.default for parameters in given for name, p in parameters.items()}
    assert {n for n in own.keys() & runs.keys() if own[n] != runs[n]} == {"transform_lr_decay"}


@pytest.mark.parametrize(("saved", "read"), [(SILEM, GAIfO), (GAIfO, SILEM), (TPIL, silem.PPO)])
def test_load_says_that_another_class_saved_a_file(saved: type, read: type, tmp_path) -> None:
    point_mass(saved).save(tmp_path / "model.zip")
    with pytest.raises(SilemError, match=f"another class than {read.__name__} saved it"):
        read.load(tmp_path / "model.zip")


WRONG_NUMBERS = [
    ("n_disc_updates", 0), ("n_transform_updates", 0), ("n_transform_updates", 2.0),
    ("window", 0), ("window", 2.5), ("window", True), ("window", "4"), ("window", None),
    ("disc_learning_rate", -1e-3), ("disc_learning_rate", np.nan),
    ("transform_learning_rate", -1e-4), ("target_kl", len), ("transform_lr_decay", 1.1),
    ("transform_lr_decay", -0.5), ("gradient_penalty", -1.0), ("gradient_penalty", np.inf),
    ("disc_entropy_coef", -1e-3), ("transform_l2_scale", -1.0), ("transform_l2_bias", np.nan),
    ("n_steps", 0), ("n_epochs", 0), ("batch_size", -1), ("gamma", -0.1), ("gamma", 1.5),
    ("gae_lambda", -0.1), ("learning_rate", -1.0), ("ent_coef", -0.1), ("max_grad_norm", 0.0),
    ("learning_rate", np.inf), ("transform_learning_rate", np.inf), ("clip_range", -0.2),
    ("clip_range", np.nan), ("clip_range_vf", -1.0), ("target_kl", -1.0), ("seed", -1),
    ("seed", 1.0), ("seed", True), ("seed", 2**32), ("stats_window_size", 0),
]  # fmt: skip


@pytest.mark.parametrize(("name", "value"), WRONG_NUMBERS)
def test_numbers_that_are_out_of_range_are_refused(name: str, value: object) -> None:
    with pytest.raises(SilemError, match=f"^{name} must be a .*, not {value!r}"):
        point_mass(SILEM, **{name: value})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (dict(disc_hidden=128), "list of layer sizes"),
        (dict(disc_hidden=(128, 0)), "each size in disc_hidden"),
        (dict(reward="log d"), "d, airl, gail"),
        (dict(absorbing_states=[True, False]), "one for each of 1"),
        (dict(absorbing_states=1), "must be a bool"),
        (dict(absorbing_states=["no"]), "must be a bool"),
        (dict(absorbing_states="x"), "must be a bool"),
        (dict(n_disc_updates=121), "n_disc_updates is 121; a rollout has 120 windows"),
        (dict(n_transform_updates=121), "n_transform_updates is 121"),
        (dict(absorbing_states=True, gamma=1.0), "gamma below 1"),
        (dict(gradient_penality=0.1), "argument of SILEM 'gradient_penality'; .*gradient_penalty,"),
    ],
)
def test_other_settings_that_make_no_sense_are_refused(settings: dict, message: str) -> None:
    with pytest.raises(SilemError, match=message):
        point_mass(SILEM, **settings)


@pytest.mark.parametrize(
    ("body", "override"),
    [
        ("HC2", dict(clip_actions=False)),
        ("HC2", dict(n_trajectories=3)),
        ("HC2", dict(study="a")),
        ("Humanoid", dict(starts="demonstration")),
        ("Atlas", dict(ankle_range_rad=0.3)),
    ],
)
def test_settings_refuse_what_no_argument_takes(body: str, override: dict) -> None:
    assert silem.settings(body, gamma=0.5)["gamma"] == 0.5
    with pytest.raises(SilemError, match=f"{next(iter(override))}: no argument of the class"):
        silem.settings(body, **override)


def test_windows_of_double_precision_are_judged() -> None:
    shown = [np.zeros((60, 2))]
    model = GAIfO("MlpPolicy", make_vec_env(PointMass, 1), silem.Demonstrations(shown), **SMALL)
    windows = model.learn(60)._windows[:, 0]
    scores = (model.score_windows(windows.astype(kind)) for kind in (np.float32, np.float64))
    np.testing.assert_array_equal(*scores)


def test_moments_take_batches_to_where_they_are() -> None:
    moments = RunningNormalizer(BOX).to("meta")
    moments.update(np.zeros((5, 3)))
    assert moments.mean.device.type == "meta"


class Looks(BaseCallback):
    def _on_step(self) -> bool:
        self.seen = self.model._last_obs
        return True


def test_callbacks_see_the_last_observation() -> None:
    callback = Looks()
    model = new().learn(120, callback=callback)
    np.testing.assert_array_equal(callback.seen, model.rollout_buffer.observations[-1])


@pytest.mark.parametrize("demonstrations", [DEMOS[0], "HC0", 3, [["a"]], [np.zeros(3)], {1: 2}])
def test_what_are_no_demonstrations_are_refused(demonstrations) -> None:
    with pytest.raises(SilemError, match=r"T \+ 1, F"):
        GAIfO("MlpPolicy", make_vec_env(PointMass, 1), demonstrations)


def test_numbers_of_numpy_and_schedules_are_taken() -> None:
    model = point_mass(
        SILEM, window=np.int64(3), gradient_penalty=np.float32(0.5), max_grad_norm=float("inf"),
        learning_rate=lambda left: 1e-3 * left,
    )  # fmt: skip
    model.learn(240)
    assert model._windows.shape[2] == 3


def test_zero_rates_freeze_and_zero_factors_are_taken() -> None:
    rates = dict(disc_learning_rate=0, transform_learning_rate=0, transform_lr_decay=0)
    model = point_mass(SILEM, gamma=0, gae_lambda=0.0, **rates)
    before = model.state_arrays()
    for name, array in model.learn(120).state_arrays().items():
        still = ".adam" in name or name.startswith("policy")
        assert still or np.array_equal(array, before[name])


class Corridor(gym.Env):
    """A walk from 0 to a goal at 1, which ends the episode; else a time limit does, of 40."""

    observation_space = spaces.Box(-np.inf, np.inf, (1,))
    action_space = spaces.Box(-1, 1, (1,))

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        super().reset(seed=seed)
        self.place, self.steps = np.zeros(1, dtype=np.float32), 0
        return self.place.copy(), {}

    def step(self, action: np.ndarray) -> tuple:
        self.steps += 1
        self.place = self.place + np.float32(0.2) * action.astype(np.float32)
        there = bool(self.place[0] >= 0.95)
        return self.place.copy(), 0.0, there, self.steps == 40 and not there, {}


STRAIGHT = [np.linspace(0, 1, 6, dtype=np.float32)[:, None]] * 4  # the goal in five steps


def episode_length_in_corridor(**settings) -> float:
    model = GAIfO(
        "MlpPolicy", make_vec_env(Corridor, 4, seed=0), STRAIGHT, n_steps=100, batch_size=100,
        learning_rate=3e-3, seed=0, gamma=0.95, disc_hidden=(32, 32), window=2, **settings,
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SurvivalWarning)
        model.learn(16_000)
    return model.iteration_stats["episode_length"]


def test_absorbing_states_let_a_learner_reach_the_goal_that_d_has_it_avoid() -> None:
    assert episode_length_in_corridor() > 25.0  # the paper's reward pays for not arriving
    assert episode_length_in_corridor(absorbing_states=True) < 12.0


def test_absorbing_windows_by_hand() -> None:
    last = np.array([[1.0], [2.0], [3.0]])
    expected = [
        [[2, 0], [3, 0], [0, 1]],
        [[3, 0], [0, 1], [0, 1]],
        [[0, 1], [0, 1], [0, 1]],
    ]
    np.testing.assert_array_equal(silem.algorithms.gaifo.absorbing_windows(last), expected)


@pytest.mark.parametrize("method", [GAIfO, SILEM, TPIL])
@pytest.mark.parametrize("reward", ["d", "airl", "gail"])
def test_an_end_is_worth_the_absorbing_states_rewards(method: type, reward: str) -> None:
    """Summed by hand over 2,000 steps in the absorbing state; time limits keep their value."""
    model = method(
        "MlpPolicy", make_vec_env(Corridor, 4, seed=0), STRAIGHT, n_steps=100, batch_size=100,
        seed=0, gamma=0.9, window=3, disc_hidden=(16,), absorbing_states=True, reward=reward,
    )  # fmt: skip
    assert len(model._expert_windows) == 4 * (5 + 3)
    with warnings.catch_warnings():
        warnings.simplefilter("error", SurvivalWarning)  # nothing to warn of
        model.learn(400)
    assert len(model._ends) > 0
    logit = {"d": lambda x: 1 / (1 + np.exp(-x)), "airl": lambda x: x}
    logit["gail"] = lambda x: -np.log(1 - logit["d"](x))
    for step, environment in model._ends:
        place = model._windows[step, environment]  # SILEM's T has hardly moved on since
        states = [[x, 0.0] for x in place[:, 0]] + [[0.0, 1.0]] * 2_000
        windows = np.stack([states[k : k + 3] for k in range(1, 1_999)]).astype(np.float32)
        with th.no_grad():
            judged = logit[reward](model.discriminator(th.from_numpy(windows)).numpy())
        expected = (0.9 ** np.arange(1, len(judged) + 1)) @ judged
        assert model._bootstrap[step, environment] == pytest.approx(expected, rel=1e-2)


def test_transform_leaves_the_absorbing_state_alone() -> None:
    model = point_mass(SILEM, absorbing_states=True)
    with th.no_grad():
        model.transform_net.scale.fill_(2.0)
        model.transform_net.offset.fill_(1.0)
    windows = th.tensor([[[3.0, 4.0, 0.0], [0.0, 0.0, 1.0]]])
    expected = th.tensor([[[7.0, 9.0, 0.0], [0.0, 0.0, 1.0]]])
    assert th.equal(model._transformed(windows), expected)
    assert model.score_windows(np.zeros((5, 4, 2), np.float32)).shape == (5,)


def test_only_demonstrations_that_end_get_absorbing_states() -> None:
    demos = [*STRAIGHT[:2], np.zeros((9, 1))]
    env = make_vec_env(Corridor, 1, seed=0)
    for marks in (
        [True, False, False],
        np.array([True, False, False]),
        [np.bool_(1), False, False],
    ):
        model = GAIfO("MlpPolicy", env, demos, window=2, absorbing_states=marks)
        assert len(model._expert_windows) == 5 + 5 + 8 + 2
        assert (model._expert_windows[..., -1] == 1).any(dim=1).sum() == 2
    assert not GAIfO("MlpPolicy", env, demos, absorbing_states=np.bool_(False))._absorbing


def test_endings_are_warned_of_once_and_time_limits_not() -> None:
    env = make_vec_env(Corridor, 4, seed=0)
    model = GAIfO("MlpPolicy", env, STRAIGHT, n_steps=100, batch_size=100, seed=0)
    with pytest.warns(SurvivalWarning, match="absorbing_states=True") as caught:
        model.learn(1600)
    assert len([w for w in caught if w.category is SurvivalWarning]) == 1
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error", SurvivalWarning)
        point_mass().learn(360)


@pytest.mark.parametrize("reward", ["d", "airl", "gail"])
def test_rewards_by_their_formulas(reward: str) -> None:
    model = point_mass(reward=reward, disc_hidden=(16,)).learn(120)
    d = model.score_windows(model._windows.reshape(-1, 4, 2)).astype(float)
    formula = {"d": d, "airl": np.log(d) - np.log(1 - d), "gail": -np.log(1 - d)}[reward]
    rewards = (model.rollout_buffer.rewards - model._bootstrap).ravel()
    np.testing.assert_allclose(rewards, formula, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("env_id", "settings"),
    [
        ("Pendulum-v1", {}),  # its actions go to 2, not to 1
        ("Pendulum-v1", {"normalize_observations": False}),
        ("Pendulum-v1", {"policy_kwargs": {"net_arch": []}}),
        ("Pendulum-v1", {"policy_kwargs": {"net_arch": {"pi": [9] * 12, "vf": [7]}}}),
        ("CartPole-v1", {"policy_kwargs": {"activation_fn": th.nn.ReLU}}),
    ],
)
def test_exported_policies_act_alike_and_learn_on(env_id: str, settings: dict, tmp_path) -> None:
    env = make_vec_env(env_id, 2, seed=0)
    model = silem.PPO("MlpPolicy", env, **SMALL, **settings).learn(240)
    model.export_policy(tmp_path / "policy.safetensors")
    before = th.random.get_rng_state()
    policy = silem.load_policy(tmp_path / "policy.safetensors")
    assert th.equal(th.random.get_rng_state(), before)
    obs = env.reset()
    expected = model.predict(obs, deterministic=True)[0]
    # torch's kernels may round otherwise on memory that is aligned otherwise
    np.testing.assert_allclose(policy.predict(obs, deterministic=True)[0], expected, rtol=1e-5)
    assert policy.action_space == model.action_space
    plain = sb3.PPO("MlpPolicy", env, n_steps=60, batch_size=60, device="cpu")
    plain.policy = policy
    np.testing.assert_allclose(plain.predict(obs, deterministic=True)[0], expected, rtol=1e-5)
    plain.learn(120)
    changed = zip(policy.parameters(), model.policy.parameters(), strict=True)
    assert any(not th.equal(a, b) for a, b in changed)
    keeper = silem.PPO("MlpPolicy", env, **SMALL)
    keeper.policy = plain.policy
    keeper.export_policy(tmp_path / "policy.safetensors")
    kept = silem.load_policy(tmp_path / "policy.safetensors").predict(obs, deterministic=True)[0]
    np.testing.assert_allclose(kept, plain.predict(obs, deterministic=True)[0], rtol=1e-5)


@pytest.mark.parametrize(
    "space", [spaces.MultiDiscrete([3, 4]), spaces.MultiBinary(4), spaces.Box(-1.5, 3.0, (2,))]
)
def test_action_spaces_are_exported_too(space: spaces.Space, tmp_path) -> None:
    env = DummyVecEnv([lambda: Noise(BOX, space)])
    model = silem.PPO("MlpPolicy", env, n_steps=16, batch_size=16)
    model.export_policy(tmp_path / "policy.safetensors", run_id="a run")
    policy = silem.load_policy(tmp_path / "policy.safetensors")
    assert policy.action_space == space
    obs = env.reset()
    expected = model.predict(obs, deterministic=True)[0]
    np.testing.assert_allclose(policy.predict(obs, deterministic=True)[0], expected, rtol=1e-5)
    assert silem.util.files.read_tensors(tmp_path / "policy.safetensors")[1]["run_id"] == "a run"


def test_what_cannot_be_exported_is_refused(tmp_path) -> None:
    discrete, image = (
        DummyVecEnv([lambda space=space: Noise(space, PAIR)])
        for space in (spaces.Discrete(4), IMAGE)
    )
    env, size = make_vec_env(PointMass, 1), dict(n_steps=16, batch_size=16)
    apart = {"share_features_extractor": False}
    made = [
        silem.PPO("MlpPolicy", discrete, normalize_observations=False, **size),
        silem.PPO("CnnPolicy", image, **size),
        silem.PPO("MlpPolicy", env, use_sde=True, **size),
        silem.PPO("MlpPolicy", env, policy_kwargs=apart, **size),
    ]
    for model in made:
        with pytest.raises(SilemError, match="can be exported"):
            model.export_policy(tmp_path / "policy.safetensors")
    assert not list(tmp_path.iterdir())


class _Trap:
    def __reduce__(self) -> tuple:
        return (os.mkdir, ("sprung",))


def test_no_file_makes_load_policy_run_code(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    model = silem.PPO("MlpPolicy", make_vec_env(PointMass, 1), n_steps=16, batch_size=16)
    model.trap = _Trap()
    model.save(tmp_path / "model.zip")
    silem.PPO.load(tmp_path / "model.zip")
    (tmp_path / "sprung").rmdir()  # the trap does work
    (tmp_path / "pickle.safetensors").write_bytes(pickle.dumps(_Trap()))
    silem.util.files.write_tensors(tmp_path / "other.safetensors", {"a": np.zeros(3)})
    for path in sorted(tmp_path.iterdir()):
        with pytest.raises(SilemError):
            silem.load_policy(path)
    assert not (tmp_path / "sprung").exists()
