"""TPIL: gradient reversal, its two discriminators, and the interface it shares with SILEM."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import torch as th
from point_mass import PointMass, expert_of_point_mass
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.logger import configure
from torch.nn import functional as F

from silem import SilemError
from silem.algorithms import SILEM, TPIL
from silem.algorithms.networks import ThirdPersonDiscriminator, reverse_gradient
from silem.study.runs import curve_row

EXPERT = [np.random.default_rng(i).standard_normal((40, 3)).astype(np.float32) for i in range(4)]


def make_model(**kwargs) -> TPIL:
    env = make_vec_env("Pendulum-v1", 2, seed=0)
    settings = dict(disc_hidden=(32, 32), n_disc_updates=2, n_steps=64, seed=0) | kwargs
    return TPIL("MlpPolicy", env, EXPERT, **settings)


def windows_of(rng: np.random.Generator, n: int = 512) -> th.Tensor:
    return th.from_numpy(rng.normal(1.5, 2.0, (n, 4, 3)).astype(np.float32))


def gradients(loss: th.Tensor, module: th.nn.Module) -> list[th.Tensor]:
    return list(th.autograd.grad(loss, list(module.parameters()), retain_graph=True))


@pytest.mark.parametrize("coef", [0.0, 0.3, 0.6, 1.0, 1.3])
def test_reversed_gradient_is_minus_coef_times_the_plain_one(coef: float) -> None:
    generator = th.Generator().manual_seed(0)
    x = th.randn(5, 3, generator=generator, requires_grad=True)
    weights = th.randn(5, 3, generator=generator)
    assert th.equal(reverse_gradient(x, coef), x)
    (plain,) = th.autograd.grad((x.square() * weights).sum(), x)
    (back,) = th.autograd.grad((reverse_gradient(x, coef).square() * weights).sum(), x)
    assert th.equal(back, -coef * plain)
    assert bool(back.any()) == (coef > 0)


@pytest.mark.parametrize("coef", [0.0, 0.5, 1.0, 1.3])
def test_reversal_reaches_the_encoder_and_not_the_domain_head(
    coef: float, rng: np.random.Generator
) -> None:
    disc = ThirdPersonDiscriminator(3, 4, (16, 8), coef)
    states = windows_of(rng)[:, -1]
    plain = disc.domain_head(disc.encoder(states)).sum()
    reversed_ = disc.domain_logits(states).sum()
    assert plain.item() == reversed_.item()
    pairs = zip(gradients(reversed_, disc.encoder), gradients(plain, disc.encoder), strict=True)
    for back, straight in pairs:
        th.testing.assert_close(back, -coef * straight)
        if coef in (0.0, 0.5, 1.0):  # factors that rounding does not touch
            assert th.equal(back, -coef * straight)
    heads = gradients(reversed_, disc.domain_head), gradients(plain, disc.domain_head)
    assert all(th.equal(a, b) and a.any() for a, b in zip(*heads, strict=True))


def test_loss_is_both_discriminators_with_the_reversed_gradient_in_the_encoder(
    rng: np.random.Generator,
) -> None:
    """Encoder: the window loss's gradient minus C_g times the domain loss's; heads: their own."""
    expert, learner, mixing = windows_of(rng, 64) - 1.5, windows_of(rng, 64), th.rand(64)
    found = {}
    for coef in (0.0, 0.7):
        model = make_model(gradient_reversal_coef=coef)
        loss, stats = model._disc_loss(expert, learner, mixing)
        found[coef] = gradients(loss, model.discriminator)
        assert loss.item() > stats["disc_loss"] + 0.9 * stats["domain_loss"]
    disc = model.discriminator
    logits = [disc.domain_head(disc.encoder(w[:, -1]))[:, 0] for w in (expert, learner)]
    domain_loss = -(th.sigmoid(logits[0]).log().mean() + th.sigmoid(-logits[1]).log().mean())
    assert stats["domain_loss"] == pytest.approx(domain_loss.item(), rel=1e-5)
    judged = ((logits[0] > 0).sum() + (logits[1] < 0).sum()) / 128
    assert stats["domain_acc"] == pytest.approx(judged.item())
    names = [name for name, _ in disc.named_parameters()]
    plain = dict(
        zip(
            ("encoder.0.weight", "encoder.0.bias"),
            gradients(domain_loss, disc.encoder),
            strict=True,
        )
    )
    for name, without, with_it in zip(names, found[0.0], found[0.7], strict=True):
        expected = without - 0.7 * plain[name] if name in plain else without
        th.testing.assert_close(with_it, expected)


def test_one_step_updates_encoder_and_both_heads(rng: np.random.Generator) -> None:
    model = make_model(n_disc_updates=1)
    before = [p.detach().clone() for p in model.discriminator.parameters()]
    policy = [p.detach().clone() for p in model.policy.parameters()]
    model.update_discriminator(windows_of(rng))
    after = list(model.discriminator.parameters())
    assert not any(th.equal(a, b) for a, b in zip(before, after, strict=True))
    assert all(th.equal(a, b) for a, b in zip(policy, model.policy.parameters(), strict=True))


@pytest.mark.parametrize("coef", [0.0, 1.3])
def test_encoder_works_against_the_domain_head(coef: float, rng: np.random.Generator) -> None:
    """A small step down the gradients: the head's lowers the loss, the encoder's raises it."""
    disc = ThirdPersonDiscriminator(3, 4, (16, 8), coef)
    expert, learner = windows_of(rng)[:, -1] - 1.5, windows_of(rng)[:, -1]

    def loss() -> th.Tensor:
        logits = disc.domain_logits(expert), disc.domain_logits(learner)
        return F.softplus(-logits[0]).mean() + F.softplus(logits[1]).mean()

    for part, sign in ((disc.domain_head, -1.0), (disc.encoder, np.sign(coef))):
        before = loss()
        with th.no_grad():
            for p, gradient in zip(part.parameters(), gradients(before, part), strict=True):
                p -= 1e-2 * gradient
        assert np.sign(loss().item() - before.item()) == sign


def test_discriminator_steps_lower_its_loss(rng: np.random.Generator) -> None:
    model, windows = make_model(), windows_of(rng)
    losses = [model.update_discriminator(windows)["disc_loss"] for _ in range(15)]
    assert losses[-1] < 0.8 * losses[0]


def test_rewards_are_the_window_discriminators(rng: np.random.Generator) -> None:
    model = make_model().learn(128)
    rewards = model.rollout_buffer.rewards
    assert ((rewards > 0.0) & (rewards < 1.0)).all() and rewards.std() > 0.0
    windows = windows_of(rng).numpy()
    scores = model.score_windows(windows)
    disc = model.discriminator
    with th.no_grad():
        encoded = th.cat([disc.encoder(th.from_numpy(windows[:, i])) for i in range(4)], dim=1)
        expected = th.sigmoid(disc.window_head(encoded))[:, 0].numpy()
        for p in disc.domain_head.parameters():
            p.zero_()
    np.testing.assert_allclose(scores, expected, rtol=1e-5)
    np.testing.assert_array_equal(model.score_windows(windows), scores)


def test_imitates_an_expert_end_to_end() -> None:
    """The environment's reward, unseen in training, rises from about 0 towards the expert's."""
    model = TPIL(
        "MlpPolicy", make_vec_env(PointMass, 4, seed=0), expert_of_point_mass(),
        gradient_reversal_coef=0.3, disc_hidden=(64, 64), n_steps=100, batch_size=50,
        learning_rate=3e-3, seed=1, gamma=0.9,
    )  # fmt: skip
    model.learn(16_000)
    expert_return = expert_of_point_mass()[0][1:, 1].sum()
    assert model.iteration_stats["return_mean"] > 0.6 * expert_return


def test_both_discriminators_are_logged(tmp_path) -> None:
    model = make_model()
    model.set_logger(configure(str(tmp_path), ["csv"]))
    model.learn(512)
    model.logger.dump(512)  # as of PPO's losses, the last iteration's would come with the next
    model.logger.close()
    last = pd.read_csv(tmp_path / "progress.csv").iloc[-1]
    names = ("disc_loss", "disc_acc_expert", "disc_acc_learner", "domain_loss", "domain_acc")
    for name in names:
        assert last[f"imitation/{name}"] == pytest.approx(model.iteration_stats[name], abs=1e-3)
    assert 0.0 < last["imitation/disc_reward"] < 200.0
    # a column that curves do not have is no trouble
    assert np.isfinite(curve_row(1, 64, model.iteration_stats)).sum() >= 5


def test_same_seed_same_arrays() -> None:
    first, second = make_model().learn(256), make_model().learn(256)
    other = make_model(gradient_reversal_coef=0.5).learn(256)
    a, b, c = (model.state_arrays() for model in (first, second, other))
    assert all(np.array_equal(a[name], b[name]) for name in a)
    assert any(not np.array_equal(a[name], c[name]) for name in a)


def test_going_on_from_the_state_arrays_equals_going_on() -> None:
    """As at a checkpoint: environments reset, random streams restarted, on both sides."""
    straight = make_model().learn(128)
    saved = straight.state_arrays()
    resumed = make_model(seed=1)
    resumed.load_state_arrays(saved)
    for model in (straight, resumed):
        model.env.seed(3)
        model.reseed(5)
        model.learn(256)
    a, b = straight.state_arrays(), resumed.state_arrays()
    assert all(np.array_equal(a[name], b[name]) for name in a)
    assert any(not np.array_equal(a[name], saved[name]) for name in a if "domain_head" in name)


def test_state_arrays_of_another_method_are_refused() -> None:
    arrays = SILEM(
        "MlpPolicy", make_vec_env("Pendulum-v1", 2), EXPERT, disc_hidden=(32, 32)
    ).state_arrays()
    with pytest.raises(SilemError):
        make_model().load_state_arrays(arrays)


def test_save_load_learn_on(tmp_path) -> None:
    model = make_model(gradient_reversal_coef=0.3, encoder_layers=2).learn(128)
    assert len(model.discriminator.encoder) == 2 * len(make_model().discriminator.encoder) == 4
    model.save(tmp_path / "tpil.zip")
    loaded = TPIL.load(tmp_path / "tpil.zip", env=model.get_env())
    assert loaded.discriminator.reversal_coef == 0.3
    for name, array in model.state_arrays().items():
        np.testing.assert_array_equal(loaded.state_arrays()[name], array)
    windows = windows_of(np.random.default_rng(0)).numpy()
    np.testing.assert_array_equal(loaded.score_windows(windows), model.score_windows(windows))
    loaded.learn(128)


@pytest.mark.parametrize(
    ("demonstrations", "message"),
    [
        ([np.full((5, 3), np.nan)], "NaN"),
        ([np.zeros((1, 3))], "too short"),
        ([np.zeros((5, 2))], r"2 features per state.*supplies 3"),
        (None, "needs demonstrations"),
    ],
)
def test_unusable_demonstrations_are_refused(demonstrations, message: str) -> None:
    with pytest.raises(SilemError, match=message):
        TPIL("MlpPolicy", make_vec_env("Pendulum-v1", 1), demonstrations, n_steps=64).learn(64)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (dict(gradient_reversal_coef=-0.1), "from 0"),
        (dict(gradient_reversal_coef=float("nan")), "from 0"),
        (dict(disc_hidden=()), "one layer at least"),
        (dict(encoder_layers=0), "whole number from 1"),
    ],
)
def test_unusable_settings_are_refused(settings: dict, message: str) -> None:
    with pytest.raises(SilemError, match=message):
        make_model(**settings)
