"""Motion capture as CMU publishes it: a skeleton (ASF) and its clips (AMC), read and checked.

dm_control turns a frame into a pose (`silem.motion.demonstrator`) but takes every file on trust:
a bone that is missing shifts all numbers after it. So the files are checked here, and an error
names the file, the line and the bone.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from silem.util.errors import SilemError

ROOT = "root"
_UNITS = {"length": "0.45", "angle": "deg"}  # 1 / 0.45 inches are 0.0564 m
_ROOT_ORDER = "TX TY TZ RX RY RZ"
_AXES = ("rx", "ry", "rz")


@dataclass(frozen=True)
class AsfSkeleton:
    """What a clip needs to know of its skeleton.

    Attributes:
        path: The file.
        dof: The axes about which each bone that moves turns, the root left out.
    """

    path: Path
    dof: dict[str, tuple[str, ...]]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of a frame's numbers: "root0" to "root5", then bone and axis ("ltibiarx")."""
        bones = (f"{bone}{axis}" for bone, axes in self.dof.items() for axis in axes)
        return (*(f"{ROOT}{i}" for i in range(6)), *bones)


@dataclass(frozen=True)
class AmcClip:
    """The frames of a clip.

    Attributes:
        path: The file.
        skeleton: The skeleton that its numbers refer to.
        frames: (N, C) numbers in the order of the skeleton's columns: the root's position in the
            file's unit of length, then angles in degrees.
    """

    path: Path
    skeleton: AsfSkeleton
    frames: np.ndarray


class _Line(NamedTuple):
    """One line of a text file, split into words."""

    path: Path
    number: int
    words: list[str]

    def error(self, problem: str) -> SilemError:
        return SilemError(f"{self.path}, line {self.number}: {problem}")


def _lines(path: Path) -> list[_Line]:
    """Read the lines of a text file that are neither blank nor a remark."""
    try:
        text = path.read_bytes().decode("ascii")
    except OSError as error:
        raise SilemError(f"cannot read {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise SilemError(f"{path} is no text file ({error})") from error
    if not text.endswith("\n"):
        raise SilemError(f"{path} is truncated: its last line has no end")
    lines = [_Line(path, i, line.split()) for i, line in enumerate(text.splitlines(), start=1)]
    return [line for line in lines if line.words and not line.words[0].startswith("#")]


def read_asf(path: Path | str) -> AsfSkeleton:
    """Read a skeleton.

    Args:
        path: The ASF file.

    Returns:
        The bones that move, in the file's order, and their axes.

    Raises:
        SilemError: The file is missing or truncated, its units are not CMU's, or a bone is
            without name, there twice, or not in the hierarchy.
    """
    path = Path(path)
    sections: dict[str, list[_Line]] = {}
    for line in _lines(path):
        if line.words[0].startswith(":"):
            sections[line.words[0]] = []
        elif sections:
            sections[next(reversed(sections))].append(line)
    for name in (":units", ":root", ":bonedata", ":hierarchy"):
        if not sections.get(name):
            raise SilemError(f"{path} has no section {name}: it is truncated or no ASF file")
    _expect(sections[":units"], _UNITS)
    _expect(sections[":root"], {"order": _ROOT_ORDER})
    dof = _bones(sections[":bonedata"])
    _check_hierarchy(sections[":hierarchy"], dof)
    return AsfSkeleton(path, {bone: axes for bone, axes in dof.items() if axes})


def _expect(lines: list[_Line], wanted: dict[str, str]) -> None:
    for line in lines:
        key, value = line.words[0], " ".join(line.words[1:])
        if wanted.get(key, value) != value:
            raise line.error(f"{key} is {value!r}; allowed: CMU's, {wanted[key]!r}")


def _bones(lines: list[_Line]) -> dict[str, tuple[str, ...]]:
    """Return each bone's axes; none for a bone that does not move."""
    dof: dict[str, tuple[str, ...]] = {}
    bone = ""
    for line in lines:
        key, values = line.words[0], line.words[1:]
        if key == "begin":
            bone = ""
        elif key == "name":
            if len(values) != 1 or values[0] in dof:
                raise line.error(f"a bone needs one name of its own, not {' '.join(values)!r}")
            bone = values[0]
            dof[bone] = ()
        elif key == "dof":
            if not bone or not set(values) <= set(_AXES):
                raise line.error(f"bone {bone!r} turns about {values}; allowed: {', '.join(_AXES)}")
            dof[bone] = tuple(values)
    return dof


def _check_hierarchy(lines: list[_Line], bones: Iterable[str]) -> None:
    linked = {ROOT}
    for line in lines[1:-1]:  # between "begin" and "end"
        unknown = [bone for bone in line.words if bone not in (ROOT, *bones)]
        if unknown:
            raise line.error(f"unknown bone {unknown[0]!r}: the file describes no such bone")
        linked.update(line.words[1:])
    if lines[-1].words != ["end"]:
        raise lines[-1].error("the file ends before its hierarchy does: it is truncated")
    loose = [bone for bone in bones if bone not in linked]
    if loose:
        raise lines[-1].error(f"bone {loose[0]!r} hangs on no other bone")


def read_amc(path: Path | str, skeleton: AsfSkeleton) -> AmcClip:
    """Read a clip.

    Args:
        path: The AMC file.
        skeleton: Its skeleton, from `read_asf`.

    Returns:
        The frames, each with a number for every axis of every bone.

    Raises:
        SilemError: The file is missing or truncated, is not in degrees, or a frame is out of
            order, lacks a bone, or has a bone that is unknown, repeated, of the wrong number of
            values, or holds NaN or infinity.
    """
    path = Path(path)
    header: list[_Line] = []
    blocks: list[list[_Line]] = []
    for line in _lines(path):
        if len(line.words) == 1 and line.words[0].isdigit():
            if int(line.words[0]) != len(blocks) + 1:
                raise line.error(f"frame {line.words[0]} where frame {len(blocks) + 1} is due")
            blocks.append([line])
        else:
            (blocks[-1] if blocks else header).append(line)
    if not blocks:
        raise SilemError(f"{path} holds no frame: it is truncated or no AMC file")
    if [":DEGREES"] not in [line.words for line in header]:
        raise SilemError(f"{path} does not say :DEGREES; allowed: angles in degrees")
    n_values = {ROOT: 6} | {bone: len(axes) for bone, axes in skeleton.dof.items()}
    return AmcClip(path, skeleton, np.array([_frame(block, n_values) for block in blocks]))


def _frame(block: list[_Line], n_values: dict[str, int]) -> list[float]:
    """Return a frame's numbers from the line of its number and the lines of its bones."""
    name = f"frame {block[0].words[0]}"
    values: dict[str, list[float]] = {}
    for line in block[1:]:
        bone = line.words[0]
        if bone not in n_values:
            raise line.error(f"unknown bone {bone!r} in {name}: no such bone moves in the skeleton")
        if bone in values:
            raise line.error(f"bone {bone!r} is in {name} twice")
        values[bone] = _numbers(line, n_values[bone])
    missing = [bone for bone in n_values if bone not in values]
    if missing:
        raise block[-1].error(
            f"{name} ends without bone {missing[0]!r} ({len(missing)} missing):"
            " the file is truncated or of another skeleton"
        )
    return [value for bone in n_values for value in values[bone]]


def _numbers(line: _Line, n_values: int) -> list[float]:
    bone, texts = line.words[0], line.words[1:]
    if len(texts) != n_values:
        raise line.error(f"bone {bone!r} has {len(texts)} values, allowed: {n_values}")
    try:
        values = [float(text) for text in texts]
    except ValueError:
        raise line.error(f"bone {bone!r} holds what is no number: {' '.join(texts)}") from None
    if not np.isfinite(values).all():
        raise line.error(f"bone {bone!r} holds NaN or infinity: {' '.join(texts)}")
    return values
