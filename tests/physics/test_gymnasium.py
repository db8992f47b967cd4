"""The registered environments pass both checkers, and their pictures show the body."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from contextlib import closing

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from silem import bodies
from silem.envs import Camera, SingleEnv, make_vec
from silem.report.film import why_no_pictures
from silem.util.errors import SilemError
from silem.util.paths import REPO

needs_pictures = pytest.mark.skipif(
    bool(why_no_pictures("HC0")), reason="nothing can be drawn offscreen here"
)


def orange(picture: np.ndarray) -> np.ndarray:
    """Where the links are whose length varies within the family."""
    red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
    return (red > 150) & (red > 1.5 * green) & (red > 2 * blue)


@pytest.mark.parametrize("body", bodies.names())
def test_checkers_have_nothing_to_say(body: str):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # a joint's velocity has no bound, and MuJoCo's observations none in Gymnasium either
        warnings.filterwarnings("ignore", ".*Box observation space (minimum|maximum) value is")
        env = gymnasium.make(f"silem/{body}-v0", render_mode="rgb_array", width=64, height=48)
        check_env(env.unwrapped)
        check_env_sb3(env)
    env.close()


def test_episodes_end_at_1000_steps():
    env = gymnasium.make("silem/HC0-v0")
    assert env.spec is not None
    assert env.spec.max_episode_steps == 1000
    env.reset(seed=0)
    action = np.zeros(6, dtype=np.float32)
    ends = [env.step(action)[2:4] for _ in range(1000)]
    assert ends[:-1] == [(False, False)] * 999
    assert ends[-1] == (False, True)


def test_bad_input_is_refused():
    env = SingleEnv("Ant0", render_mode="rgb_array")
    with pytest.raises(SilemError, match="step before reset"):
        env.step(np.zeros(8))
    with pytest.raises(SilemError, match="render before reset"):
        env.render()
    env.reset(seed=0)
    with pytest.raises(SilemError, match=r"actions of shape \(7,\); expected \(8,\)"):
        env.step(np.zeros(7))
    with pytest.raises(SilemError, match="unknown render mode 'human'; allowed: rgb_array"):
        SingleEnv("Ant0", render_mode="human")
    with pytest.raises(SilemError, match="not positive"):
        Camera(env.body, 0, 48)
    with pytest.raises(SilemError, match="nan m: not positive"):
        Camera(env.body, 64, 48, span_m=float("nan"))


@needs_pictures
def test_longer_torso_is_longer_in_the_picture():
    lengths = []
    for name in bodies.names("halfcheetah"):
        with closing(Camera(bodies.get(name), 320, 240, span_m=5.0)) as camera:
            picture = camera.picture()
        assert picture.shape == (240, 320, 3)
        assert picture.dtype == np.uint8
        columns = np.flatnonzero(orange(picture).any(axis=0))
        lengths.append(columns[-1] - columns[0])
        assert abs((columns[0] + columns[-1]) / 2 - 160) < 20
    assert np.diff(lengths) == pytest.approx(320 / 5, rel=0.15)  # a metre each


@needs_pictures
@pytest.mark.parametrize("name", ["Ant6", "HumanoidR"])
def test_camera_follows_the_body(name: str):
    env = make_vec(name, 1)
    env.picture_size = (160, 120)
    env.reset()
    start = orange(env.render())
    rng = np.random.default_rng(0)
    for _ in range(15):
        env.step(rng.uniform(-1, 1, (1, env.body.action_size)))
    later, qpos = orange(env.render()), env.simulation.pose().copy()
    qpos[:2] += 30, -40
    away = env._camera.picture(qpos)
    assert (start != later).sum() > 20
    for mask in (start, later, orange(away)):
        assert mask.sum() > 60
        assert abs(np.flatnonzero(mask.any(axis=0)).mean() - 80) < 16


@needs_pictures
def test_a_body_casts_a_shadow_wherever_it_is():
    camera = Camera(bodies.get("Ant0"), 160, 120)
    shadows = []
    for way in (0.0, 40.0):
        qpos = camera._at_rest.copy()
        qpos[0] = way
        shadows.append((camera.picture(qpos).max(axis=-1) < 140).sum())
        qpos[2] = -5.0  # below the floor
        shadows.append((camera.picture(qpos).max(axis=-1) < 140).sum())
    camera.close()
    assert min(shadows[0::2]) > 300 and shadows[1::2] == [0, 0]


@needs_pictures
def test_closing_one_camera_leaves_the_others_alone():
    one, two = Camera(bodies.get("HC0"), 64, 48), Camera(bodies.get("Ant0"), 64, 48)
    before = two.picture()
    one.close()
    np.testing.assert_array_equal(two.picture(), before)
    two.close()
    assert np.ptp(before) > 50


def test_without_opengl_pictures_are_refused_and_the_physics_is_not():
    code = (
        "from silem.envs import make_vec; env = make_vec('HC0', 1); env.reset()\n"
        "try:\n    env.render()\nexcept ValueError as error:\n    print(error)\n"
        "print(env.step(env.action_space.sample()[None])[0].shape)"
    )
    told = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"MUJOCO_GL": "disable"},
        cwd=REPO,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert "no offscreen rendering with MUJOCO_GL='disable'" in told
    assert "allowed: egl, osmesa" in told and "(1, 26)" in told


@needs_pictures
def test_pictures_differ_with_the_pose_and_repeat_without_it():
    env = make_vec("HC0", 1, seed=2)
    env.reset()
    first = env.render()
    assert first.shape == (480, 640, 3)
    np.testing.assert_array_equal(env.render(), first)
    env.step(np.ones((1, 6)))
    assert (env.render() != first).any()
    with pytest.raises(SilemError, match="unknown render mode 'human'"):
        env.render("human")


@needs_pictures
def test_taking_pictures_leaves_the_physics_alone():
    watched, alone = make_vec("Ant1", 1), make_vec("Ant1", 1)
    watched.reset()
    alone.reset()
    for action in np.random.default_rng(0).uniform(-1, 1, (20, 1, 8)):
        watched.render()
        np.testing.assert_array_equal(watched.step(action)[0], alone.step(action)[0])
