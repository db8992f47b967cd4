"""The registered environments pass both checkers, and their pictures show the body."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_sb3

from silem import bodies
from silem.envs import BulletEnv, Camera, make_vec
from silem.envs.bullet.camera import hit_capsule
from silem.util.errors import SilemError


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
    env = BulletEnv("Ant0", render_mode="rgb_array")
    with pytest.raises(SilemError, match="step before reset"):
        env.step(np.zeros(8))
    with pytest.raises(SilemError, match="render before reset"):
        env.render()
    env.reset(seed=0)
    with pytest.raises(SilemError, match=r"actions of shape \(7,\); expected \(8,\)"):
        env.step(np.zeros(7))
    with pytest.raises(SilemError, match="unknown render mode 'human'; allowed: rgb_array"):
        BulletEnv("Ant0", render_mode="human")
    with pytest.raises(SilemError, match="not positive"):
        Camera(env._simulator, 0, 48)


def test_longer_torso_is_longer_in_the_picture():
    lengths = []
    for name in bodies.names("halfcheetah"):
        env = make_vec(name, 1)
        env.reset()
        picture = Camera(env.simulators[0], 320, 240, span_m=5.0).picture()
        assert picture.shape == (240, 320, 3)
        assert picture.dtype == np.uint8
        columns = np.flatnonzero(orange(picture).any(axis=0))
        lengths.append(columns[-1] - columns[0])
        assert abs((columns[0] + columns[-1]) / 2 - 160) < 20
    assert np.diff(lengths) == pytest.approx(320 / 5, rel=0.15)  # a metre each


def test_camera_follows_the_body():
    env = make_vec("Ant6", 1)
    env.reset()
    camera = Camera(env.simulators[0], 160, 120)
    start = orange(camera.picture())
    rng = np.random.default_rng(0)
    for _ in range(60):
        env.step(rng.uniform(-1, 1, (1, 8)))
    later = orange(camera.picture())
    assert (start != later).sum() > 20
    for mask in (start, later):
        assert mask.sum() > 100
        assert abs(np.flatnonzero(mask.any(axis=0)).mean() - 80) < 16


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


def test_taking_pictures_leaves_the_physics_alone():
    watched, alone = make_vec("Ant1", 1), make_vec("Ant1", 1)
    watched.reset()
    alone.reset()
    for action in np.random.default_rng(0).uniform(-1, 1, (20, 1, 8)):
        watched.render()
        np.testing.assert_array_equal(watched.step(action)[0], alone.step(action)[0])


def test_rays_hit_side_caps_and_spheres_where_geometry_says():
    eye = np.array([0.0, -5.0, 0.0])
    start, end = np.array([-1.0, 0, 0]), np.array([1.0, 0, 0])
    targets = np.array([[0, 0, 0], [1.1, 0, 0], [2.0, 0, 0], [0, 0, 0.3]], dtype=float)
    rays = targets - eye
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hit, depth, normals = hit_capsule(eye, rays, start, end, 0.2)
    assert hit.tolist() == [True, True, False, False]
    assert depth[0] == pytest.approx(5 - 0.2)
    np.testing.assert_allclose(normals[0], [0, -1, 0], atol=1e-9)
    on_cap = eye + depth[1] * rays[1]
    assert np.linalg.norm(on_cap - end) == pytest.approx(0.2)
    np.testing.assert_allclose(normals[1], (on_cap - end) / 0.2, atol=1e-9)
    hit, depth, _ = hit_capsule(eye, rays[:1], np.zeros(3), np.zeros(3), 0.5)
    assert hit.all()
    assert depth[0] == pytest.approx(4.5, abs=1e-3)
    behind, *_ = hit_capsule(eye, -rays[:1], start, end, 0.2)
    assert not behind.any()
