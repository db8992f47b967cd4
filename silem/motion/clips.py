"""Motion capture as CMU publishes it: skeletons (ASF) and clips (AMC), fetched, read and checked.

dm_control, which turns a frame into a pose (`silem.motion.demonstrator`), takes every file on
trust: a bone that is missing shifts all numbers after it. So files are checked here. In form they
may differ as they do (line ends, blanks, remarks, case, order of sections), in their numbers not;
an error names file, line and bone.
"""

import codecs
import hashlib
import http.client
import os
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from silem.util import files, paths
from silem.util.errors import SilemError, choose

URL = "http://mocap.cs.cmu.edu/subjects/"
ENV = "SILEM_MOCAP_DIR"
"""Environment variable: a folder that holds the files already, as 08/08.asf, 08/08_01.amc, ..."""

_SUMS = Path(__file__).with_name("cmu.sha256").read_text().split()
SHA256 = dict(zip(_SUMS[1::2], _SUMS[::2], strict=True))
"""SHA-256 of each file, in ``cmu.sha256`` as sha256sum writes it, with LF line ends; the server's
own line ends may be CR LF."""

LICENCE = "free for all uses"
ACKNOWLEDGEMENT = (
    "The data used in this project was obtained from mocap.cs.cmu.edu. "
    "The database was created with funding from NSF EIA-0196217."
)
"""What CMU asks to be said wherever its data are used."""

ROOT = "root"
_CMUS = {"angle": ["deg"], "order": ["tx", "ty", "tz", "rx", "ry", "rz"], "axis": ["xyz"]}


def mocap_file(name: str) -> Path:
    """Return a file of the database: from ``$SILEM_MOCAP_DIR`` if set, else from the own cache.

    What the cache lacks is downloaded from CMU's server. Raises SilemError: the name is unknown,
    the file is not in that folder, cannot be downloaded, or has not the SHA-256 expected.
    """
    choose("motion capture file", name, SHA256)
    own = os.environ.get(ENV)
    path = (Path(own).expanduser() if own else paths.data_dir() / "mocap") / name
    cached = path.is_file()
    if own and not cached:
        raise SilemError(f"{path} is missing; {ENV} must hold it, or be unset to download it")
    content = path.read_bytes() if cached else _download(name, path)
    found = hashlib.sha256(content.replace(b"\r\n", b"\n")).hexdigest()
    if found != SHA256[name]:
        raise SilemError(
            f"{path if cached else URL + name} is not CMU's {name} (SHA-256 with LF line ends):"
            f" found {found}, expected {SHA256[name]}"
        )
    if not cached:
        files.write_bytes(path, content)
    return path


def _download(name: str, path: Path) -> bytes:
    try:
        with urllib.request.urlopen(URL + name, timeout=60) as answer:
            return bytes(answer.read())
    except (OSError, ValueError, http.client.HTTPException) as error:
        raise SilemError(
            f"cannot download {URL}{name} ({type(error).__name__}); with no network, put the file"
            f" at {path} by hand, or set {ENV} to a folder that holds {name}"
        ) from error


@dataclass(frozen=True)
class Bone:
    """A bone of a skeleton; NaN stands for what its file does not say."""

    axes: tuple[str, ...] = ()  #: those about which it turns ("rx", ...), none if it does not move
    length: float = float("nan")  #: in the file's unit
    frame_deg: tuple[float, ...] = (float("nan"),) * 3  #: its own axes, turned about x, then y, z


@dataclass(frozen=True)
class AsfSkeleton:
    """The bones of a skeleton file by name, the root left out, in the file's order."""

    path: Path
    bones: dict[str, Bone]

    @property
    def dof(self) -> dict[str, tuple[str, ...]]:
        """The axes of each bone that moves."""
        return {name: bone.axes for name, bone in self.bones.items() if bone.axes}

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of a frame's numbers: "root0" to "root5", then bone and axis ("ltibiarx")."""
        bones = (f"{bone}{axis}" for bone, axes in self.dof.items() for axis in axes)
        return (*(f"{ROOT}{i}" for i in range(6)), *bones)


@dataclass(frozen=True)
class AmcClip:
    """The frames of a clip: the root's position in the file's unit, then angles in degrees."""

    path: Path
    skeleton: AsfSkeleton
    frames: np.ndarray  #: (N, C) in the order of the skeleton's columns
    first: int = 1  #: number of the first frame


class _Line(NamedTuple):
    """One line of a text file, split into words in lower case."""

    path: Path
    number: int
    words: list[str]

    def error(self, problem: str) -> SilemError:
        return SilemError(f"{self.path}, line {self.number}: {problem}")

    def numbers(self, bone: str, texts: list[str], n: int) -> list[float]:
        if len(texts) != n:
            raise self.error(f"bone {bone!r} has {len(texts)} values, allowed: {n}")
        try:
            values = [float(text.replace("_", "?")) for text in texts]  # Python's 1_0 is no 10
        except ValueError:
            raise self.error(f"bone {bone!r} holds what is no number: {' '.join(texts)}") from None
        if not np.isfinite(values).all():
            raise self.error(f"bone {bone!r} holds NaN or infinity: {' '.join(texts)}")
        return values


def _lines(path: Path) -> list[_Line]:
    """Read the lines of a text file that are neither blank nor a remark."""
    try:
        content = path.read_bytes().removeprefix(codecs.BOM_UTF8)
    except OSError as error:
        raise SilemError(f"cannot read {path}: {error.strerror or error}") from error
    if b"\0" in content:
        raise SilemError(f"{path} is no text file")
    if not content.endswith((b"\n", b"\r")):
        raise SilemError(f"{path} is truncated: its last line has no end")
    lines = []
    for number, line in enumerate(content.splitlines(), start=1):
        words = line.partition(b"#")[0].lower().split()  # of bytes: at ASCII's blanks alone
        if words:
            lines.append(_Line(path, number, [word.decode("latin-1") for word in words]))
    return lines


def _blocks(lines: list[_Line], starts: Callable[[str], bool]) -> list[list[_Line]]:
    """Split lines before each whose first word starts a block; first comes what precedes them."""
    blocks: list[list[_Line]] = [[]]
    for line in lines:
        if starts(line.words[0]):
            blocks.append([])
        blocks[-1].append(line)
    return blocks


def read_asf(path: Path | str) -> AsfSkeleton:
    """Read a skeleton, an ASF file.

    Raises SilemError: the file is missing or truncated; it is not in degrees, or its root is not as
    CMU's; or a bone is without name, or there twice.
    """
    path = Path(path)
    _, *found = _blocks(_lines(path), lambda word: word.startswith(":"))
    sections = {block[0].words[0]: block[1:] for block in found}
    for name in (":root", ":bonedata", ":hierarchy"):  # the last tells that the bones are whole
        if not sections.get(name):
            raise SilemError(f"{path} has no section {name}: it is truncated or no ASF file")
    for line in sections.get(":units", []) + sections[":root"]:
        key, *values = line.words
        if _CMUS.get(key, values) != values:
            allowed = " ".join(_CMUS[key])
            raise line.error(f"{key} is {' '.join(values)!r}; allowed: CMU's, {allowed!r}")
        if key == "orientation" and any(line.numbers(ROOT, values, 3)):
            raise line.error("the root is turned; allowed: orientation 0 0 0")
    bones: dict[str, Bone] = {}
    for block in _blocks(sections[":bonedata"], "begin".__eq__)[1:]:
        line = next((line for line in block if line.words[0] == "name"), block[0])
        name, *more = line.words[1:] or [""]
        if more or not name or name in bones:
            raise line.error(f"a bone needs one name of its own, not {' '.join(line.words[1:])!r}")
        bones[name] = _bone(name, block)
    return AsfSkeleton(path, bones)


def _bone(name: str, block: list[_Line]) -> Bone:
    bone = Bone()
    for line in block:
        key, *values = line.words
        if key == "length":
            bone = replace(bone, length=line.numbers(name, values, 1)[0])
        elif key == "axis":
            if values[3:] not in ([], ["xyz"]):
                raise line.error(f"bone {name!r} has axes {' '.join(values[3:])!r}; allowed: 'xyz'")
            bone = replace(bone, frame_deg=tuple(line.numbers(name, values[:3], 3)))
        elif key == "dof":
            if len(set(values)) != len(values) or not {*values} <= {"rx", "ry", "rz"}:
                raise line.error(f"bone {name!r} turns about {values}; allowed: rx, ry, rz")
            bone = replace(bone, axes=tuple(values))
    return bone


def read_amc(path: Path | str, skeleton: AsfSkeleton) -> AmcClip:
    """Read a clip, an AMC file, of a skeleton: frames with a number for every axis of every bone.

    Raises SilemError: the file is missing or truncated, is not in degrees, or a frame is out of
    order, lacks a bone, or has one that is unknown, repeated, or has wrong values.
    """
    path = Path(path)
    header, *blocks = _blocks(_lines(path), lambda word: word.isdigit() and len(word) < 10)
    for line in header:
        word = line.words[0]
        if not word.startswith(":"):
            raise line.error(f"{word!r} before the first frame; allowed: lines that begin with ':'")
    if not blocks:
        raise SilemError(f"{path} holds no frame: it is truncated or no AMC file")
    if ":degrees" not in [line.words[0] for line in header]:
        raise SilemError(f"{path} does not say :DEGREES; allowed: angles in degrees")
    first = int(blocks[0][0].words[0])
    n_values = {ROOT: 6} | {bone: len(axes) for bone, axes in skeleton.dof.items()}
    frames = [_frame(number, block, n_values) for number, block in enumerate(blocks, first)]
    return AmcClip(path, skeleton, np.array(frames), first)


def _frame(number: int, block: list[_Line], n_values: dict[str, int]) -> list[float]:
    """Return a frame's numbers from the line of its own number and the lines of its bones."""
    if len(block[0].words) > 1 or int(block[0].words[0]) != number:
        raise block[0].error(f"frame {' '.join(block[0].words)} where frame {number} is due")
    values: dict[str, list[float]] = {}
    for line in block[1:]:
        bone, *texts = line.words
        if bone not in n_values or bone in values:
            problem = "there twice" if bone in values else "unknown: no such bone can move"
            raise line.error(f"bone {bone!r} of frame {number} is {problem}")
        values[bone] = line.numbers(bone, texts, n_values[bone])
    missing = [bone for bone in n_values if bone not in values]
    if missing:
        raise block[-1].error(
            f"frame {number} ends without bone {missing[0]!r} ({len(missing)} missing):"
            " the file is truncated or of another skeleton"
        )
    return [value for bone in n_values for value in values[bone]]
