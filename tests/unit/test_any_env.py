"""Any Gymnasium environment goes through the same runs and records as the paper's bodies."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from silem import SILEM, bodies
from silem.envs import WithFeatures, make_vec
from silem.motion.demonstrations import Demonstrations, file_of
from silem.study import verify
from silem.study.config import RunConfig
from silem.study.evaluate import evaluate, load_policy
from silem.study.runs import run
from silem.util.errors import SilemError

SMALL = {"minibatch_size": 32, "n_epochs": 1}


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    rng = np.random.default_rng(0)
    episodes = [rng.normal(size=(201, 3)).astype(np.float32) for _ in range(20)]
    Demonstrations.of(episodes).save(file_of("swing"))
    return tmp_path


def test_an_imitator_on_pendulum_is_recorded_and_found_again(data: Path) -> None:
    config = RunConfig.create("Pendulum-v1", "silem", "swing", **SMALL)
    record = run(config, progress=False)
    assert len(record.evaluation["returns"]) == 2
    assert record.evaluation["speed_m_s"] is None
    assert run(config, progress=False) == record
    assert RunConfig.from_dict(record.config) == config
    again = run(RunConfig.create("Pendulum-v1", "silem", "swing", **SMALL), False, force=True)
    assert again.evaluation["returns"] == record.evaluation["returns"]  # bit for bit
    assert again.files == record.files
    policy = load_policy(record)
    assert policy.action_space == spaces.Box(-2.0, 2.0, (1,))  # Pendulum's, not a body's
    assert evaluate(policy, "Pendulum-v1", 2).returns == record.evaluation["returns"]
    verdict = verify.verify(record.folder)
    assert verdict.outcome == verify.EXACT, verdict


def test_features_of_ones_own_are_compared_and_the_observation_is_acted_on(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def make() -> gymnasium.Env:
        return WithFeatures(gymnasium.make("Pendulum-v1").unwrapped, lambda seen: seen[[2, 0]])

    name = "Swinging-v0"
    monkeypatch.setattr(gymnasium.envs.registration, "registry", dict(gymnasium.registry))
    gymnasium.register(name, entry_point=make, max_episode_steps=200)
    env = make_vec(name, 2)
    seen = env.reset()
    features = [info["skeletal_features"] for info in env.reset_infos]
    np.testing.assert_array_equal(features, seen[:, [2, 0]])
    seen, _, _, infos = env.step(np.zeros((2, 1)))
    np.testing.assert_array_equal([i["skeletal_features"] for i in infos], seen[:, [2, 0]])
    shown = Demonstrations.of([np.zeros((50, 2), np.float32)])
    model = SILEM("MlpPolicy", env, shown, n_steps=32).learn(64)
    assert model.transform_net.scale.shape == (2,) and model.observation_space.shape == (3,)
    assert evaluate(model, name, 2, model=model).disc_reward_mean > 0


def test_a_record_of_a_modules_environment_is_told_to_import_it(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gymnasium.envs.registration, "registry", dict(gymnasium.registry))
    pendulum = gymnasium.spec("Pendulum-v1").entry_point
    gymnasium.register("Mine-v0", entry_point=pendulum, max_episode_steps=200)
    record = run(RunConfig.create("Mine-v0", "random"), progress=False)
    assert verify.verify(record.folder).outcome == verify.EXACT
    gymnasium.envs.registration.registry.pop("Mine-v0")
    assert "--import" in verify.verify(record.folder).why


def test_random_actions_fit_the_environment(data: Path) -> None:
    assert bodies.get("Pendulum-v1").action_size == 1
    assert run(RunConfig.create("Pendulum-v1", "random"), progress=False).evaluation["returns"]


def test_what_cannot_be_imitated_is_refused(data: Path) -> None:
    with pytest.raises(SilemError, match="Pendulum-v1 needs demonstrations"):
        RunConfig.create("Pendulum-v1", "silem")
    with pytest.raises(SilemError, match="no Gymnasium environment 'Nothing-v7'"):
        RunConfig.create("Nothing-v7", "ppo")
    with pytest.raises(SilemError, match="features per state"):
        run(RunConfig.create("MountainCarContinuous-v0", "silem", "swing", **SMALL), False)
