"""Made-up ASF and AMC files of the demonstrator's own skeleton."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from silem.motion import demonstrator
from silem.motion.mocap import read_amc, read_asf

UNIT_M = 0.056444
Column = Callable[[int, str, int], float]


def joints() -> list[str]:
    model = demonstrator.model()
    return [model.joint(index).name for index in range(1, model.njnt)]


def skeleton_text(columns: list[str]) -> str:
    bones: dict[str, list[str]] = {}
    for column in columns:
        bones.setdefault(column[:-2], []).append(column[-2:])
    lines = [":version 1.10", ":units", "  length 0.45", "  angle deg"]
    lines += [":root", "  order TX TY TZ RX RY RZ", ":bonedata"]
    lines += ["  begin", "    name lhipjoint", "  end"]
    for bone, axes in bones.items():
        lines += ["  begin", f"    name {bone}", f"    dof {' '.join(sorted(axes))}", "  end"]
    lines += [":hierarchy", "  begin", f"    root lhipjoint {' '.join(bones)}", "  end"]
    return "\n".join(lines) + "\n"


def clip_text(n_frames: int, column: Column, columns: list[str]) -> str:
    """Write a clip whose numbers are column(frame, bone, index within the bone)."""
    n_values: dict[str, int] = {"root": 6}
    for name in columns:
        n_values[name[:-2]] = n_values.get(name[:-2], 0) + 1
    lines = ["#!OML:ASF made up", ":FULLY-SPECIFIED", ":DEGREES"]
    for frame in range(n_frames):
        lines.append(str(frame + 1))
        for bone, n in n_values.items():
            values = " ".join(repr(float(column(frame, bone, i))) for i in range(n))
            lines.append(f"{bone} {values}")
    return "\n".join(lines) + "\n"


def walk(frame: int, bone: str, index: int) -> float:
    """A man gliding forward (CMU's z) at 1.5 m/s, not moving a limb."""
    if bone != "root":
        return 0.0
    return (0.0, 17.0, 1.5 * frame / 120 / UNIT_M, 0.0, 0.0, 0.0)[index]


class Files:
    """A made-up skeleton and clips of it, in one folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.columns = joints()
        self.asf = folder / "man.asf"
        self.asf.write_text(skeleton_text(self.columns))

    def clip(self, column: Column = walk, n_frames: int = 61) -> Path:
        path = self.folder / "clip.amc"
        path.write_text(clip_text(n_frames, column, self.columns))
        return path

    def pose(self, column: Column, n_frames: int = 61, **kwargs: float):
        kwargs = {"floor_slope": 0.0} | kwargs
        return demonstrator.pose(
            read_amc(self.clip(column, n_frames), read_asf(self.asf)), **kwargs
        )
