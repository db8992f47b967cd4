"""Episodes that start from a demonstration's states: states the learner's body can be in."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
from stable_baselines3.common.vec_env import VecEnv

from silem import bodies
from silem.bodies import MujocoBody, atlas
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.envs import mujoco as walking
from silem.motion import demonstrations
from silem.motion.demonstrations import Demonstrations, retargeted
from silem.motion.demonstrator import CLIPS, published_motion, published_name
from silem.motion.kinematics import Soles
from silem.motion.retargeting import BODIES, demonstration_states, learner, published_retargeting
from silem.study import evaluate, runs, training
from silem.study.config import RunConfig
from silem.study.settings import BUDGETS, HUMAN
from silem.study.training import make_env, task_options
from silem.util import paths
from silem.util.errors import SilemError

ANKLES = ("l_leg_aky", "l_leg_akx", "r_leg_aky", "r_leg_akx")


def states(body: MujocoBody) -> tuple[np.ndarray, np.ndarray]:
    return demonstration_states(retargeted(HUMAN, body.name), body)


def lowest_soles(body: MujocoBody, qpos: np.ndarray) -> np.ndarray:
    """How high each state's lowest sole is above the floor, (S,)."""
    model = mujoco.MjModel.from_xml_string(body.model_xml())
    return Soles(model, body.skeleton).lowest(qpos).min(axis=1)


@pytest.mark.parametrize("name", BODIES)
def test_states_that_fit_are_the_retargeted_ones(name: str) -> None:
    published = published_retargeting(name)
    qpos, qvel = states(learner(name))
    np.testing.assert_array_equal(qpos, published.qpos)
    np.testing.assert_array_equal(qvel, published.qvel)


def test_ankles_that_turn_less_are_put_to_their_limits() -> None:
    body, published = atlas.body(0.1), published_retargeting("Atlas")
    model = mujoco.MjModel.from_xml_string(body.model_xml())
    ankles = [model.joint(name) for name in ANKLES]
    places = [joint.qposadr[0] for joint in ankles]
    rates = [joint.dofadr[0] for joint in ankles]
    qpos, qvel = states(body)
    assert np.abs(published.qpos[:, places]).max() > 0.29  # what has to be changed
    assert np.abs(qpos[:, places]).max() <= 0.1 + 1e-3
    beyond = np.abs(published.qpos[:, places]) > 0.1 + 1e-3
    np.testing.assert_allclose(np.abs(qpos[:, places][beyond]), 0.1)
    assert (qvel[:, rates][beyond] == 0).all()
    others = np.setdiff1d(np.arange(model.nq), [2, *places])
    np.testing.assert_array_equal(qpos[:, others], published.qpos[:, others])
    other_rates = np.setdiff1d(np.arange(model.nv), rates)
    np.testing.assert_array_equal(qvel[:, other_rates], published.qvel[:, other_rates])


def test_a_body_put_to_its_limits_stands_on_the_floor_not_in_it() -> None:
    body, published = atlas.body(0.1), published_retargeting("Atlas")
    qpos, _ = states(body)
    assert lowest_soles(body, qpos).min() > -1e-5
    lift_m = qpos[:, 2] - published.qpos[:, 2]
    assert lift_m.min() == 0 and 0.01 < lift_m.max() < 0.03
    sunk = qpos.copy()
    sunk[:, 2] = published.qpos[:, 2]
    assert lowest_soles(body, sunk).min() < -0.01  # without the lift


@pytest.fixture
def broken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Name of demonstrations, to be written by the test that uses them."""
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    return retargeted(HUMAN, "Humanoid")


def publish(name: str, about: dict[str, str | float] | None = None, **extra: np.ndarray) -> None:
    features = np.zeros((3, 23), np.float32)
    demonstrations.publish(name, Demonstrations((features,), body="Humanoid", extra=extra), about)


def test_states_of_another_body_are_refused(broken: str) -> None:
    publish(broken, qpos=np.zeros((3, 35)), qvel=np.zeros((3, 34)))
    message = r"hold states of shape \(35,\) and \(34,\); Humanoid needs \(28,\) and \(27,\)"
    with pytest.raises(SilemError, match=message):
        states(bodies.get("Humanoid"))


@pytest.mark.parametrize(("array", "value"), [("qpos", np.nan), ("qvel", np.inf)])
def test_states_that_are_not_finite_are_refused(broken: str, array: str, value: float) -> None:
    arrays = {"qpos": np.zeros((3, 28)), "qvel": np.zeros((3, 27))}
    arrays[array][1, 8] = value
    publish(broken, **arrays)
    with pytest.raises(SilemError, match=f"'{broken}': state 1 holds NaN or infinity"):
        states(bodies.get("Humanoid"))


def test_states_that_are_not_those_in_the_manifest_are_refused(broken: str) -> None:
    arrays = {"qpos": np.zeros((3, 28)), "qvel": np.zeros((3, 27))}
    publish(broken, **arrays)
    changed = Demonstrations((np.ones((3, 23), np.float32),), body="Humanoid", extra=arrays)
    changed.save(demonstrations.file_of(broken))
    with pytest.raises(SilemError, match=r"not the file that manifest\.json .* describes"):
        states(bodies.get("Humanoid"))
    with pytest.raises(SilemError, match=r"not the file that manifest\.json .* describes"):
        published_retargeting("Humanoid")


def test_demonstrations_without_states_give_no_starts() -> None:
    with pytest.raises(SilemError, match="'HC0' hold no states: they lack qpos, qvel"):
        demonstration_states("HC0", learner("Humanoid"))
    with pytest.raises(SilemError, match="cmu_08_99_on_Humanoid"):
        demonstration_states("cmu_08_99_on_Humanoid", learner("Humanoid"))


@pytest.mark.parametrize("name", BODIES)
def test_training_starts_from_them_where_it_is_asked_to(name: str) -> None:
    config = RunConfig.create(name, "silem", starts="demonstration")
    assert isinstance(config.learner, MujocoBody)
    allowed, _ = states(config.learner)
    for starts in ("demonstration", "standing"):
        asked = dataclasses.replace(config.hyper, starts=starts)
        env = make_env(dataclasses.replace(config, hyper=asked))
        try:
            env.reset()
            begun = env.simulation.read().qpos
        finally:
            env.close()
        among = [(allowed == state).all(axis=1).any() for state in begun]
        assert all(among) if starts == "demonstration" else not any(among)


def test_a_runner_has_no_such_starts() -> None:
    config = RunConfig.create("HC0", "silem", starts="demonstration")
    with pytest.raises(SilemError, match="HC0"):
        make_env(config)
    assert not (paths.demonstrations_dir() / f"{retargeted(HUMAN, 'HC0')}.npz").exists()


# ---------------------------------------------------------------- the speed that the task asks for


def test_the_studys_clip_asks_for_what_the_task_always_asked_for() -> None:
    """1.599678 m/s are 1.60; what a humanoid earns in committed runs must not change by a bit."""
    for body in BODIES:
        for method in ("silem", "silem-minus", "tpil", "peng20"):
            asked = task_options(RunConfig.create(body, method))
            assert asked == {"speed_m_s": DEMONSTRATOR_SPEED_M_S}
        assert task_options(RunConfig.create(body, "ppo")) == {}
    assert task_options(RunConfig.create("HC2", "silem")) == {}


def test_every_clip_asks_for_its_own_speed() -> None:
    asked = {
        clip: task_options(RunConfig.create("Humanoid", "silem", published_name(clip)))["speed_m_s"]
        for clip in CLIPS
    }
    for clip, speed_m_s in asked.items():
        assert speed_m_s == pytest.approx(published_motion(clip).speed_m_s, abs=0.0051)
    assert min(asked.values()) < 1.3 and max(asked.values()) > 1.7


@pytest.fixture
def own_walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """A slow walk of one's own, as if it had been published; the states on Humanoid, (3, 28)."""
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    qpos = np.tile(bodies.of_kind("Humanoid", MujocoBody).standing_pose, (3, 1))
    qpos[:, 7] = 0.1, 0.2, 0.3
    publish("my_walk", {"speed_m_s": 0.8049, "capture_rate_hz": 60.0})
    about = {"retargeted_from": "my_walk", "note": "slower on shorter legs"}
    publish(retargeted("my_walk", "Humanoid"), about, qpos=qpos, qvel=np.zeros((3, 27)))
    return qpos


@pytest.mark.parametrize(
    ("method", "name"), [("silem", "my_walk"), ("peng20", "my_walk_on_Humanoid")]
)
def test_an_own_clip_gives_the_task_its_speed_and_episodes_their_starts(
    method: str, name: str, own_walk: np.ndarray
) -> None:
    config = RunConfig.create("Humanoid", method, name, starts="demonstration")
    assert task_options(config) == {"speed_m_s": 0.80}
    env = make_env(config)
    try:
        env.reset()
        begun = env.simulation.read().qpos
        assert all((own_walk == state).all(axis=1).any() for state in begun)
        actions = np.zeros((env.num_envs, env.action_space.shape[0]))
        _, rewards, dones, _ = env.step(actions)
        reading, head_m = env.simulation.read(), bodies.get("Humanoid").standing_head_m
        assert not dones.any()
        np.testing.assert_allclose(rewards, walking.rewards(reading, actions, head_m, 0.8), 1e-6)
        other = walking.rewards(reading, actions, head_m, DEMONSTRATOR_SPEED_M_S)
        assert (rewards > other).all()
    finally:
        env.close()


def test_a_run_is_trained_and_evaluated_on_the_same_task(
    own_walk: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    for module in (training, evaluate):
        make = module.make_vec

        def noting(*args: object, make=make, **options: object) -> VecEnv:
            asked.append(options.get("speed_m_s"))
            return make(*args, **options)

        monkeypatch.setattr(module, "make_vec", noting)
    budget = BUDGETS["tiny"].with_iterations(1)
    runs.run(RunConfig.create("Humanoid", "silem", "my_walk", budget), progress=False)
    assert asked == [0.8, 0.8]


def test_a_policys_episodes_and_ones_own_file_leave_the_task_as_it_is(own_walk: np.ndarray) -> None:
    publish("Humanoid", {"speed_m_s": 1.0})
    Demonstrations((np.zeros((3, 23), np.float32),)).save(demonstrations.file_of("mine"))
    for name in ("Humanoid", "mine"):
        assert task_options(RunConfig.create("Humanoid", "silem", name)) == {}
    publish(retargeted("gone", "Humanoid"), {"retargeted_from": "gone"})
    with pytest.raises(SilemError, match="unknown demonstrations 'gone'"):
        task_options(RunConfig.create("Humanoid", "peng20", retargeted("gone", "Humanoid")))
