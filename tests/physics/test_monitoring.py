"""What stable-baselines3 and Gymnasium see of our environments: monitors, attributes, videos."""

from __future__ import annotations

import importlib.util
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo, TimeLimit
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecMonitor, VecVideoRecorder

from silem.envs import BatchedEnv, SingleEnv, make_vec
from silem.report.film import why_no_pictures
from silem.util.errors import SilemError

needs_moviepy = pytest.mark.skipif(
    importlib.util.find_spec("moviepy") is None, reason="environment.txt's moviepy is missing"
)


class Steady:
    """Acts by a fixed list of numbers."""

    def __init__(self, env: BatchedEnv) -> None:
        self._actions = np.tile(np.linspace(-1, 1, env.body.action_size), (env.num_envs, 1))

    def predict(self, observation: Any, **_: Any) -> tuple[np.ndarray, None]:
        return self._actions.astype(np.float32), None


def by_hand(env: BatchedEnv, n_episodes: int) -> tuple[list[float], list[int]]:
    """Returns and lengths of the first episodes of one environment, summed here."""
    policy, returns, lengths = Steady(env), [0.0], [0]
    observations = env.reset()
    while len(lengths) <= n_episodes:
        observations, rewards, dones, _ = env.step(policy.predict(observations)[0])
        returns[-1] += float(rewards[0])
        lengths[-1] += 1
        if dones[0]:
            returns.append(0.0)
            lengths.append(0)
    return returns[:-1], lengths[:-1]


@pytest.mark.parametrize("body", ["HC0", "Humanoid"])
def test_evaluate_policy_has_nothing_to_warn_of_and_sums_right(body: str):
    wanted = by_hand(make_vec(body, 1, seed=3, max_steps=30), 4)
    env = make_vec(body, 1, seed=3, max_steps=30)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        returns, lengths = evaluate_policy(
            Steady(env), env, n_eval_episodes=4, return_episode_rewards=True
        )
    assert returns == pytest.approx(wanted[0], rel=1e-5)
    assert lengths == wanted[1]
    assert (np.diff(lengths) != 0).any() == (body == "Humanoid")  # which falls, here and there


def test_an_episodes_info_is_what_a_monitor_would_write():
    ours, watched = make_vec("Humanoid", 2, seed=1), make_vec("Humanoid", 2, seed=1)
    assert ours.env_is_wrapped(Monitor) == [True, True]
    assert ours.env_is_wrapped(TimeLimit, indices=1) == [False]
    with pytest.warns(UserWarning, match="already wrapped with a `Monitor`"):
        monitored = VecMonitor(watched)
    ours.reset()
    monitored.reset()
    n_ended = 0
    for actions in np.random.default_rng(0).uniform(-1, 1, (60, 2, 21)).astype(np.float32):
        *_, dones, infos = ours.step(actions)
        *_, theirs = monitored.step(actions)
        for index in np.flatnonzero(dones):
            mine, other = infos[index]["episode"], theirs[index]["episode"]
            assert mine["r"] == pytest.approx(other["r"], rel=1e-5)
            assert mine["l"] == other["l"]
            n_ended += 1
    assert n_ended > 2


@pytest.mark.parametrize(("body", "fps"), [("HC0", 61), ("Humanoid", 40)])
def test_attributes_and_metadata(body: str, fps: int):
    env = make_vec(body, 3)
    single = gymnasium.make(f"silem/{body}-v0", render_mode="rgb_array")
    assert env.metadata == single.metadata == {"render_modes": ["rgb_array"], "render_fps": fps}
    assert env.get_attr("metadata", indices=[0, 2]) == [env.metadata] * 2
    assert env.get_attr("render_mode") == ["rgb_array"] * 3
    assert env.has_attr("max_steps") and not env.has_attr("gravity")
    env.set_attr("picture_size", (64, 48))
    assert env.get_attr("picture_size", indices=1) == [(64, 48)]
    env.reset()
    if not why_no_pictures(body):
        assert env.render().shape == (48, 64, 3)
    with pytest.raises(SilemError, match="'picture_size' is shared"):
        env.set_attr("picture_size", (8, 8), indices=[0])
    with pytest.raises(SilemError, match="no attribute 'gravity'"):
        env.set_attr("gravity", 1)
    with pytest.raises(SilemError, match="no environments with a method 'reset'"):
        env.env_method("reset")


def test_render_modes_that_there_are_not():
    with pytest.raises(SilemError, match="unknown render mode 'human'; allowed: rgb_array"):
        make_vec("HC0", render_mode="human")
    blind = make_vec("HC0", 1, render_mode=None)
    blind.reset()
    with pytest.raises(SilemError, match="no pictures with render_mode None"):
        blind.render()
    env = make_vec("HC0", 1)
    env.reset()
    for mode in ("human", "depth_array"):
        with pytest.raises(SilemError, match=f"unknown render mode '{mode}'; allowed: rgb_array"):
            env.render(mode)


def frames(path: Path) -> list[np.ndarray]:
    from imageio_ffmpeg import read_frames

    reader = read_frames(str(path))
    size = next(reader)["size"]
    return [np.frombuffer(frame, np.uint8).reshape(size[1], size[0], 3) for frame in reader]


@needs_moviepy
def test_vec_video_recorder_records(tmp_path: Path):
    env = make_vec("HC0", 2)
    env.picture_size = (128, 96)
    recorder = VecVideoRecorder(env, str(tmp_path), lambda step: step == 0, video_length=12)
    recorder.reset()
    for actions in np.random.default_rng(0).uniform(-1, 1, (14, 2, 6)).astype(np.float32):
        recorder.step(actions)
    recorder.close()
    (path,) = tmp_path.glob("*.mp4")
    pictures = frames(path)
    assert len(pictures) in (12, 13)
    assert pictures[0].shape == (96, 128, 3)
    assert np.abs(pictures[0].astype(int) - pictures[-1]).max() > 50  # it moves


@needs_moviepy
def test_record_video_records(tmp_path: Path):
    env = RecordVideo(
        gymnasium.make("silem/Ant0-v0", render_mode="rgb_array", width=128, height=96),
        str(tmp_path),
        episode_trigger=lambda episode: True,
        video_length=10,
        disable_logger=True,
    )
    env.reset(seed=0)
    for actions in np.random.default_rng(0).uniform(-1, 1, (12, 8)).astype(np.float32):
        env.step(actions)
    env.close()
    (path,) = tmp_path.glob("*.mp4")
    assert len(frames(path)) in (10, 11)


def test_a_recorder_is_told_why_there_are_no_pictures(tmp_path: Path):
    single = SingleEnv("HC0")
    single.reset(seed=0)
    assert single.render() is None
    with pytest.raises(ValueError, match="Render mode is None"):
        RecordVideo(single, str(tmp_path))
