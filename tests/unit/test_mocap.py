"""Reading ASF and AMC files, good and bad."""

from __future__ import annotations

from pathlib import Path

import pytest
from synthetic_clips import Files

from silem.motion.mocap import read_amc, read_asf
from silem.util.errors import SilemError


@pytest.fixture
def man(tmp_path: Path) -> Files:
    return Files(tmp_path)


def test_numbers_are_read_in_the_skeletons_order_whatever_the_files(man: Files) -> None:
    skeleton = read_asf(man.asf)
    assert set(skeleton.columns[6:]) == set(man.columns)
    assert "lhipjoint" not in skeleton.dof  # a bone that does not move
    path = man.clip(lambda frame, bone, index: 100 * frame + 10 * len(bone) + index, 2)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:4] + lines[32:3:-1] + lines[33:]) + "\n")
    frames = read_amc(path, skeleton).frames
    expected = [10 * len("root") + index for index in range(6)]
    expected += [
        10 * len(bone) + i for bone, axes in skeleton.dof.items() for i in range(len(axes))
    ]
    assert frames.tolist() == [expected, [100 + value for value in expected]]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("ltibia 0.0", "ltibia nan", r"clip\.amc, line \d+: bone 'ltibia' holds NaN"),
        ("ltibia 0.0", "ltibia 0.0 1.0", r"line \d+: bone 'ltibia' has 2 values, allowed: 1"),
        ("ltibia 0.0", "ltibia x", r"line \d+: bone 'ltibia' holds what is no number: x"),
        ("ltibia 0.0", "tail 0.0", r"line \d+: unknown bone 'tail' in frame 1"),
        ("ltibia 0.0\n", "", r"line \d+: frame 1 ends without bone 'ltibia' \(1 missing\)"),
        ("ltibia 0.0", "ltibia 0.0\nltibia 0.0", r"line \d+: bone 'ltibia' is in frame 1 twice"),
        ("\n2\n", "\n3\n", r"line \d+: frame 3 where frame 2 is due"),
        (":DEGREES", ":RADIANS", "does not say :DEGREES"),
    ],
)
def test_a_bad_clip_is_refused_by_line_and_bone(
    old: str, new: str, message: str, man: Files
) -> None:
    path = man.clip(n_frames=2)
    good = path.read_text()
    assert old in good
    path.write_text(good.replace(old, new, 1))
    with pytest.raises(SilemError, match=message):
        read_amc(path, read_asf(man.asf))


def test_the_line_named_is_the_line_meant(man: Files) -> None:
    path = man.clip(n_frames=3)
    lines = path.read_text().splitlines()
    index = [i for i, line in enumerate(lines) if line.startswith("rhumerus")][1]
    lines[index] = "rhumerus inf 0 0"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(SilemError, match=f"line {index + 1}: bone 'rhumerus'"):
        read_amc(path, read_asf(man.asf))


def test_a_clip_cut_anywhere_but_between_frames_is_refused(man: Files) -> None:
    path = man.clip(n_frames=3)
    whole = path.read_bytes()
    boundaries = {whole.index(b"\n2\n") + 1, whole.index(b"\n3\n") + 1, len(whole)}
    skeleton = read_asf(man.asf)
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        if length in boundaries:
            continue
        with pytest.raises(SilemError, match=r"clip\.amc"):
            read_amc(path, skeleton)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("length 0.45", "length 1.0", r"man\.asf, line 3: length is '1.0'; allowed: .*'0.45'"),
        ("angle deg", "angle rad", "line 4: angle is 'rad'"),
        ("name ltibia", "name lfemur", r"line \d+: a bone needs one name of its own"),
        ("dof rx\n", "dof rw\n", r"line \d+: bone '\w+' turns about \['rw'\]"),
        ("root lhipjoint", "root tail", r"line \d+: unknown bone 'tail'"),
        ("root lhipjoint", "root", r"bone 'lhipjoint' hangs on no other bone"),
        (":hierarchy", ":end", "no section :hierarchy"),
    ],
)
def test_a_bad_skeleton_is_refused(old: str, new: str, message: str, man: Files) -> None:
    good = man.asf.read_text()
    assert old in good
    man.asf.write_text(good.replace(old, new, 1))
    with pytest.raises(SilemError, match=message):
        read_asf(man.asf)


def test_missing_and_binary_files_and_a_cut_skeleton_are_refused(man: Files) -> None:
    whole = man.asf.read_bytes()
    for length in range(0, len(whole), 41):
        man.asf.write_bytes(whole[:length])
        with pytest.raises(SilemError, match=r"man\.asf"):
            read_asf(man.asf)
    man.asf.write_bytes(bytes(range(256)))
    with pytest.raises(SilemError, match="no text file"):
        read_asf(man.asf)
    with pytest.raises(SilemError, match=r"cannot read .*nowhere"):
        read_asf(man.folder / "nowhere.asf")
