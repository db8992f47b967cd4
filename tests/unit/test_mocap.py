"""Reading ASF and AMC files, good and bad."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from synthetic_clips import Files

from silem.motion.clips import read_amc, read_asf
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
        ("ltibia 0.0", "ltibia 1_0", r"line \d+: bone 'ltibia' holds what is no number: 1_0"),
        ("ltibia 0.0", "ltibia 1,5", r"line \d+: bone 'ltibia' holds what is no number: 1,5"),
        ("ltibia 0.0", "ltibia 1e999", r"line \d+: bone 'ltibia' holds NaN or infinity: 1e999"),
        ("ltibia 0.0", "ltibia # 0.0", r"line \d+: bone 'ltibia' has 0 values, allowed: 1"),
        ("ltibia 0.0", "tail 0.0", r"line \d+: bone 'tail' of frame 1 is unknown"),
        ("ltibia 0.0\n", "", r"line \d+: frame 1 ends without bone 'ltibia' \(1 missing\)"),
        ("ltibia 0.0", "ltibia 0.0\nltibia 0.0", r"line \d+: bone 'ltibia' of frame 1 is there"),
        ("\n2\n", "\n3\n", r"line \d+: frame 3 where frame 2 is due"),
        ("\n2\n", "\n2 3\n", r"line \d+: frame 2 3 where frame 2 is due"),
        ("\n2\n", f"\n{'9' * 5000}\n", r"line \d+: bone '9+' of frame 1 is unk"),
        (":DEGREES", ":RADIANS", "does not say :DEGREES"),
        (":DEGREES", ":DEGREES\nltibia 0.0", r"line 4: 'ltibia' before the first frame"),
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
        ("angle deg", "angle rad", "line 4: angle is 'rad'"),
        ("name ltibia", "name lfemur", r"line \d+: a bone needs one name of its own"),
        ("dof rx\n", "dof rw\n", r"line \d+: bone '\w+' turns about \['rw'\]"),
        ("dof rx rz\n", "dof rx rx\n", r"line \d+: bone '\w+' turns about \['rx', 'rx'\]"),
        ("length 7.174", "length long", r"line \d+: bone 'lfemur' holds what is no number: long"),
        ("length 7.174", "length inf", r"line \d+: bone 'lfemur' holds NaN or infinity"),
        ("axis 0 0 0 XYZ", "axis 0 0 XYZ", r"line \d+: bone 'lhipjoint' holds what is no number"),
        ("axis 0 0 0 XYZ", "axis 0 0 0 ZYX", r"bone 'lhipjoint' has axes 'zyx'; allowed: 'xyz'"),
        ("name lhipjoint", "id 1", r"line \d+: a bone needs one name of its own"),
        ("TX TY TZ RX", "RX TX TY TZ", r"line 6: order is 'rx tx ty tz ry rz'; allowed: CMU's"),
        ("  axis XYZ", "  axis ZYX", r"line 7: axis is 'zyx'; allowed: CMU's, 'xyz'"),
        ("orientation 0 0 0", "orientation 0 90 0", r"line 8: the root is turned; allowed"),
        (":hierarchy", ":end", "no section :hierarchy"),
    ],
)
def test_a_bad_skeleton_is_refused(old: str, new: str, message: str, man: Files) -> None:
    good = man.asf.read_text()
    assert old in good
    man.asf.write_text(good.replace(old, new, 1))
    with pytest.raises(SilemError, match=message):
        read_asf(man.asf)


def crlf(text: str) -> str:
    return text.replace("\n", "\r\n")


def old_mac(text: str) -> str:
    return text.replace("\n", "\r")


def spaced(text: str) -> str:
    return "\n \n" + text.replace(" ", "\t  ").replace("\n", " \t\n\n")


def remarked(text: str) -> str:
    first = "# captured on 1 May by Ren\xe9\x85\n"
    return "\xef\xbb\xbf" + first + text.replace("\n", "  # a remark: 1 2 3\n")


def turned_round(text: str) -> str:
    """The sections in the reverse order, and one more; a clip has none, only its header."""
    if ":hierarchy" not in text:
        return text.replace(":FULLY-SPECIFIED\n:DEGREES", ":DEGREES\n:FULLY-SPECIFIED")
    sections = text.strip().split("\n:")
    return "\n:".join([":documentation\n  my own", *sections[:0:-1]]) + "\n"


def without_units(text: str) -> str:
    return text.replace(":units\n  length 0.45\n  angle deg\n", "")


def from_zero(text: str) -> str:
    """A piece that was cut out of a clip may begin at any number."""
    return text.replace("\n1\n", "\n0\n").replace("\n2\n", "\n1\n")


FORMS = [crlf, old_mac, spaced, remarked, str.upper, turned_round, without_units, from_zero]


@pytest.mark.parametrize("form", FORMS)
def test_the_form_of_a_file_changes_nothing_in_its_numbers(
    form: Callable[[str], str], man: Files
) -> None:
    path = man.clip(lambda frame, bone, index: 100 * frame + 10 * len(bone) + index, 2)
    expected = read_amc(path, read_asf(man.asf))
    for file in (path, man.asf):
        file.write_bytes(form(file.read_text()).encode("latin-1"))
    skeleton = read_asf(man.asf)
    found = read_amc(path, skeleton)
    assert skeleton.bones == expected.skeleton.bones
    assert found.frames.tolist() == expected.frames.tolist()
    assert found.first == (0 if form is from_zero else 1)


def test_bones_have_the_lengths_and_frames_of_the_file(man: Files) -> None:
    bones = read_asf(man.asf).bones
    assert (bones["lfemur"].length, bones["ltibia"].axes) == (7.174, ("rx",))
    assert bones["lhipjoint"].frame_deg == (0, 0, 0) and bones["lhipjoint"].axes == ()
    assert bones["lfemur"].frame_deg == pytest.approx((0, 0, 20), abs=0.5)


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
