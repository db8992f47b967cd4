"""One iteration of Algorithm 1: its order, its minibatches, and PPO against stable-baselines3's."""

from __future__ import annotations

import copy

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from point_mass import PointMass, expert_of_point_mass
from stable_baselines3 import PPO as SB3PPO
from stable_baselines3.common.env_util import make_vec_env

import silem
from silem import SILEM, TPIL, GAIfO
from silem.algorithms.networks import discriminator_loss

METHODS = (GAIfO, SILEM, TPIL)


def make_model(method: type = SILEM, **kwargs) -> GAIfO:
    env = make_vec_env(PointMass, 2, seed=0)
    settings = dict(n_steps=60, batch_size=60, seed=0, disc_hidden=(32, 32)) | kwargs
    return method("MlpPolicy", env, expert_of_point_mass(), **settings)


def test_rewards_are_the_new_discriminators_of_what_the_old_transform_made() -> None:
    """Line 11: D after line 9, T from before line 10; the other three readings give other ones."""
    model = make_model(transform_learning_rate=0.1, disc_learning_rate=0.01).learn(120)
    old = copy.deepcopy((model.discriminator, model.transform_net))
    model.learn(120, reset_num_timesteps=False)
    new = model.discriminator, model.transform_net
    windows = th.from_numpy(model._windows.reshape(-1, 4, 2))
    rewards = (model.rollout_buffer.rewards - model._bootstrap).ravel()
    with th.no_grad():
        judged = {
            (d, t): th.sigmoid(discriminator(transform(windows))).numpy()
            for d, discriminator in (("old D", old[0]), ("new D", new[0]))
            for t, transform in (("old T", old[1]), ("new T", new[1]))
        }
    for which, expected in judged.items():
        assert np.allclose(rewards, expected, atol=1e-6) == (which == ("new D", "old T")), which


def test_transform_learns_from_the_copy_that_it_has_not_changed(monkeypatch) -> None:
    """Line 10 takes tau_c of line 7, line 9 what line 8 made of it."""
    model, seen = make_model(transform_learning_rate=0.1).learn(120), {}
    old = copy.deepcopy(model.transform_net)
    for name in ("update_discriminator", "update_transform"):
        method = getattr(model, name)
        monkeypatch.setattr(
            model, name, lambda o, name=name, method=method: (seen.update({name: o}), method(o))[1]
        )
    model.learn(120, reset_num_timesteps=False)
    tau_c = th.from_numpy(model._windows.reshape(-1, 4, 2))
    assert th.equal(seen["update_transform"], tau_c)
    with th.no_grad():
        assert th.equal(seen["update_discriminator"], old(tau_c))
    assert not th.allclose(seen["update_discriminator"], tau_c)


def test_gaifo_is_silem_whose_transform_never_moves(monkeypatch) -> None:
    """Bit for bit, so SILEM-minus and the identity in T's place are one thing."""
    gaifo, moving = make_model(GAIfO).learn(360), make_model(SILEM).learn(360)
    monkeypatch.setattr(SILEM, "update_transform", lambda self, tau_c: {})
    fixed = make_model(SILEM).learn(360)
    a, b, c = (model.state_arrays() for model in (gaifo, fixed, moving))
    assert a.keys() == {name for name in b if not name.startswith("transform")}
    assert all(np.array_equal(b[name], array) for name, array in a.items())
    assert any(not np.array_equal(c[name], array) for name, array in a.items())


@pytest.mark.parametrize("which", ["discriminator", "transform"])
def test_minibatches_are_one_shuffled_pass(which: str, monkeypatch) -> None:
    model = make_model(n_disc_updates=4, n_transform_updates=3, gradient_penalty=0.0)
    n = 120
    windows = th.arange(n, dtype=th.float32)[:, None, None].expand(n, 4, 2)
    seen: list[list[int]] = []
    network = model.discriminator if which == "discriminator" else model.transform_net
    forward = type(network).forward
    monkeypatch.setattr(
        type(network),
        "forward",
        lambda self, x: (seen.append(x[:, 0, 0].tolist()), forward(self, x))[1],
    )
    passes = []
    for _ in range(2):
        seen.clear()
        if which == "discriminator":
            model.update_discriminator(windows)
            batches = seen[1::2]  # the expert's stand before the learner's
        else:
            model.update_transform(windows)
            batches = list(seen)
        passes.append([row for batch in batches for row in batch])
        assert len({len(batch) for batch in batches}) == 1
    assert sorted(passes[0]) == sorted(passes[1]) == list(range(n))
    assert passes[0] != passes[1]
    # rows of a rollout are in time's order: neighbours in a minibatch must not be
    assert np.mean(np.abs(np.diff(passes[0])) > 1) > 0.9


def test_transforms_rate_decays_from_the_first_iteration_on(tmp_path) -> None:
    model = make_model(transform_learning_rate=0.01, transform_lr_decay=0.5)
    rates = []
    for iteration in range(3):
        model.learn(120, reset_num_timesteps=iteration == 0)
        rates.append(model.iteration_stats["transform_learning_rate"])
        assert model.transform_optimizer.param_groups[0]["lr"] == rates[-1]
    assert rates == [0.01, 0.005, 0.0025]
    model.save(tmp_path / "model.zip")  # T has its own count, whatever a rollout's size is then
    model = SILEM.load(tmp_path / "model.zip", make_vec_env(PointMass, 3, seed=0)).learn(180)
    assert model.iteration_stats["transform_learning_rate"] == 0.00125


def test_gradient_penalty_is_taken_between_the_windows() -> None:
    """D = |o|^2 / 2 has gradient o, so the penalty is the squared norm of the mixture itself."""

    class Quadratic(th.nn.Module):
        def forward(self, windows: th.Tensor) -> th.Tensor:
            return 0.5 * windows.square().sum(dim=(1, 2))

    expert, learner = th.full((5, 4, 2), 1.0), th.full((5, 4, 2), 3.0)
    plain, penalised = (
        discriminator_loss(
            Quadratic(), expert, learner, entropy_coef=0.0, gradient_penalty=weight,
            mixing=th.full((5,), 0.25),
        )[0].item()
        for weight in (0.0, 0.1)
    )  # fmt: skip
    mixture = 0.25 * 1.0 + 0.75 * 3.0
    assert penalised - plain == pytest.approx(0.1 * 8 * mixture**2, rel=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_an_episodes_discriminator_reward_is_its_own(method: type) -> None:
    """Episodes of 50 steps in rollouts of 60: they end in several, and one begins anew in each."""
    model = make_model(method)
    rewards, found = [], []
    for iteration in range(4):
        model.learn(120, reset_num_timesteps=iteration == 0)
        rewards.append(model.rollout_buffer.rewards - model._bootstrap)
        found.append(model.iteration_stats["disc_reward"])
    by_step = np.concatenate(rewards)  # (240, E)
    episodes = [by_step[start : start + 50].sum(axis=0) for start in range(0, 200, 50)]
    np.testing.assert_allclose(found, [e.mean() for e in episodes], rtol=1e-4)


class Bounded(gym.Env):
    """Ends by a fall or at its time limit, whichever comes first; both happen in a rollout."""

    observation_space = gym.spaces.Box(-10, 10, (3,))
    action_space = gym.spaces.Box(-1, 1, (2,))

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple:
        super().reset(seed=seed)
        self.steps, self.state = 0, self.np_random.normal(size=3).astype(np.float32)
        return self.state.copy(), {}

    def step(self, action: np.ndarray) -> tuple:
        self.steps += 1
        kick = 0.4 * np.append(action, action.sum()) + self.np_random.normal(size=3)
        self.state = (0.8 * self.state + 0.3 * kick).astype(np.float32)
        fell = bool(abs(self.state[0]) > 1.0)
        return self.state.copy(), float(self.state.sum()), fell, self.steps == 9, {}


@pytest.mark.parametrize("clip_range_vf", [None, 0.2])  # the second goes stable-baselines3's way
def test_moments_are_those_of_all_observations_so_far(clip_range_vf: float | None) -> None:
    model = make_model(GAIfO, clip_range_vf=clip_range_vf)
    extractor, seen = model.policy.features_extractor, []
    for iteration in range(3):
        model.learn(120, reset_num_timesteps=iteration == 0)
        seen.append(model.rollout_buffer.observations.reshape(-1, 2).copy())
        states = np.concatenate(seen)
        np.testing.assert_allclose(extractor.mean, states.mean(axis=0), rtol=1e-3, atol=1e-5)
        np.testing.assert_allclose(extractor.var, states.var(axis=0), rtol=1e-2, atol=1e-5)
    assert (model._fast is None) == (clip_range_vf is not None)


def flat(model: SB3PPO, name: str) -> np.ndarray:
    """One array of a rollout buffer, (N, ...); stable-baselines3 flattens some as it updates."""
    array, buffer = getattr(model.rollout_buffer, name), model.rollout_buffer
    is_flat = array.shape[:2] != (buffer.buffer_size, buffer.n_envs)
    return array if is_flat else buffer.swap_and_flatten(array)


def test_an_iteration_is_stable_baselines3s() -> None:
    """Rollouts and updates of both, from one noise and one order of minibatches."""
    settings = dict(
        n_steps=64, batch_size=32, n_epochs=3, gamma=0.9, gae_lambda=0.8, learning_rate=1e-2,
        ent_coef=0.01, seed=0, device="cpu",
    )  # fmt: skip
    ours = silem.PPO("MlpPolicy", make_vec_env(Bounded, 3, seed=1), **settings)
    theirs = SB3PPO(
        "MlpPolicy", make_vec_env(Bounded, 3, seed=1), policy_kwargs=ours.policy_kwargs, **settings
    )
    theirs.policy.load_state_dict(ours.policy.state_dict())
    noise = np.random.default_rng(5)
    ours._rng = np.random.default_rng(5)

    def forward(obs: th.Tensor) -> tuple[th.Tensor, th.Tensor, th.Tensor]:
        distribution = theirs.policy.get_distribution(obs)
        mean, std = distribution.distribution.mean, distribution.distribution.stddev
        drawn = noise.standard_normal(mean.shape, dtype=np.float32)
        actions = mean + std * th.from_numpy(drawn)
        return actions, theirs.policy.predict_values(obs), distribution.log_prob(actions)

    theirs.policy.forward = forward
    with pytest.MonkeyPatch.context() as patch:
        for _ in range(2):  # the second has moments, Adam's and the observations'
            ours.learn(192, reset_num_timesteps=False, log_interval=None)
            patch.setattr(np.random, "permutation", noise.permutation)
            theirs.learn(192, reset_num_timesteps=False, log_interval=None)
            patch.undo()
            extractor = theirs.policy.features_extractor  # which stable-baselines3 never updates
            extractor.load_state_dict(ours.policy.features_extractor.state_dict())
            for name in ("observations", "actions", "rewards", "values", "log_probs"):
                expected = flat(theirs, name)
                np.testing.assert_allclose(flat(ours, name), expected, rtol=1e-3, atol=1e-4)
            for name in ("advantages", "returns"):
                expected = flat(theirs, name)
                np.testing.assert_allclose(flat(ours, name), expected, rtol=1e-3, atol=1e-3)
            logged = theirs.logger.name_to_value
            for name in (name for name in logged if name.startswith("train/")):
                found = ours.logger.name_to_value[name]
                assert found == pytest.approx(logged[name], rel=1e-3, abs=1e-4), name
    ends, cut = ours._bootstrap != 0, ours.rollout_buffer.episode_starts[1:] != 0
    assert ends.sum() >= 3 and cut.sum() > ends[:-1].sum() + 3  # time limits, and falls
    for name, value in theirs.policy.state_dict().items():
        np.testing.assert_allclose(
            ours.policy.state_dict()[name].numpy(), value.numpy(), rtol=1e-3, atol=1e-4
        )


@pytest.mark.parametrize("method", METHODS)
def test_time_limits_are_continued_with_the_value_and_falls_are_not(method: type) -> None:
    demos = [np.random.default_rng(0).standard_normal((30, 3)).astype(np.float32)]
    env = make_vec_env(Bounded, 2, seed=0)
    seen: list[tuple[int, int, bool, np.ndarray]] = []
    step_wait = env.step_wait

    def watched() -> tuple:
        obs, rewards, dones, infos = step_wait()
        step = watched.step
        for i in np.flatnonzero(dones):
            cut = infos[i]["TimeLimit.truncated"]
            seen.append((step, i, cut, infos[i]["terminal_observation"].copy()))
        watched.step += 1
        return obs, rewards, dones, infos

    watched.step = 0
    env.step_wait = watched
    model = method("MlpPolicy", env, demos, n_steps=64, gamma=0.7, seed=0, disc_hidden=(16,))
    model._record_episodes = lambda: None
    values = {}

    def before_the_update() -> None:
        for step, i, _, terminal in seen:
            obs = th.from_numpy(terminal[None])
            values[step, i] = model.policy.predict_values(obs).item()

    class Watch(silem.algorithms.ppo.BaseCallback):
        def _on_step(self) -> bool:
            return True

        def _on_rollout_end(self) -> None:
            before_the_update()

    with pytest.warns(UserWarning, match="absorbing_states"):
        model.learn(128, callback=Watch())
    expected = np.zeros((64, 2))
    for step, i, cut, _ in seen:
        expected[step, i] = 0.7 * values[step, i] if cut else 0.0
    assert {cut for _, _, cut, _ in seen} == {True, False}
    np.testing.assert_allclose(model._bootstrap, expected, rtol=1e-3, atol=1e-5)
    judged = model._judged(model._transformed(th.from_numpy(model._windows.reshape(-1, 4, 3))), "d")
    if method is not SILEM:  # whose T has moved on since
        rewards = judged.reshape(64, 2) + expected
        np.testing.assert_allclose(model.rollout_buffer.rewards, rewards, rtol=1e-4, atol=1e-4)
