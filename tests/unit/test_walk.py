"""How walking is measured, on gaits made by hand: their cadence, stance, clearance and symmetry."""

from __future__ import annotations

import numpy as np
import pytest

from silem.motion import gait
from silem.motion.demonstrator import published_motion
from silem.motion.features import FEATURES
from silem.util.errors import SilemError

NAMES = [feature.name for feature in FEATURES]
RATE_HZ = 40.0


def states(n: int, **values: float | np.ndarray) -> np.ndarray:
    """States of a body that stands, its feet 0.8 m below its torso, but for the features named."""
    features = np.zeros((n, len(FEATURES)), np.float32)
    for name, value in {"torso_vertical_z": 1.0, "left_foot_z": -0.8, "right_foot_z": -0.8}.items():
        features[:, NAMES.index(name)] = value
    for name, value in values.items():
        features[:, NAMES.index(name)] = value
    return features


def foot(
    cycles: np.ndarray, stance: float = 0.6, length_m: float = 0.6, lift_m: float = 0.15
) -> tuple[np.ndarray, np.ndarray]:
    """Return x and z of a foot over strides: it goes back on the floor, then forward and up."""
    part = cycles % 1.0
    swing = np.maximum(part - stance, 0.0) / (1 - stance)
    x = length_m * np.where(part < stance, 0.5 - part / stance, swing - 0.5)
    return x, -0.8 + lift_m * np.sin(np.pi * swing)


def walking(
    stride_hz: float = 1.0, phase: float = 0.5, duration_s: float = 20.0, **right: float
) -> np.ndarray:
    """States of a walk; the right foot is `phase` of a stride behind the left, and may differ."""
    cycles = 0.3 + stride_hz * np.arange(round(duration_s * RATE_HZ)) / RATE_HZ
    (lx, lz), (rx, rz) = foot(cycles), foot(cycles - phase, **right)
    return states(len(cycles), left_foot_x=lx, left_foot_z=lz, right_foot_x=rx, right_foot_z=rz)


def test_an_even_walk_is_measured_as_it_was_made() -> None:
    found = gait.walk(walking(stride_hz=0.8), RATE_HZ)
    assert found.step_hz == pytest.approx(1.6, abs=0.06)
    assert found.stance_left == pytest.approx(0.6, abs=0.03)
    assert found.stance_right == pytest.approx(0.6, abs=0.03)
    assert found.clearance_m == pytest.approx(0.15, abs=0.01)
    assert found.symmetry > 0.95


@pytest.mark.parametrize("stride_hz", [0.5, 1.0, 1.5])
def test_cadence_is_twice_the_strides(stride_hz: float) -> None:
    found = gait.walk(walking(stride_hz), RATE_HZ)
    assert found.step_hz == pytest.approx(2 * stride_hz, rel=0.04)


def test_a_sinusoid_stands_for_half_of_its_period() -> None:
    t = np.arange(800) / RATE_HZ
    feet = {
        "left_foot_x": 0.3 * np.sin(2 * np.pi * t),
        "right_foot_x": -0.3 * np.sin(2 * np.pi * t),
    }
    found = gait.walk(states(800, **feet), RATE_HZ)
    assert (found.stance_left, found.step_hz) == (pytest.approx(0.5), pytest.approx(2, abs=0.06))
    assert found.clearance_m == 0 and found.symmetry == pytest.approx(1.0)


def test_who_stands_or_trembles_makes_no_steps() -> None:
    rng = np.random.default_rng(0)
    tremble = 0.2 * gait.MIN_SWING_M * rng.standard_normal(800).clip(-2, 2)
    for body in (states(800), states(800, left_foot_x=tremble), states(1)):
        found = gait.walk(body, RATE_HZ)
        assert found.step_hz == 0 and np.isnan(found[1:]).all()
    falls = states(80, left_foot_x=np.linspace(0, 0.7, 80), right_foot_x=np.linspace(0, 0.6, 80))
    assert gait.walk(falls, RATE_HZ).step_hz == 0  # both feet stay behind a body that topples


@pytest.mark.parametrize(
    ("limp", "least", "most"),
    [
        ({"phase": 0.3}, 0.3 / 0.7 - 0.08, 0.3 / 0.7 + 0.08),  # one step is quicker than the other
        ({"length_m": 0.3}, 0.45, 0.55),  # the right foot goes half as far
        ({"stance": 0.4}, 0.5, 0.75),  # and stands less long
        ({"length_m": 0.01}, 0.0, 0.0),  # or is dragged
    ],
)
def test_a_limp_is_uneven_on_either_side(limp: dict[str, float], least: float, most: float) -> None:
    lame = walking(**limp)
    swapped = lame.copy()
    sides = [[NAMES.index(f"{side}_foot_{axis}") for axis in "xyz"] for side in ("left", "right")]
    swapped[:, sides[0] + sides[1]] = lame[:, sides[1] + sides[0]]
    for body in (lame, swapped):
        assert least <= gait.walk(body, RATE_HZ).symmetry <= most


def test_leaning_changes_no_measure() -> None:
    upright, lean = walking(), np.deg2rad(20)
    turn = np.array([[np.cos(lean), 0, -np.sin(lean)], [0, 1, 0], [np.sin(lean), 0, np.cos(lean)]])
    leaning = upright.copy()
    for name in ("left_foot", "right_foot", "torso_vertical"):
        columns = [NAMES.index(f"{name}_{axis}") for axis in "xyz"]
        leaning[:, columns] = upright[:, columns] @ turn.T
    assert not np.allclose(leaning, upright)
    np.testing.assert_allclose(gait.walk(leaning, RATE_HZ), gait.walk(upright, RATE_HZ), atol=1e-5)


def test_the_mans_walk_is_a_mans() -> None:
    """Men walk with two steps a second and stand on each foot for 60 % of a stride."""
    found = gait.walk(published_motion("08_01").features, RATE_HZ)
    assert found.step_hz == pytest.approx(2.0, abs=0.1)
    assert (found.stance_left, found.stance_right) == pytest.approx((0.59, 0.59), abs=0.03)
    assert found.symmetry > 0.9 and 0.1 < found.clearance_m < 0.2


def test_distance_is_zero_to_itself_at_half_to_twice_its_pace_and_in_deviations() -> None:
    shown = walking(duration_s=3.0)
    assert gait.distance(shown[20:100], shown, RATE_HZ) == 0
    assert gait.distance(shown[::2], shown, RATE_HZ) == pytest.approx(0, abs=1e-6)
    slower = np.repeat(shown, 2, axis=0)
    assert gait.distance(slower, shown, RATE_HZ) == 0
    assert gait.distance(np.repeat(shown, 4, axis=0), shown, RATE_HZ) > 0.1
    away, column = shown.copy(), NAMES.index("left_foot_x")
    away[:, column] += 3 * shown[:, column].std()
    n_varied = int((shown.std(axis=0) > 0).sum())
    assert 0.5 < gait.distance(away, shown, RATE_HZ) * n_varied < 3.01
    still = np.repeat(shown[40:41], 100, axis=0)
    assert gait.distance(still, shown, RATE_HZ) > 0.3  # one of the states, but it goes nowhere
    assert gait.distance(shown[::-1], shown, RATE_HZ) > 0.1  # nor is it walking backward
    # a feature that never varies in the demonstration has no unit, and does not count
    raised = shown + 1.0 * (np.arange(len(FEATURES)) == NAMES.index("head_height"))
    assert gait.distance(raised, shown, RATE_HZ) == 0


def test_features_of_other_bodies_are_refused() -> None:
    with pytest.raises(SilemError, match=r"shape \(5, 26\); allowed: \(T, 23\)"):
        gait.walk(np.zeros((5, 26)), RATE_HZ)
    with pytest.raises(SilemError, match="allowed"):
        gait.distance(walking(), np.zeros((0, 23)), RATE_HZ)
