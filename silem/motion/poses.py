"""Sequences of poses (T, nq) with a free root joint first: gaps, jumps, resampling, velocities."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

MAX_ROOT_VELOCITY_CHANGE_M_S = 5.0
"""From one frame at 120 Hz to the next: 61 times gravity, which no walking man's pelvis does."""


def interpolate(qpos: np.ndarray, times: np.ndarray, new_times: np.ndarray) -> np.ndarray:
    """Return the poses at new times that lie within the old.

    Args:
        qpos: (T, nq) poses.
        times: (T,) when, increasing.
        new_times: (S,) when they are wanted.

    Returns:
        (S, nq): positions and hinges on straight lines between two poses, the root's orientation
        on the great arc (slerp).
    """
    columns = [np.interp(new_times, times, column) for column in qpos.T]
    resampled = np.stack(columns, axis=1)
    resampled[:, 3:7] = quaternions(Slerp(times, rotations(qpos))(new_times))
    return resampled


def rotations(qpos: np.ndarray) -> Rotation:
    """Return the root's orientations (T,)."""
    return Rotation.from_quat(qpos[:, 3:7], scalar_first=True)


def quaternions(orientations: Rotation) -> np.ndarray:
    """Return quaternions (T, 4), real part first, none on the other side of the one before."""
    result = orientations.as_quat(scalar_first=True)
    turns = np.where((result[1:] * result[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    result[1:] *= np.cumprod(turns)[:, None]
    return result


def longest_run(flags: np.ndarray) -> int:
    """Return how many flags (T,) are set in a row at most."""
    edges = np.flatnonzero(~np.concatenate([[False], flags, [False]]))
    return int(np.diff(edges).max()) - 1


def root_jump(qpos: np.ndarray, rate_hz: float) -> tuple[int, float]:
    """Return where the root's velocity changes most, and by how much.

    Args:
        qpos: (T, nq) poses.
        rate_hz: Poses per second.

    Returns:
        The index of the pose that the larger step leads to or from, and the change in m/s.
    """
    velocity = np.diff(qpos[:, :3], axis=0) * rate_hz
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1)
    if not change.size:
        return 0, 0.0
    at = int(change.argmax())
    after = np.linalg.norm(velocity[at + 1]) >= np.linalg.norm(velocity[at])
    return at + (2 if after else 1), float(change[at])


def velocities(model: mujoco.MjModel, qpos: np.ndarray, rate_hz: float) -> np.ndarray:
    """Return velocities (T, nv) of poses (T, nq): central differences, one-sided at both ends."""
    qvel = np.zeros((len(qpos), model.nv))
    last = len(qpos) - 1
    for state, row in enumerate(qvel):
        before, after = max(state - 1, 0), min(state + 1, last)
        duration_s = (after - before) / rate_hz
        mujoco.mj_differentiatePos(model, row, duration_s, qpos[before], qpos[after])
    return qvel
