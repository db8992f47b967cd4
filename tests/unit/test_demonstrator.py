"""Posing clips: made-up ones, the published ones, and CMU's where they are at hand."""

from __future__ import annotations

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest
from synthetic_clips import UNIT_M, Files, frame_of, joints, skeleton_text, walk

from silem.cli import main
from silem.motion import clips, demonstrator, kinematics, retargeting
from silem.motion import demonstrations as demos
from silem.motion.clips import read_amc, read_asf
from silem.motion.demonstrations import retargeted
from silem.motion.features import POINTS, skeletal_features
from silem.study.config import RunConfig
from silem.study.runs import load_demonstrations
from silem.util import files, paths
from silem.util.errors import SilemError

RAW = Path(os.environ.get(clips.ENV) or paths.REPO.parent / "shared" / "data" / "cmu_mocap")
needs_raw = pytest.mark.skipif(
    not (RAW / "08" / "08.asf").is_file(), reason=f"CMU's raw clips are not in {RAW}"
)


@pytest.fixture
def man(tmp_path: Path) -> Files:
    return Files(tmp_path)


def test_a_skeleton_that_is_not_the_models_is_refused(man: Files) -> None:
    for columns, message in (
        ([name for name in man.columns if name != "rtibiarx"], "lacks axis rx of bone 'rtibia'"),
        ([*man.columns, "tailrx"], "has too much axis rx of bone 'tail'"),
    ):
        man.columns = columns
        man.asf.write_text(skeleton_text(columns))
        with pytest.raises(SilemError, match=message):
            man.pose(walk)


def depth_m(qpos: np.ndarray) -> float:
    """How deep the feet are below the floor at most, by MuJoCo's own contacts, to 1 cm above it."""
    model = demonstrator.model()
    data = mujoco.MjData(model)
    deepest = -0.01
    for row in qpos:
        data.qpos[:] = row
        data.qpos[2] -= 0.01
        mujoco.mj_forward(model, data)
        on_floor = (data.contact.geom == model.geom("floor").id).any(axis=1)
        deepest = max([deepest, *(-data.contact.dist[on_floor] - 0.01)])
    return deepest


def test_a_gliding_man_moves_forward_on_a_level_floor(man: Files) -> None:
    motion = man.pose(walk)
    assert motion.features.shape == (21, 23)
    assert (motion.duration_s, motion.speed_m_s) == (0.5, pytest.approx(1.5))
    assert np.allclose(motion.com_velocity, [1.5, 0, 0], atol=1e-9)
    assert np.allclose(motion.qpos[:, 0], 1.5 * np.arange(21) / 40)
    assert np.allclose(motion.torso_axes, np.eye(3))
    assert np.allclose(motion.features, motion.features[0], atol=1e-6)
    assert depth_m(motion.qpos[:1]) == pytest.approx(0, abs=1e-6)


def test_a_sloping_floor_is_levelled(man: Files) -> None:
    def uphill(frame: int, bone: str, index: int) -> float:
        climb = 0.02 * walk(frame, bone, 2) if (bone, index) == ("root", 1) else 0.0
        return walk(frame, bone, index) + climb

    assert np.ptp(man.pose(uphill).points[:, 1, 2]) == pytest.approx(0.02 * 1.5 * 0.5)
    level = man.pose(uphill, floor_slope=0.02)
    assert np.ptp(level.points[:, 1, 2]) == pytest.approx(0, abs=1e-9)
    assert level.speed_m_s == pytest.approx(1.5 * np.hypot(1, 0.02))
    assert level.torso_axes[0, 0, 2] == pytest.approx(-np.sin(np.arctan(0.02)))


def test_one_joint_moves_one_limb_the_right_way(man: Files) -> None:
    straight = man.pose(walk).points[0]
    for side, other in (("left", "right"), ("right", "left")):
        joint = f"{side[0]}tibia"
        bent = man.pose(lambda f, b, i, joint=joint: 60.0 if b == joint else walk(f, b, i))
        name = POINTS.index(f"{side}_foot")
        assert bent.points[0, name, 0] < straight[name, 0] - 0.2  # heels go back
        unmoved = POINTS.index(f"{other}_foot")
        assert np.allclose(
            bent.points[0, unmoved] - bent.points[0, 0], straight[unmoved] - straight[0]
        )


def test_left_is_on_the_left_and_turning_left_turns_left(man: Files) -> None:
    def turning(frame: int, bone: str, index: int) -> float:
        return frame * 0.5 if (bone, index) == ("root", 4) else walk(frame, bone, index)

    motion = man.pose(turning)
    left, right = POINTS.index("left_hand"), POINTS.index("right_hand")
    assert motion.points[0, left, 1] > 0.3 and motion.points[0, right, 1] < -0.3
    heading = np.unwrap(np.arctan2(motion.torso_axes[:, 0, 1], motion.torso_axes[:, 0, 0]))
    assert np.allclose(heading, np.deg2rad(1.5) * np.arange(21))  # a steady turn, also resampled
    assert np.allclose(motion.qvel[:, 4], np.deg2rad(60))  # about the root's own upward axis


def test_resampling_keeps_captured_poses_and_interpolates_between(man: Files) -> None:
    def bending(frame: int, bone: str, index: int) -> float:
        return (frame % 4) * 10.0 if bone == "ltibia" else walk(frame, bone, index)

    knee = 7 + joints().index("ltibiarx")
    at_40, at_120 = man.pose(bending, rate_hz=40.0), man.pose(bending, rate_hz=120.0)
    assert np.allclose(at_40.qpos, at_120.qpos[::3])
    assert np.allclose(np.rad2deg(at_120.qpos[:5, knee]), [0, 10, 20, 30, 0])
    at_80 = man.pose(bending, rate_hz=80.0)
    assert np.allclose(np.rad2deg(at_80.qpos[:3, knee]), [0, 15, 30])
    for rate_hz in (0.0, 121.0, float("nan")):
        with pytest.raises(SilemError, match=r"cannot resample 120\.0 Hz to .* up to the rate of"):
            man.pose(walk, rate_hz=rate_hz)
    for capture_rate_hz in (30.0, 0.0, -120.0, float("inf"), float("nan")):
        with pytest.raises(SilemError, match=rf"cannot resample {capture_rate_hz} Hz to 40\.0 Hz"):
            man.pose(walk, capture_rate_hz=capture_rate_hz)
    with pytest.raises(SilemError, match=r"2 states at 40\.0 Hz; allowed: 3"):
        man.pose(walk, n_frames=6)


def test_a_clip_of_half_the_rate_has_the_same_speed(man: Files) -> None:
    """Files do not say their rate: taken for 120 Hz, a clip of 60 Hz is twice as fast."""

    def at_60_hz(frame: int, bone: str, index: int) -> float:
        return walk(2 * frame, bone, index)

    right = man.pose(at_60_hz, 31, capture_rate_hz=60.0)
    assert (right.duration_s, right.speed_m_s) == (0.5, pytest.approx(1.5))
    assert np.allclose(right.features, man.pose(walk).features, atol=1e-5)
    assert man.pose(at_60_hz, 31).speed_m_s == pytest.approx(3.0)
    with pytest.raises(SilemError, match=r"7 frames in a row only repeat .* allowed: 6"):
        man.pose(lambda f, b, i: at_60_hz(max(f, 7), b, i), 31, capture_rate_hz=60.0)

    def jump(frame: int, bone: str, index: int) -> float:
        ahead = (bone, index) == ("root", 0) and frame >= 15
        return at_60_hz(frame, bone, index) + (ahead and 4.0)  # 0.23 m: 14 m/s for a frame

    with pytest.raises(SilemError, match=r"at frame 16: .* 13\.5 m/s .* allowed: 10\.0 m/s"):
        man.pose(jump, 31, capture_rate_hz=60.0)


@pytest.mark.parametrize("heading_deg", [0, 90, -135, 180])
def test_a_walk_goes_along_x_wherever_it_went_in_the_room(man: Files, heading_deg: int) -> None:
    heading = np.deg2rad(heading_deg)

    def walk_there(frame: int, bone: str, index: int) -> float:
        way = walk(frame, "root", 2)
        root = (way * np.sin(heading), 17.0, way * np.cos(heading), 0.0, heading_deg, 0.0)
        return root[index] if bone == "root" else 0.0

    expected = man.pose(walk)
    motion = man.pose(walk_there, heading_rad=None)
    assert np.allclose(motion.points, expected.points, atol=1e-6)
    assert np.allclose(motion.qpos[:, :3], expected.qpos[:, :3], atol=1e-6)
    as_captured = man.pose(walk_there).points
    assert np.allclose(as_captured, expected.points, atol=1e-3) == (heading_deg == 0)


def test_a_man_who_goes_nowhere_is_refused(man: Files) -> None:
    def stand(frame: int, bone: str, index: int) -> float:
        return walk(0, bone, index) + (bone == "lhumerus") * frame

    with pytest.raises(SilemError, match=r"clip\.amc goes nowhere: 0\.00 m/s"):
        man.pose(stand, heading_rad=None)
    with pytest.raises(SilemError, match="a floor that rises by inf m per metre"):
        man.pose(walk, floor_slope=float("inf"))


def test_the_way_of_a_man_with_other_legs_is_scaled_to_the_models(man: Files) -> None:
    """Half the legs, half the steps: a foot that was planted stays planted."""
    planted = man.pose(walk)
    for leg_scale, unit in ((0.5, "0.45"), (0.45, "1.0")):  # the unit of a file cancels out
        text = skeleton_text(man.columns, leg_scale).replace("length 0.45", f"length {unit}")
        man.asf.write_text(text)
        motion = man.pose(
            lambda f, b, i, s=leg_scale: walk(f, b, i) * (s if b == "root" and i < 3 else 1)
        )
        assert np.allclose(motion.points, planted.points, atol=1e-3)
        assert motion.repairs == (
            f"the root's way is scaled by {1 / leg_scale:.4f}, from the skeleton's legs to the"
            " model's",
        )
    man.asf.write_text(skeleton_text(man.columns, 1.008))  # subject 8's own are 0.003 % longer
    assert man.pose(walk).repairs == ()
    for length in ("    length 7.174\n", "    length 7.188\n"):
        man.asf.write_text(skeleton_text(man.columns).replace(length, "", 1))
        with pytest.raises(SilemError, match=r"man\.asf does not say how long the bones of the"):
            man.pose(walk)


def test_bones_that_lie_otherwise_than_the_models_are_refused(man: Files) -> None:
    text = skeleton_text(man.columns)
    frame = f"name ltibia\n    length 7.188\n    axis {frame_of('ltibia')}"
    assert frame in text
    for line, message in (
        ("axis 0 0 0", r"the axes of bone 'ltibia' are 20 degrees off humanoid_CMU's; allowed: 5"),
        ("id 3", r"man\.asf does not say how the axes of bone 'ltibia' lie"),
    ):
        other = frame.replace(f"axis {frame_of('ltibia')}", line)
        man.asf.write_text(text.replace(frame, other))
        with pytest.raises(SilemError, match=message):
            man.pose(walk)


def test_held_frames_are_filled_in_and_said(man: Files) -> None:
    def held(frame: int, bone: str, index: int) -> float:
        return walk(0 if frame < 6 else frame, bone, index)

    motion = man.pose(held)
    assert np.allclose(motion.com_velocity, [1.5, 0, 0])
    assert motion.repairs == (
        "frames 2, 3, 4, 5, 6 repeat the one before: interpolated between their neighbours",
    )
    assert man.pose(walk).repairs == ()
    at_the_end = man.pose(lambda f, b, i: walk(min(f, 57), b, i))
    assert len(at_the_end.qpos) == 20
    with pytest.raises(SilemError, match=r"13 frames in a row only repeat .* allowed: 12"):
        man.pose(lambda f, b, i: walk(max(f, 13), b, i))


def test_a_jump_of_the_root_is_refused_by_frame(man: Files) -> None:
    def jump(frame: int, bone: str, index: int) -> float:
        ahead = 1.0 if (bone, index) == ("root", 0) and frame >= 30 else 0.0
        return walk(frame, bone, index) + ahead

    with pytest.raises(SilemError, match=r"clip\.amc: the root jumps at frame 31: .* 6\.\d m/s"):
        man.pose(jump)
    man.pose(lambda f, b, i: walk(f, b, i) + 0.5 * (jump(f, b, i) - walk(f, b, i)))


def test_quaternions_never_change_sides() -> None:
    turns = np.deg2rad(np.arange(0, 720, 30))
    pose = np.zeros((len(turns), 8))
    pose[:, 3], pose[:, 6] = (
        np.abs(np.cos(turns / 2)),
        np.sin(turns / 2) * np.sign(np.cos(turns / 2)),
    )
    quaternions = kinematics.quaternions(kinematics.rotations(pose))
    assert (np.sum(quaternions[1:] * quaternions[:-1], axis=1) > 0).all()
    assert (np.sum(pose[1:, 3:7] * pose[:-1, 3:7], axis=1) < 0).any()


@pytest.fixture
def only_what_is_committed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SILEM_DATA_DIR", raising=False)
    monkeypatch.setenv(clips.ENV, str(tmp_path / "nothing here"))


@pytest.mark.parametrize("clip", demonstrator.CLIPS)
def test_published_clips_need_no_raw_file(clip: str, only_what_is_committed: None) -> None:
    motion = demonstrator.published_motion(clip)
    entry = demos.entry(f"cmu_{clip}")
    assert entry["features_version"] == demonstrator.FEATURES_VERSION
    assert entry["speed_m_s"] == pytest.approx(motion.speed_m_s, abs=1e-6)
    assert entry["n_states"] == len(motion.features)
    again = skeletal_features(motion.points, motion.torso_axes, motion.com_velocity)
    assert np.allclose(again, motion.features, atol=1e-6), "g has changed: publish the clips anew"
    assert (len(motion.repairs) == 1) == (clip == "08_07")
    assert -0.005 < depth_m(motion.qpos) < 1e-6  # its lowest frame may lie between these


def test_the_papers_clip_is_as_measured(only_what_is_committed: None) -> None:
    motion = demonstrator.published_motion("08_01")
    assert (len(motion.features), motion.duration_s) == (93, pytest.approx(2.3))
    assert motion.qpos[-1, 0] == pytest.approx(3.679, abs=0.001)
    assert motion.speed_m_s == pytest.approx(1.600, abs=0.001)


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path / "data"))
    return tmp_path / "data" / "demonstrations"


def test_an_own_clip_is_published_with_what_was_said_of_it(man: Files, elsewhere: Path) -> None:
    path = demonstrator.publish_own("my_walk", man.asf, man.clip(walk), 60.0, floor_slope=0.01)
    assert path == elsewhere / "my_walk.npz"
    entry = demos.entry("my_walk")
    assert (entry["capture_rate_hz"], entry["floor_slope"]) == (60.0, 0.01)
    assert (entry["source"], entry["skeleton_source"]) == ("clip.amc", "man.asf")
    assert entry["source_sha256"] == files.sha256(man.folder / "clip.amc")
    assert entry["skeleton_sha256"] == files.sha256(man.asf)
    assert entry["licence"] == entry["acknowledgement"] == ""  # whoever captured it knows
    assert entry["speed_m_s"] == pytest.approx(0.75, abs=1e-3)
    motion = demonstrator.published_motion("my_walk")
    assert (motion.name, motion.rate_hz, len(motion.qpos)) == ("my_walk", 40.0, 41)
    first = path.read_bytes()
    demonstrator.publish_own("my_walk", man.asf, man.clip(walk), 60.0, floor_slope=0.01)
    assert path.read_bytes() == first


def test_only_subject_8s_floor_is_levelled(man: Files, elsewhere: Path) -> None:
    def uphill(frame: int, bone: str, index: int) -> float:
        climb = (bone, index) == ("root", 1) and demonstrator.FLOOR_SLOPE * walk(frame, bone, 2)
        return walk(frame, bone, index) + climb

    demonstrator.publish_own("uphill", man.asf, man.clip(uphill), 120.0)
    assert demos.entry("uphill")["floor_slope"] == 0
    heights = demonstrator.published_motion("uphill").points[:, 1, 2]
    assert np.ptp(heights) == pytest.approx(demonstrator.FLOOR_SLOPE * 1.5 * 0.5, rel=1e-3)


@pytest.mark.parametrize(
    "name", ["HC0", "Atlas", "cmu_08_01", "HC0.npz", "a_on_Atlas", "../up", "", "a" * 65]
)
def test_a_name_that_is_taken_or_no_name_is_refused(name: str, man: Files, elsewhere: Path) -> None:
    with pytest.raises(SilemError):
        demonstrator.publish_own(name, man.asf, man.clip(walk), 120.0)
    assert not elsewhere.exists()


def test_demonstrations_that_are_no_captured_motion_are_not_taken_for_one() -> None:
    with pytest.raises(SilemError, match="'HC0' are no captured motion"):
        demonstrator.published_motion("HC0")


@pytest.mark.parametrize("missing", ["--asf", "--amc", "--rate-hz", "--name"])
def test_mocap_asks_for_all_that_an_own_clip_needs(
    missing: str, man: Files, elsewhere: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = {"--asf": man.asf, "--amc": man.clip(walk), "--rate-hz": 120, "--name": "my_walk"}
    del given[missing]
    words = [str(word) for pair in given.items() for word in pair]
    assert main(["mocap", "--quiet", *words]) != 0
    assert "mocap needs --asf, --amc, --rate-hz and --name" in capsys.readouterr().err
    assert not elsewhere.exists()


def test_from_own_files_to_demonstrations_of_every_humanoid(man: Files, elsewhere: Path) -> None:
    clip, name = man.clip(walk), "my_walk"
    words = ["--asf", man.asf, "--amc", clip, "--rate-hz", "120", "--name", name]
    assert main(["mocap", "--quiet", *map(str, words)]) == 0
    for body in retargeting.BODIES:
        result = retargeting.published_retargeting(body, name)
        assert result.converged.all() and result.body == body and result.motion == name
        entry = demos.entry(retargeted(name, body))
        assert entry["retargeted_from_sha256"] == files.sha256(elsewhere / f"{name}.npz")
        # the man glides: no foot ever stands, so none can skate
        assert np.isnan(result.foot_skate_m_s).all()
        config = RunConfig.create(body, "peng20", retargeted(name, body))
        demonstrations, _ = load_demonstrations(config)
        assert demonstrations is not None and demonstrations.body == body


@needs_raw
def test_raw_clips_give_what_is_published_byte_for_byte(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(clips.ENV, str(RAW))
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    first, second = (demonstrator.publish_clips(["08_01"])[0].read_bytes() for _ in range(2))
    assert first == second
    for clip in ("08_01", "08_07"):
        motion = demonstrator.load_motion(clip)
        committed = files.read_npz(paths.REPO / "data" / "demonstrations" / f"cmu_{clip}.npz")
        assert np.allclose(committed["features"], motion.features, atol=1e-5)
        assert np.allclose(committed["qpos"], motion.qpos, atol=1e-6)


@needs_raw
@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # dm_control's
def test_limbs_are_posed_as_dm_control_poses_them() -> None:
    from dm_control.mujoco import Physics
    from dm_control.suite import humanoid_CMU
    from dm_control.suite.utils import parse_amc

    physics = Physics.from_xml_string(*humanoid_CMU.get_model_and_assets())
    theirs = parse_amc.convert(RAW / "08" / "08_01.amc", physics, 1 / 40).qpos.T
    clip = read_amc(RAW / "08" / "08_01.amc", read_asf(RAW / "08" / "08.asf"))
    ours = demonstrator.pose(clip, 120.0)
    thumbs = [7 + i for i, name in enumerate(joints()) if "thumb" in name]  # ours are unwrapped
    same = [i for i in range(7, 63) if i not in thumbs]
    assert np.allclose(ours.qpos[: len(theirs), same], theirs[:, same], atol=1e-9)


@needs_raw
def test_the_jump_of_08_07_is_real_and_the_repair_is_what_the_walk_suggests(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(clips.ENV, str(RAW))
    raw = read_amc(RAW / "08" / "08_07.amc", read_asf(RAW / "08" / "08.asf")).frames
    steps = np.linalg.norm(np.diff(raw[:, :3], axis=0), axis=1) * UNIT_M
    assert steps[:5].max() == 0 and steps[5] > 0.09 > 4 * steps[6]
    repaired = demonstrator.load_motion("08_07", rate_hz=120.0).qpos
    steps = np.linalg.norm(np.diff(repaired[:, :3], axis=0), axis=1)
    assert np.allclose(steps[:6], steps[6:12].mean(), rtol=0.05)
