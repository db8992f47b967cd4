"""What the page on retargeting shows: figures, tables and film, and the claims in its words."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import synthetic_records as synthetic
from drawn import assert_readable, lines_at
from matplotlib.colors import same_color
from matplotlib.patches import Circle
from scipy.optimize import minimize

from silem.bodies.humanoid import ARM_FACTORS
from silem.motion.demonstrator import Motion, published_motion
from silem.motion.features import FEATURES, POINTS
from silem.motion.kinematics import SIDES
from silem.motion.retargeting import (
    BODIES,
    TARGETS,
    TOLERANCE_M,
    IKResult,
    learner,
    published_retargeting,
    standing_feet,
)
from silem.report import film, style
from silem.report.pages import retargeting as page
from silem.report.pages.demonstration import SIDE_COLORS
from silem.report.results import load_records
from silem.study.config import RunConfig
from silem.study.studies import _LARGER_STEPS
from silem.util import files
from silem.util.errors import SilemError

every_body = pytest.mark.parametrize("index", range(len(BODIES)), ids=BODIES)
FIRST_HINGES = {"Atlas": "{0}_arm_shz"}  # of a shoulder; {0} is the side's initial


@pytest.fixture(scope="module")
def human() -> Motion:
    return published_motion("08_01")


@pytest.fixture(scope="module")
def results() -> list[IKResult]:
    return [published_retargeting(body) for body in BODIES]


# ---------------------------------------------------------------- figures


@pytest.mark.parametrize("name", ["poses", "residuals", "foot_skate", "joint_limits"])
def test_texts_neither_overlap_nor_leave_the_figure(
    name: str, human: Motion, results: list[IKResult]
) -> None:
    arguments = {"poses": (human, results[1]), "foot_skate": (human, results)}
    assert_readable(getattr(page, name)(*arguments.get(name, (results,))))


def test_poses_ring_the_hands_targets(human: Motion, results: list[IKResult]) -> None:
    figure = page.poses(human, results[0])
    man, body = figure.axes
    assert not [patch for patch in man.patches if isinstance(patch, Circle)]
    rings = [patch for patch in body.patches if isinstance(patch, Circle)]
    assert len(rings) == 2 * 5
    assert {ring.radius for ring in rings} == {TOLERANCE_M}
    states = np.linspace(0, len(human.points) - 1, 5).round().astype(int)
    for side in SIDES:
        own = [ring for ring in rings if same_color(ring.get_edgecolor(), SIDE_COLORS[side])]
        hands = results[0].points[states, POINTS.index(f"{side}_hand")][:, [0, 2]]
        off = np.linalg.norm([ring.center for ring in own] - hands, axis=1)
        residuals = results[0].residuals[states, TARGETS.index(f"{side}_hand")]
        assert (off <= residuals + 1e-6).all()  # the side view hides a part
        assert off.max() > 0.01


def test_residuals_are_drawn_in_mm_with_the_tolerance(results: list[IKResult]) -> None:
    figure = page.residuals(results)
    assert [axes.get_title(loc="left") for axes in figure.axes] == list(BODIES)
    for axes, result in zip(figure.axes, results, strict=True):
        shown = {line.get_color(): line.get_ydata() for line in axes.lines}
        for side in SIDES:
            column = TARGETS.index(f"{side}_hand")
            expected = 1000 * result.residuals[:, column]
            np.testing.assert_allclose(shown[SIDE_COLORS[side]], expected)
        np.testing.assert_allclose(shown[style.INK], 1000 * result.residuals[:, 0])
        worse_foot = 1000 * result.residuals[:, 3:].max(axis=1)
        assert any(np.allclose(line.get_ydata(), worse_foot) for line in axes.lines)
        assert shown[style.MUTED] == [1000 * TOLERANCE_M] * 2


def test_foot_skate_is_drawn_where_the_mans_feet_stand(
    human: Motion, results: list[IKResult]
) -> None:
    figure = page.foot_skate(human, results)
    stands = standing_feet(human)
    for axes, result in zip(figure.axes, results, strict=True):
        for index, side in enumerate(SIDES):
            his, body = lines_at(axes, SIDE_COLORS[side])
            np.testing.assert_array_equal(body.get_ydata(), result.foot_skate_m_s[:, index])
            np.testing.assert_array_equal(~np.isnan(his.get_ydata()), stands[:, index])
            assert his.get_linewidth() > body.get_linewidth()


def test_joint_limits_show_the_foremost_joints_in_their_sides_colour(
    results: list[IKResult],
) -> None:
    for axes, result in zip(page.joint_limits(results).axes, results, strict=True):
        shares = dict(zip(result.joint_names, 100 * result.at_limit.mean(axis=0), strict=True))
        names = [label.get_text() for label in axes.get_yticklabels()]
        widths = [bar.get_width() for bar in axes.patches]
        assert widths == [shares[name] for name in names] == sorted(widths, reverse=True)
        assert 0 < widths[-1] and widths[-1] >= max(
            share for name, share in shares.items() if name not in names
        )
        for name, bar in zip(names, axes.patches, strict=True):
            side = {"l": "left", "r": "right"}[name[0]]
            assert same_color(bar.get_facecolor(), SIDE_COLORS[side]), name


def test_joints_that_never_meet_a_limit_are_not_drawn(results: list[IKResult]) -> None:
    free = dataclasses.replace(results[0], at_limit=np.zeros_like(results[0].at_limit))
    (axes,) = page.joint_limits([free]).axes
    assert not axes.patches


# ---------------------------------------------------------------- tables


def test_limb_ratios_tell_the_short_arm_from_the_long_one(
    human: Motion, results: list[IKResult]
) -> None:
    table = page.limb_ratios(human, results)
    plain, changed = table.loc["Humanoid's over his"], table.loc["HumanoidR's over his"]
    for side, factor in ARM_FACTORS.items():
        arm = f"{side} arm"
        assert changed[arm] == pytest.approx(factor * plain[arm], rel=1e-6)
    assert changed["leg"] == plain["leg"]
    assert table.loc["the man's, in m", "leg"] == pytest.approx(0.81, abs=0.01)


def test_scales_invert_what_silem_learned_and_quote_the_tools(
    results: list[IKResult], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    empty = page.scales(results, load_records("humanoids"))
    assert empty["by"].str.contains("of SILEM, no run").sum() == len(BODIES)
    record = synthetic.write_record(
        RunConfig.create(
            "HumanoidR", "silem", budget="book", study="humanoids", **dict(_LARGER_STEPS)
        )
    )
    names = [feature.name for feature in FEATURES]
    a = files.read_npz(record.folder / "transform.npz")["A"]
    table = page.scales(results, load_records("humanoids"))
    (learned,) = table[table["by"].str.endswith("one trial")].to_dict("records")
    for limb in ("left_hand", "right_hand"):
        mean = np.mean([a[names.index(f"{limb}_{axis}")] for axis in "xyz"])
        assert learned[limb.replace("_", " ")] == pytest.approx(1 / mean)
    assert learned["left hand"] < 1 < learned["right hand"]  # as the arms are
    measured = table.loc["HumanoidR"].iloc[0]
    assert measured["right hand"] == results[1].ratios.right_arm
    assert list(table.loc["TALOS", ["left hand", "right hand", "feet"]]) == [0.8, 0.8, 1.1]
    assert table["by"].str.contains("github.com/YanjieZe/GMR").sum() == 3


def test_hands_say_how_far_and_whereto_a_hand_is_off(
    human: Motion, results: list[IKResult]
) -> None:
    """A hand 0.2 m outward and 0.1 m forward of its target, made up for a quarter of the frames."""
    side, result = "right", results[0]
    quarter = np.arange(len(human.points)) % 4 == 0
    points, residuals = result.points.copy(), np.zeros_like(result.residuals)
    points[:, POINTS.index("right_hand")] = page.hand_targets(human, result)[:, 1]
    off = 0.1 * human.torso_axes[:, 0] - 0.2 * human.torso_axes[:, 1]
    points[quarter, POINTS.index("right_hand")] += off[quarter]
    residuals[quarter, TARGETS.index("right_hand")] = np.hypot(0.1, 0.2)
    made_up = dataclasses.replace(result, points=points, residuals=residuals)
    table = page.hands(human, [made_up]).set_index("hand")
    row = table.loc[side]
    assert row["worst (mm)"] == pytest.approx(1000 * np.hypot(0.1, 0.2))
    assert row["beyond (%)"] == pytest.approx(100 * quarter.mean())
    assert (row["forward (mm)"], row["outward (mm)"]) == pytest.approx((100, 200))
    assert 0 < row["behind (%)"] < 100
    assert table.loc["left", "beyond (%)"] == 0
    assert np.isnan(table.loc["left", "behind (%)"])


def test_only_joints_of_the_arm_count_as_its_limits(human: Motion, results: list[IKResult]) -> None:
    result = results[0]
    column = result.joint_names.index
    for name, share in (("right_knee", 0), ("left_elbow", 0), ("right_elbow", 100)):
        at_limit = np.zeros_like(result.at_limit)
        at_limit[:, column(name)] = True
        table = page.hands(human, [dataclasses.replace(result, at_limit=at_limit)])
        assert table.set_index("hand").loc["right", "at limit (%)"] == share, name


def test_foot_skate_table_agrees_with_what_is_published(
    human: Motion, results: list[IKResult]
) -> None:
    table = page.foot_skates(human, results)
    assert list(table.index) == ["the man", *BODIES]
    for result in results:
        left = result.foot_skate_m_s[:, 0]
        assert table.loc[result.body, "left mean (m/s)"] == pytest.approx(np.nanmean(left))
        assert table.loc[result.body, "left largest (m/s)"] == pytest.approx(np.nanmax(left))
        ratio = table.loc[result.body] / table.loc["the man"]
        # As the page says: what speed there is comes from the man, scaled by the legs.
        np.testing.assert_allclose(ratio, result.ratios.leg, atol=0.01)


def test_starts_say_that_atlas_alone_has_to_change(results: list[IKResult]) -> None:
    table = page.starts(results).set_index("body")
    assert table["changed"].to_dict() == {"Humanoid": 0, "HumanoidR": 0, "Atlas": 93}
    assert table.loc["Atlas", "joint at most by (rad)"] == pytest.approx(0.2)
    assert table.loc["Atlas", "lifted at most by (mm)"] == pytest.approx(24, abs=1)


# ---------------------------------------------------------------- what the page claims


@every_body
def test_a_hand_is_off_where_its_target_is_behind_and_the_shoulder_at_its_limit(
    index: int, human: Motion, results: list[IKResult]
) -> None:
    result = results[index]
    table = page.hands(human, [result])
    assert (table["behind (%)"] == 100).all()
    assert (table["at limit (%)"] == 100).all()
    assert (table["outward (mm)"] > table["forward (mm)"]).all()
    assert (table["forward (mm)"] > 0).all()
    for side in SIDES:
        hinge = FIRST_HINGES.get(result.body, f"{side}_shoulder1").format(side[0])
        at_limit = result.at_limit[:, result.joint_names.index(hinge)]
        beyond = result.residuals[:, TARGETS.index(f"{side}_hand")] > TOLERANCE_M
        assert at_limit[beyond].all()
        assert at_limit[~beyond].mean() < 0.2


@every_body
def test_frames_fail_by_their_hands_alone(index: int, results: list[IKResult]) -> None:
    hands = [TARGETS.index(f"{side}_hand") for side in SIDES]
    within = (results[index].residuals[:, hands] <= TOLERANCE_M).all(axis=1)
    np.testing.assert_array_equal(results[index].converged, within)


def closest(result: IKResult, side: str, frame: int, target: np.ndarray) -> tuple[float, float]:
    """How far a hand is from its target in a frame, and how far at least, other joints as found."""
    body = learner(result.body)
    model = mujoco.MjModel.from_xml_string(body.model_xml())
    data, hand = mujoco.MjData(model), getattr(body.skeleton, f"{side}_hand")
    arm = rf"{side}_(shoulder|elbow)|{side[0]}_arm_"
    joints = [model.joint(name) for name in result.joint_names if re.match(arm, name)]
    places = [joint.qposadr[0] for joint in joints]
    data.qpos[:] = result.qpos[frame]

    def squared(angles: np.ndarray) -> float:
        data.qpos[places] = angles
        mujoco.mj_kinematics(model, data)
        return float(((data.body(hand).xpos - target) ** 2).sum())

    rng, bounds = np.random.default_rng(0), [tuple(joint.range) for joint in joints]
    starts = [rng.uniform(*np.transpose(bounds)) for _ in range(8)]
    found = [minimize(squared, start, method="L-BFGS-B", bounds=bounds).fun for start in starts]
    return np.sqrt(squared(result.qpos[frame, places])), np.sqrt(min(found))


@every_body
@pytest.mark.parametrize("side", SIDES)
def test_no_pose_of_the_arm_brings_a_hand_much_closer(
    index: int, side: str, human: Motion, results: list[IKResult]
) -> None:
    result = results[index]
    off = result.residuals[:, TARGETS.index(f"{side}_hand")]
    frame = int(off.argmax())
    target = page.hand_targets(human, result)[frame, SIDES.index(side)]
    found, least = closest(result, side, frame, target)
    assert found == pytest.approx(off[frame], rel=0.01)
    assert found - 0.021 < least <= found


# ---------------------------------------------------------------- film


def test_film_shows_the_bodies_beside_the_man_in_real_time(
    human: Motion, results: list[IKResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    if why := film.why_no_pictures("Humanoid"):
        pytest.skip(why)
    monkeypatch.setattr(film, "PANEL", (80, 110))
    clip = page.beside(human, results[:1], 0.1)
    assert clip.frames_per_s == 20
    assert clip.frames.shape == (3, 110, 2 * 80 + 8, 3)
    man, gap, body = np.split(clip.frames, [80, 88], axis=2)
    assert (gap == 255).all()
    assert not np.array_equal(man, body)
    for panel in (man, body):
        assert not np.array_equal(panel[0], panel[-1])


@pytest.mark.parametrize("duration_s", [0.0, -1.0, float("nan")])
def test_film_refuses_a_duration_that_is_not_positive(
    duration_s: float, human: Motion, results: list[IKResult]
) -> None:
    with pytest.raises(SilemError, match="duration_s must be a number above 0"):
        page.beside(human, results, duration_s)
