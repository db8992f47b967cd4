"""The NumPy actor-critic against torch autograd and stable-baselines3's own update."""

from __future__ import annotations

import copy

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from stable_baselines3 import PPO as SB3PPO
from stable_baselines3.common.env_util import make_vec_env

import silem
from silem.algorithms.fast_mlp import Batch, FlatActorCritic
from silem.algorithms.networks import RunningNormalizer

CLIP, ENT, VF = 0.2, 0.01, 0.5


def make_policy(dtype: th.dtype) -> th.nn.Module:
    env = gym.make("Pendulum-v1")
    model = SB3PPO("MlpPolicy", env, policy_kwargs={"net_arch": {"pi": [7, 5], "vf": [6]}}, seed=3)
    return model.policy.to(dtype)


def make_batch(rng: np.random.Generator, dtype: type, size: int = 64) -> Batch:
    draw = lambda *shape: rng.standard_normal(shape).astype(dtype)  # noqa: E731
    # old log-probabilities far enough from the present ones for both clip limits to act
    return Batch(draw(size, 3), draw(size, 1), draw(size) - 1.4, draw(size), draw(size))


def torch_gradients(policy: th.nn.Module, batch: Batch) -> list[th.Tensor]:
    """PPO's loss as stable-baselines3 writes it."""
    obs, actions, old_log_probs, advantages, returns = map(th.from_numpy, batch)
    latent_pi, latent_vf = policy.mlp_extractor(obs)  # evaluate_actions would cast to float32
    distribution = policy._get_action_dist_from_latent(latent_pi)
    log_prob, entropy = distribution.log_prob(actions), distribution.entropy()
    values = policy.value_net(latent_vf)
    ratio = th.exp(log_prob - old_log_probs)
    surrogate = th.min(advantages * ratio, advantages * th.clamp(ratio, 1 - CLIP, 1 + CLIP))
    value_loss = th.nn.functional.mse_loss(returns, values.flatten())
    loss = -surrogate.mean() - ENT * entropy.mean() + VF * value_loss
    return list(th.autograd.grad(loss, list(policy.parameters())))


def flat_gradients(policy: th.nn.Module, batch: Batch) -> tuple[np.ndarray, float]:
    flat = FlatActorCritic(policy)
    losses = flat.gradient(batch, CLIP, ENT, VF)
    return flat.grads, losses.clip_fraction


def test_gradient_equals_autograd(rng: np.random.Generator) -> None:
    policy, batch = make_policy(th.float64), make_batch(rng, np.float64)
    expected = np.concatenate([g.numpy().ravel() for g in torch_gradients(policy, batch)])
    actual, clip_fraction = flat_gradients(policy, batch)
    assert 0.1 < clip_fraction < 0.95  # both sides of the clip are exercised
    np.testing.assert_allclose(actual, expected, rtol=1e-5, atol=1e-12)


def test_gradient_differs_without_the_clip(rng: np.random.Generator) -> None:
    """Negative control: the comparison notices a missing clip."""
    policy, batch = make_policy(th.float64), make_batch(rng, np.float64)
    expected = np.concatenate([g.numpy().ravel() for g in torch_gradients(policy, batch)])
    flat = FlatActorCritic(policy)
    flat.gradient(batch, 1e9, ENT, VF)
    assert not np.allclose(flat.grads, expected, rtol=1e-5, atol=1e-12)


def test_torch_sees_the_same_memory(rng: np.random.Generator) -> None:
    policy, batch = make_policy(th.float32), make_batch(rng, np.float32)
    flat = FlatActorCritic(policy)
    before = copy.deepcopy(policy.state_dict())
    flat.gradient(batch, CLIP, ENT, VF)
    flat.adam_step(0.5)
    after = policy.state_dict()
    assert all(not th.equal(before[name], after[name]) for name in before)
    values = policy.predict_values(th.from_numpy(batch.observations)).detach().numpy()[:, 0]
    np.testing.assert_allclose(flat.values(batch.observations), values, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("max_grad_norm", [0.5, float("inf")])
def test_train_equals_stable_baselines3(max_grad_norm: float, monkeypatch) -> None:
    """One full train() on the same rollout and minibatch order."""
    kwargs = {"n_steps": 128, "batch_size": 64, "n_epochs": 4, "seed": 0, "ent_coef": 0.01}
    kwargs["max_grad_norm"] = max_grad_norm
    env = make_vec_env("Pendulum-v1", 2, seed=0)
    ours = silem.PPO("MlpPolicy", env, normalize_observations=False, **kwargs)
    ours.learn(256)  # a first iteration, so Adam's moments are not zero
    ours.learn(256, reset_num_timesteps=False, callback=_StopBeforeTraining())
    theirs = SB3PPO("MlpPolicy", env, device="cpu", **kwargs)
    theirs.set_parameters(copy.deepcopy(ours.get_parameters()))
    theirs.set_logger(ours.logger)
    theirs.rollout_buffer = copy.deepcopy(ours.rollout_buffer)
    order = np.random.default_rng(5)
    monkeypatch.setattr(np.random, "permutation", order.permutation)
    ours._rng = np.random.default_rng(5)
    ours.train()
    theirs.train()
    for name, value in theirs.policy.state_dict().items():
        np.testing.assert_allclose(
            ours.policy.state_dict()[name].numpy(), value.numpy(), rtol=1e-4, atol=1e-5
        )


class _StopBeforeTraining(silem.algorithms.ppo.BaseCallback):
    """Let one rollout be collected; end learning at its last moment."""

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        self.model.train = lambda: delattr(self.model, "train")  # skipped once


def test_unsupported_policies_fall_back() -> None:
    relu = {"activation_fn": th.nn.ReLU}
    env = make_vec_env("CartPole-v1", 2, seed=0)
    assert silem.PPO("MlpPolicy", env, n_steps=32)._fast is None  # discrete actions
    env = make_vec_env("Pendulum-v1", 2, seed=0)
    assert silem.PPO("MlpPolicy", env, n_steps=32, policy_kwargs=relu)._fast is None
    assert silem.PPO("MlpPolicy", env, n_steps=32, clip_range_vf=0.2)._fast is None
    assert silem.PPO("MlpPolicy", env, n_steps=32)._fast is not None


@pytest.mark.parametrize("env_id", ["CartPole-v1", "Pendulum-v1"])
def test_save_load_predict_and_resume(env_id: str, tmp_path) -> None:
    env = make_vec_env(env_id, 2, seed=0)
    model = silem.PPO("MlpPolicy", env, n_steps=64, seed=0).learn(128)
    model.save(tmp_path / "model.zip")
    loaded = silem.PPO.load(tmp_path / "model.zip", env=env)
    obs = env.reset()
    expected = model.predict(obs, deterministic=True)[0]
    np.testing.assert_array_equal(loaded.predict(obs, deterministic=True)[0], expected)
    before, restored = model.state_arrays(), loaded.state_arrays()
    assert before.keys() == restored.keys()
    for name, array in before.items():
        np.testing.assert_array_equal(restored[name], array)
    loaded.learn(128)
    assert any(not np.array_equal(loaded.state_arrays()[n], a) for n, a in before.items())


def test_normalizer_equals_the_moments_of_all_it_saw(rng: np.random.Generator) -> None:
    batches = [rng.normal(3.0, 2.0, (n, 4)) for n in (50, 7, 300)]
    normalizer = RunningNormalizer(gym.spaces.Box(-1, 1, (4,)))
    for batch in batches:
        normalizer.update(batch)
    seen = np.concatenate(batches)
    np.testing.assert_allclose(normalizer.mean, seen.mean(0), rtol=1e-4)
    np.testing.assert_allclose(normalizer.var, seen.var(0), rtol=1e-3)
    assert abs(normalizer(th.full((1, 4), 1e6))).max() == 5.0


def test_state_arrays_refuse_what_does_not_fit() -> None:
    env = make_vec_env("Pendulum-v1", 2, seed=0)
    model = silem.PPO("MlpPolicy", env, n_steps=64, seed=0).learn(128)
    arrays = model.state_arrays()
    name = "policy/log_std"
    for wrong, message in (
        ({k: v for k, v in arrays.items() if k != name}, "lacks"),
        (arrays | {"policy/extra": np.zeros(1)}, "unknown"),
        (arrays | {name: np.zeros(3, np.float32)}, "shape"),
        (arrays | {name: np.full_like(arrays[name], np.nan)}, "NaN"),
    ):
        with pytest.raises(silem.SilemError, match=message):
            model.load_state_arrays(wrong)
