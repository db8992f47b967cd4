"""Made-up ASF and AMC files of the demonstrator's own skeleton."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco
from scipy.spatial.transform import Rotation

from silem.motion import demonstrator
from silem.motion.clips import read_amc, read_asf
from silem.motion.demonstrator import Motion

UNIT_M = 0.056444
LEGS = {"femur": 7.174, "tibia": 7.188}  # of the model, in the files' unit
Column = Callable[[int, str, int], float]


def joints() -> list[str]:
    model = demonstrator.model()
    return [model.joint(index).name for index in range(1, model.njnt)]


def frame_of(bone: str) -> str:
    """Three angles in degrees: how the model's bone lies when all joints are at zero."""
    model = demonstrator.model()
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, bone) < 0:
        return "0 0 0"
    data = mujoco.MjData(model)
    data.qpos[3:7] = 1, 0, 0, 0
    mujoco.mj_kinematics(model, data)
    matrix = data.body(bone).xmat.reshape(3, 3)
    angles = Rotation.from_matrix(matrix).as_euler("xyz", degrees=True)
    return " ".join(f"{angle:.6g}" for angle in angles)


def skeleton_text(columns: list[str], leg_scale: float = 1.0) -> str:
    bones: dict[str, list[str]] = {}
    for column in columns:
        bones.setdefault(column[:-2], []).append(column[-2:])
    lines = [":version 1.10", ":units", "  length 0.45", "  angle deg"]
    lines += [":root", "  order TX TY TZ RX RY RZ", "  axis XYZ", "  orientation 0 0 0"]
    lines += [":bonedata", "  begin", "    name lhipjoint", "    axis 0 0 0 XYZ", "  end"]
    for bone, axes in bones.items():
        length = leg_scale * LEGS.get(bone[1:], 1.0)
        lines += ["  begin", f"    name {bone}", f"    length {length:g}"]
        lines += [f"    axis {frame_of(bone)}  XYZ", f"    dof {' '.join(sorted(axes))}", "  end"]
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

    def pose(self, column: Column, n_frames: int = 61, **kwargs: float | None) -> Motion:
        kwargs = {"capture_rate_hz": 120.0, "heading_rad": 0.0} | kwargs
        clip = read_amc(self.clip(column, n_frames), read_asf(self.asf))
        return demonstrator.pose(clip, **kwargs)
