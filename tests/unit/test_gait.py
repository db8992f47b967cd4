"""How a gait is measured, on features made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from silem.envs import bullet, make_vec
from silem.motion.demonstrations import Demonstrations
from silem.report.transforms import feature_names
from silem.study import evaluate
from silem.util.errors import SilemError

NAMES = feature_names("HC0")


def states(n: int = 10, **values: float | list[float]) -> np.ndarray:
    """States of HC0 that are zero but for the features named, with _ for a blank."""
    features = np.zeros((n, len(NAMES)), np.float32)
    for name, value in values.items():
        features[:, NAMES.index(name.replace("_", " "))] = value
    return features


def measured(*features: np.ndarray, returns: tuple[float, ...] = ()) -> evaluate.Gait:
    return evaluate.gait(Demonstrations(features, returns, "HC0"))


def test_speed_is_the_forward_velocity_in_metres_per_second() -> None:
    slow, fast = states(forward_velocity=0.3), states(30, forward_velocity=0.9)
    assert measured(slow, fast).speed_m_s == pytest.approx((10 * 1 + 30 * 3) / 40)
    assert measured(states(vertical_velocity=0.9, sideways_velocity=0.9)).speed_m_s == 0


def test_pitch_is_taken_over_all_states_and_roll_is_not_it() -> None:
    shown = measured(states(4, pitch=[0.1, 0.3, 0.1, 0.3]), states(4, pitch=0.2))
    assert shown.pitch_rad == pytest.approx(0.2)
    assert shown.pitch_std_rad == pytest.approx(0.1 / 2**0.5)
    assert measured(states(roll=0.4)).pitch_rad == 0


def test_joints_are_at_their_limits_beyond_99_hundredths_on_either_side() -> None:
    angle = [0.995, -0.995, 0.985, -0.985, 0, 0, 0, 0, 0, 0]
    shown = states(back_thigh_angle=angle, front_foot_angle=[1, 0, 0, 0, 0, 0, 0, 0, 0, -1])
    counts = evaluate.joints_at_limit(shown, "HC0")
    assert counts.tolist() == [2, 1, 0, 0, 0, 0, 0, 0, 0, 1]
    assert measured(shown).limit_share == pytest.approx(0.3)
    assert measured(shown).joints_at_limit == pytest.approx(0.4)
    # a fast joint or a touching foot is not at a limit
    assert measured(states(back_thigh_velocity=2.0, back_foot_contact=1.0)).limit_share == 0


def test_the_limit_is_the_one_that_the_task_charges() -> None:
    assert bullet.AT_LIMIT == evaluate.AT_LIMIT
    env = make_vec("HC0", n_envs=1, seed=0)
    env.reset()
    joints = env.body.motors
    for _ in range(60):
        features = env.step(np.ones((1, len(joints)), np.float32))[0]
    env.close()
    by_name = [features[0, NAMES.index(name)] for name in NAMES if name.endswith("angle")]
    expected = sum(abs(angle) > 0.99 for angle in by_name)
    assert evaluate.joints_at_limit(features, "HC0").tolist() == [expected]
    assert expected > 0


def test_an_episode_failed_if_it_returns_less_than_half_of_the_median() -> None:
    assert evaluate.failed(np.array([2000.0, 2100, 999, 2000])).tolist() == [
        False,
        False,
        True,
        False,
    ]
    assert not evaluate.failed(np.array([-100.0, -140, -120])).any()
    assert evaluate.failed(np.array([-100.0, -100, -151])).tolist() == [False, False, True]
    shown = measured(*[states()] * 3, returns=(2000.0, 600.0, 2100.0))
    assert (shown.return_worst, shown.n_failed) == (600.0, 1)
    assert measured(states())[-2:] == (None, None)


def test_what_has_no_gait_is_refused() -> None:
    with pytest.raises(SilemError, match="not on Humanoid"):
        evaluate.joints_at_limit(np.zeros((3, 23)), "Humanoid")
    with pytest.raises(SilemError, match="7 features, HC0 has 26"):
        evaluate.joints_at_limit(np.zeros((3, 7)), "HC0")
