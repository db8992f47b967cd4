"""The losses of Algorithm 1, what they may change, and learning end to end."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest
import torch as th
from point_mass import PointMass, expert_of_point_mass
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.logger import configure

from silem import SILEM, Demonstrations, GAIfO, SilemError
from silem.algorithms.networks import Discriminator, discriminator_loss, squared_gradient_norm
from silem.algorithms.silem import (
    GATE_SPREAD,
    TRANSFORMS,
    AffineEnsemble,
    AffineTransform,
    l2_penalty,
)

EXPERT = [np.random.default_rng(i).standard_normal((40, 3)).astype(np.float32) for i in range(4)]


def make_model(transform: str = "affine", **kwargs) -> SILEM:
    env = make_vec_env("Pendulum-v1", 2, seed=0)
    return SILEM("MlpPolicy", env, EXPERT, transform=transform, n_steps=64, seed=0, **kwargs)


def cloud(rng: np.random.Generator, n: int = 512) -> th.Tensor:
    """Learner windows whose states are the expert's, scaled and shifted."""
    return th.from_numpy(rng.normal(1.5, 2.0, (n, 4, 3)).astype(np.float32))


def snapshot(module: th.nn.Module) -> list[th.Tensor]:
    return [p.detach().clone() for p in module.parameters()]


def unchanged(before: list[th.Tensor], module: th.nn.Module) -> bool:
    return all(th.equal(a, b) for a, b in zip(before, module.parameters(), strict=True))


def test_transform_starts_as_the_identity(rng: np.random.Generator) -> None:
    windows = cloud(rng)
    assert th.equal(AffineTransform(3)(windows), windows)
    assert not th.allclose(TRANSFORMS["mlp"](3)(windows), windows)


def test_affine_acts_state_by_state(rng: np.random.Generator) -> None:
    transform = AffineTransform(3)
    with th.no_grad():
        transform.scale.copy_(th.tensor([2.0, 1.0, 0.5]))
        transform.offset.copy_(th.tensor([0.0, 1.0, 0.0]))
    windows = cloud(rng)
    expected = windows * th.tensor([2.0, 1.0, 0.5]) + th.tensor([0.0, 1.0, 0.0])
    assert th.equal(transform(windows), expected)


def ensemble(n_features: int = 2, n_components: int = 2) -> AffineEnsemble:
    """Two maps, of which the gate gives the first w = 3/4 where g_1 = ln 3, 1/2 where it is 0."""
    made = AffineEnsemble(n_components, th.randn(50, n_features))
    with th.no_grad():
        made.gate.weight.zero_()
        made.gate.bias.zero_()
        made.gate.weight[0, 0] = 1.0
        made.scale.copy_(th.tensor([[2.0, 1.0], [0.0, 1.0]]))
        made.offset.copy_(th.tensor([[0.0, 1.0], [4.0, -1.0]]))
    return made


def test_an_ensemble_by_hand() -> None:
    made, log_3 = ensemble(), float(np.log(3.0))
    states = th.tensor([[log_3, 5.0], [0.0, 5.0]])
    # 3/4 (2 ln 3, 6) + 1/4 (4, 4), and the mean of (0, 6) and (4, 4)
    expected = th.tensor([[1.5 * log_3 + 1.0, 5.5], [2.0, 5.0]])
    th.testing.assert_close(made(states), expected)
    th.testing.assert_close(made(states.reshape(1, 2, 2)), expected[None])  # windows, by state
    made.weigh(states)
    np.testing.assert_allclose(made.shares, [0.625, 0.375])
    np.testing.assert_allclose(made.mean()["A"], [1.25, 1.0])
    np.testing.assert_allclose(made.mean()["b"], [1.5, 0.25])


def test_an_ensemble_starts_as_the_identity_and_its_maps_part(rng: np.random.Generator) -> None:
    model = make_model(transform_components=4, transform_learning_rate=1e-3)
    made, windows = model.transform_net, cloud(rng)
    assert isinstance(made, AffineEnsemble)
    th.testing.assert_close(made(windows), windows)
    assert l2_penalty(made, 10.0, 4.0).item() == 0.0
    for _ in range(10):
        model.update_discriminator(windows)
        model.update_transform(windows)
    assert made.scale.detach().std(dim=0).min() > 1e-4  # equal maps would never part
    assert not th.allclose(made.shares, th.full((4,), 0.25), atol=1e-3)
    assert l2_penalty(made, 10.0, 4.0).item() > 0.0


def test_a_gate_chooses_among_the_experts_states_and_ignores_what_stands_still() -> None:
    states = th.randn(4000, 6) * th.tensor([1.0, 0.1, 10.0, 1.0, 1.0, 1e-9]) + 3.0
    gates = [AffineEnsemble(8, states).gate for _ in range(20)]
    logits = th.stack([gate(states) for gate in gates]).detach()
    assert logits.mean().abs() < 1e-3
    assert logits.std().item() == pytest.approx(GATE_SPREAD, rel=0.15)
    assert all((gate.weight[:, 5] == 0).all() for gate in gates)
    weights = AffineEnsemble(4, states).weights(states)
    assert weights.max(dim=1).values.mean() > 0.6  # of four maps that were alike: 0.25


def test_without_its_gate_an_ensembles_maps_never_part(rng: np.random.Generator) -> None:
    model = make_model(transform_components=2, transform_learning_rate=1e-3)
    with th.no_grad():
        for p in model.transform_net.gate.parameters():
            p.zero_()
    for _ in range(5):
        model.update_discriminator(cloud(rng))
        model.update_transform(cloud(rng))
    assert th.equal(model.transform_net.scale[0], model.transform_net.scale[1])


def test_an_ensembles_gradient_is_that_of_differences() -> None:
    made = ensemble().double()
    states = th.tensor([[0.3, -1.2], [2.0, 0.7]], dtype=th.float64)
    names, values = zip(*made.named_parameters(), strict=True)

    def at(*given: th.Tensor) -> th.Tensor:
        of = dict(zip(names, given, strict=True))
        return th.func.functional_call(made, of, (states,))

    assert th.autograd.gradcheck(at, tuple(v.detach().requires_grad_() for v in values))


def test_one_component_is_silem_to_the_bit() -> None:
    states = []
    for settings in ({}, {"transform_components": 1}, {"transform_components": 2}):
        model = make_model(**settings)
        model.learn(256)
        states.append(model.state_arrays())
    plain, one, two = states
    assert plain.keys() == one.keys() != two.keys()
    assert all(np.array_equal(plain[name], one[name]) for name in plain)
    assert not np.array_equal(plain["policy/log_std"], two["policy/log_std"])


def test_an_ensemble_goes_on_from_its_saved_arrays() -> None:
    model, other = (make_model(transform_components=3) for _ in range(2))
    model.learn(128)
    arrays = model.state_arrays()
    assert {"transform/gate.weight", "transform/shares", "transform/scale"} <= arrays.keys()
    other.load_state_arrays(arrays)
    for name, values in model.transform_net.mean().items():
        np.testing.assert_array_equal(values, other.transform_net.mean()[name])
    assert not np.allclose(arrays["transform/shares"], 1 / 3, atol=1e-3)  # as last weighed


def test_an_mlp_has_no_components() -> None:
    with pytest.raises(SilemError, match="only affine maps have components, not 'mlp'"):
        make_model("mlp", transform_components=2)


def test_discriminator_steps_lower_its_loss(rng: np.random.Generator) -> None:
    model, windows = make_model(), cloud(rng)
    losses = [model.update_discriminator(windows)["disc_loss"] for _ in range(5)]
    assert losses[-1] < 0.8 * losses[0]


def test_transform_steps_lower_its_loss_and_leave_the_discriminator(
    rng: np.random.Generator,
) -> None:
    model, windows = make_model(transform_learning_rate=1e-2), cloud(rng)
    for _ in range(10):
        model.update_discriminator(windows)
    disc, policy = snapshot(model.discriminator), snapshot(model.policy)
    transform = snapshot(model.transform_net)
    losses = [model.update_transform(windows)["transform_loss"] for _ in range(10)]
    assert losses[-1] < losses[0]
    assert unchanged(disc, model.discriminator) and unchanged(policy, model.policy)
    assert not unchanged(transform, model.transform_net)


def test_discriminator_steps_leave_the_transform(rng: np.random.Generator) -> None:
    model = make_model()
    transform, disc = snapshot(model.transform_net), snapshot(model.discriminator)
    model.update_discriminator(cloud(rng))
    assert unchanged(transform, model.transform_net)
    assert not unchanged(disc, model.discriminator)


def test_discriminator_loss_by_hand() -> None:
    class Fixed(th.nn.Module):
        def forward(self, windows: th.Tensor) -> th.Tensor:
            return windows[:, 0, 0]

    expert = th.full((2, 4, 1), np.log(3.0))  # D = 0.75
    learner = th.full((2, 4, 1), -np.log(4.0))  # D = 0.2
    loss, _ = discriminator_loss(Fixed(), expert, learner, entropy_coef=0.0, gradient_penalty=0.0)
    assert loss.item() == pytest.approx(-np.log(0.75) - np.log(0.8))
    entropies = [-p * np.log(p) - (1 - p) * np.log(1 - p) for p in (0.75, 0.2)]
    bonus, _ = discriminator_loss(Fixed(), expert, learner, entropy_coef=2.0, gradient_penalty=0.0)
    assert (loss - bonus).item() == pytest.approx(2.0 * np.mean(entropies))


def test_gradient_norm_of_a_linear_discriminator() -> None:
    disc = Discriminator(3, 4, hidden=())
    weight = disc.net[1].weight
    norm = squared_gradient_norm(disc, th.randn(5, 4, 3))
    assert norm.item() == pytest.approx(weight.square().sum().item(), rel=1e-5)
    norm.backward()
    th.testing.assert_close(weight.grad, 2.0 * weight.detach())


@pytest.mark.parametrize(("form", "rest"), [("deviation", 1.0), ("plain", 0.0)])
def test_gradient_of_the_l2_term_in_closed_form(form: str, rest: float) -> None:
    transform = AffineTransform(3)
    with th.no_grad():
        transform.scale.copy_(th.tensor([2.0, 1.0, -0.5]))
        transform.offset.copy_(th.tensor([0.3, 0.0, -1.0]))
    l2_penalty(transform, 10.0, 4.0, form).backward()
    expected = 2.0 * 10.0 / 3.0 * (transform.scale.detach() - rest)
    th.testing.assert_close(transform.scale.grad, expected)
    th.testing.assert_close(transform.offset.grad, 2.0 * 4.0 / 3.0 * transform.offset.detach())


@pytest.mark.parametrize(
    ("settings", "scale", "offset"),
    [
        (dict(transform_l2_scale=1.0, transform_l2_bias=10.0), 1.0, 0.0),
        (dict(transform_l2_scale=1.0, transform_l2_bias=1.0, transform_l2_form="plain"), 0.0, 0.0),
        (dict(transform_l2_bias=1.0), 1.5, 0.0),
        (dict(transform_l2_scale=1.0), 1.0, 0.5),
        (dict(), 1.5, 0.5),  # without the term a constant D leaves the transform where it is
    ],
)
def test_l2_pulls_the_transform_where_a_constant_discriminator_leaves_it(
    settings: dict, scale: float, offset: float, rng: np.random.Generator
) -> None:
    model = make_model(transform_learning_rate=2e-2, n_transform_updates=8, **settings)
    with th.no_grad():
        for p in model.discriminator.parameters():
            p.zero_()
        model.transform_net.scale.fill_(1.5)
        model.transform_net.offset.fill_(0.5)
    windows = cloud(rng)
    losses = [model.update_transform(windows)["transform_loss"] for _ in range(60)]
    assert losses == pytest.approx([np.log(2.0)] * 60)  # line 10's loss alone is reported
    th.testing.assert_close(
        model.transform_net.scale.detach(), th.full((3,), scale), atol=0.02, rtol=0
    )
    th.testing.assert_close(
        model.transform_net.offset.detach(), th.full((3,), offset), atol=0.02, rtol=0
    )


@pytest.mark.parametrize(("method", "recovers"), [(SILEM, True), (GAIfO, False)])
def test_silem_recovers_scale_and_shift_gaifo_does_not(method: type, recovers: bool) -> None:
    """Lines 9 and 10 alone, between feature clouds that differ by a known affine map."""
    rng = np.random.default_rng(0)
    scale, shift = np.array([2.0, 0.5, 1.0]), np.array([0.0, 1.0, -0.5])
    expert = rng.standard_normal((4, 1001, 3)).astype(np.float32)
    env = make_vec_env("Pendulum-v1", 1, seed=0)
    own = dict(transform_learning_rate=5e-3, n_transform_updates=4) if method is SILEM else {}
    model = method(
        "MlpPolicy", env, list(expert), n_steps=64, seed=0, window=1, disc_hidden=(32, 32),
        disc_learning_rate=3e-3, gradient_penalty=0.0, n_disc_updates=4, **own,
    )  # fmt: skip
    for _ in range(200):
        states = ((rng.standard_normal((512, 1, 3)) - shift) / scale).astype(np.float32)
        windows = th.from_numpy(states)
        model.update_discriminator(model._transformed(windows))
        model.update_transform(windows)
    probe = th.from_numpy(((rng.standard_normal((2000, 1, 3)) - shift) / scale).astype(np.float32))
    mapped = model._transformed(probe).detach().numpy()[:, 0]
    error = max(abs(mapped.mean(0)).max(), abs(mapped.std(0) - 1.0).max())
    assert bool(error < 0.25) == recovers


@pytest.mark.parametrize("method", [GAIfO, SILEM])
def test_imitates_an_expert_end_to_end(method: type) -> None:
    """The environment's reward, unseen in training, rises from about 0 towards the expert's."""
    model = method(
        "MlpPolicy", make_vec_env(PointMass, 4, seed=0), expert_of_point_mass(), n_steps=100,
        batch_size=50, learning_rate=3e-3, seed=1, gamma=0.9,
    )  # fmt: skip
    model.learn(16_000)
    expert_return = expert_of_point_mass()[0][1:, 1].sum()
    assert model.iteration_stats["return_mean"] > 0.6 * expert_return


def test_logger_reports_imitation(tmp_path) -> None:
    model = make_model()
    model.set_logger(configure(str(tmp_path), ["csv", "tensorboard"]))
    model.learn(512)
    model.logger.dump(512)  # as of PPO's losses, the last iteration's would come with the next
    model.logger.close()
    last = pd.read_csv(tmp_path / "progress.csv").iloc[-1]
    for name in ("disc_loss", "disc_acc_expert", "disc_acc_learner", "transform_loss"):
        assert np.isfinite(last[f"imitation/{name}"])
    # Pendulum's episodes last 200 steps, each worth between 0 and 1
    assert 0.0 < last["imitation/disc_reward"] < 200.0
    scale = model.transform_net.scale.tolist()
    assert [last[f"transform/scale_{i}"] for i in range(3)] == pytest.approx(scale, abs=1e-3)
    assert list(tmp_path.glob("events.out.tfevents.*"))


def test_same_seed_same_arrays() -> None:
    first, second, other = (
        make_model().learn(256),
        make_model().learn(256),
        make_model(disc_learning_rate=3e-3).learn(256),
    )
    a, b, c = (model.state_arrays() for model in (first, second, other))
    assert all(np.array_equal(a[name], b[name]) for name in a)
    assert any(not np.array_equal(a[name], c[name]) for name in a)


@pytest.mark.parametrize("transform", ["affine", "mlp"])
def test_save_load_learn_on(transform: str, tmp_path) -> None:
    model = make_model(transform).learn(128)
    model.save(tmp_path / "silem.zip")
    loaded = SILEM.load(tmp_path / "silem.zip", env=model.get_env())
    for name, array in model.state_arrays().items():
        np.testing.assert_array_equal(loaded.state_arrays()[name], array)
    windows = cloud(np.random.default_rng(0)).numpy()
    np.testing.assert_array_equal(loaded.score_windows(windows), model.score_windows(windows))
    loaded.learn(128)


def test_discrete_actions_take_stable_baselines3s_path() -> None:
    demos = [np.zeros((10, 4), dtype=np.float32)]
    model = SILEM("MlpPolicy", make_vec_env("CartPole-v1", 2, seed=0), demos, n_steps=32)
    model.learn(64)
    assert 0.0 < model.rollout_buffer.rewards.mean() < 1.0


@pytest.mark.parametrize(
    ("shape", "message"), [((7, 4, 2), "(B, 4, 3)"), ((7, 3, 3), "(B, 4, 3)"), ((4, 3), "(4, 3)")]
)
def test_windows_of_another_shape_are_refused(shape: tuple[int, ...], message: str) -> None:
    with pytest.raises(SilemError, match=re.escape(message)):
        make_model().score_windows(np.zeros(shape, dtype=np.float32))


@pytest.mark.parametrize(
    ("demonstrations", "message"),
    [
        ([], "none at all"),
        ([np.zeros((1, 3))], "too short"),
        ([np.full((5, 3), np.nan)], "NaN"),
        ([np.zeros((5, 3)), np.zeros((5, 2))], "one F"),
        (None, "needs demonstrations"),
    ],
)
def test_unusable_demonstrations_are_refused(demonstrations, message: str) -> None:
    with pytest.raises(SilemError, match=message):
        SILEM("MlpPolicy", make_vec_env("Pendulum-v1", 1), demonstrations)


def test_unknown_transform_is_refused() -> None:
    with pytest.raises(SilemError, match="affine, mlp"):
        make_model("quadratic")


@pytest.mark.parametrize(
    ("transform", "settings", "message"),
    [
        ("affine", dict(transform_l2_form="cubic"), "deviation, plain"),
        ("mlp", dict(transform_l2_scale=1.0), "affine transform's"),
        ("mlp", dict(transform_l2_bias=1.0), "affine transform's"),
    ],
)
def test_unusable_l2_is_refused(transform: str, settings: dict, message: str) -> None:
    with pytest.raises(SilemError, match=message):
        make_model(transform, **settings)


def test_demonstrations_file_round_trip_and_damage(tmp_path) -> None:
    path = tmp_path / "expert.npz"
    saved = Demonstrations(tuple(EXPERT), (1.0, 2.0, 3.0, 4.0), "HC0", "run")
    saved.save(path)
    loaded = Demonstrations.load(path)
    assert (loaded.returns, loaded.body, loaded.expert_run_id) == ((1, 2, 3, 4), "HC0", "run")
    for a, b in zip(loaded.features, EXPERT, strict=True):
        np.testing.assert_array_equal(a, b)
    assert len(loaded.first(2).features) == 2
    with pytest.raises(SilemError, match="1 to 4"):
        loaded.first(5)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(SilemError, match=r"expert\.npz"):
        Demonstrations.load(path)
    np.savez(path, features=np.array([{"a": 1}], dtype=object), lengths=np.array([1]))
    with pytest.raises(SilemError):
        Demonstrations.load(path)
