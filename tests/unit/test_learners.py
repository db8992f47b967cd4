"""The humanoids in numbers: lengths, strength, falls."""

from __future__ import annotations

import numpy as np
import pytest

from silem import bodies
from silem.report import learners

NAMES = bodies.names("humanoid")


def test_humanoid_rs_arms_are_humanoids_scaled() -> None:
    table = learners.overview(NAMES)
    humanoid, uneven = table.loc["Humanoid"], table.loc["HumanoidR"]
    assert uneven["right arm (m)"] == pytest.approx(1.5 * humanoid["right arm (m)"])
    assert uneven["left arm (m)"] == pytest.approx(0.5 * humanoid["left arm (m)"])
    assert uneven["leg (m)"] == humanoid["leg (m)"]
    assert table.loc["Atlas", "mass (kg)"] == pytest.approx(182.4, abs=0.05)
    assert table["motors"].tolist() == [21, 21, 28]


def test_links_of_the_same_mass_are_left_out_of_the_comparison() -> None:
    table = learners.arms("Humanoid", "HumanoidR")
    expected = {f"{side}_{part}_arm" for side in ("left", "right") for part in ("upper", "lower")}
    assert set(table.index) == expected
    assert learners.arms("Humanoid", "Humanoid").empty


def test_strength_is_torque_over_weight_times_leg() -> None:
    table = learners.strength()
    assert table.loc["knee", "Humanoid (N m)"] == 80
    assert table.loc["knee", "Humanoid (%)"] == pytest.approx(
        100 * 80 / (40.844 * 9.81 * 0.7931), rel=1e-3
    )
    assert table.loc["knee", "Atlas (%)"] > 2 * table.loc["knee", "Humanoid (%)"]
    # the page: ankles equal in pitch, half as strong in roll
    ratio = table["Atlas (%)"] / table["Humanoid (%)"]
    assert ratio["ankle, pitch"] == pytest.approx(1, abs=0.05)
    assert ratio["ankle, roll"] == pytest.approx(0.5, abs=0.01)


def test_no_part_of_atlas_has_the_papers_distances() -> None:
    table = learners.trunk_distances()
    off = (table - [0.99, 0.91]).abs().max(axis=1)
    assert off.min() > 0.05
    assert table.loc["utorso"].tolist() == pytest.approx([1.08, 0.98], abs=0.005)


def test_gaps_are_between_learner_and_demonstrator() -> None:
    gaps = learners.gaps()
    assert gaps["paper_hand_Atlas"] == pytest.approx(0.17)
    assert gaps["paper_feet_Humanoid"] == pytest.approx(0.13)
    assert gaps["our_feet_Humanoid"] == pytest.approx(0.127, abs=1e-3)
    # the page: Atlas is closer by ours, by the paper's only at the hands
    assert gaps["our_feet_Atlas"] < gaps["our_feet_Humanoid"]
    assert gaps["our_hand_Atlas"] < gaps["our_hand_Humanoid"]
    assert gaps["paper_hand_Atlas"] < gaps["paper_hand_Humanoid"]
    assert gaps["paper_feet_Atlas"] > gaps["paper_feet_Humanoid"]


def test_a_standing_atlas_lets_its_arms_hang() -> None:
    assert learners.standing_distance_m("Atlas", "left_hand") == pytest.approx(0.62, abs=0.005)


def test_a_limp_body_falls_later_than_one_that_is_shaken() -> None:
    table = learners.falls(["Humanoid"], n_episodes=8, seed=0)
    (row,) = table.to_dict("records")
    assert 0.2 < row["random torques: seconds"] < row["no torques: seconds"] < 2
    assert 0 < row["random torques: return"] < row["no torques: return"] < 20
    assert table.equals(learners.falls(["Humanoid"], n_episodes=8, seed=0))
    assert not table.equals(learners.falls(["Humanoid"], n_episodes=8, seed=1))


def test_heights_are_in_their_order_and_atlas_in_proportion() -> None:
    table = learners.heights(NAMES)
    for _, row in table.iterrows():
        assert row["episode ends below"] < row["counts as standing from"] < row["standing pose"]
    shares = table.div(table["standing pose"], axis=0)
    np.testing.assert_allclose(shares.loc["Atlas"], shares.loc["Humanoid"], atol=1e-3)
