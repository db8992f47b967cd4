"""Pictures and short films of the bodies: at rest, acting, and along a given motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

import silem
from silem import bodies
from silem.bodies import Body, BulletBody, MujocoBody
from silem.envs import MujocoCamera
from silem.envs.base import Filmed
from silem.envs.bullet.camera import Camera
from silem.envs.bullet.simulator import Simulator
from silem.envs.mujoco.simulator import Simulation, body_of
from silem.report import style
from silem.report.video import Clip
from silem.study.evaluate import Policy, random_policy
from silem.util import seeding
from silem.util.errors import SilemError

_STEPS_PER_FRAME = {"bullet": 2, "mujoco": 1}
"""Control steps from one frame to the next: 30 and 40 frames per simulated second."""

_STILL_WIDTH, _STILL_HEIGHT = 480, 300  # pixels, in a gallery


def still(
    body: Body | str, width: int = 640, height: int = 480, span_m: float | None = None
) -> np.ndarray:
    """Render a body at rest: a humanoid standing; a runner's joints at zero, or nearest to it.

    Args:
        body: A body, or a registered body's name.
        width: Of the picture, pixels.
        height: Of the picture, pixels.
        span_m: Width of what is seen at a runner, metres; None lets the body fit.

    Returns:
        The picture (H, W, 3).

    Raises:
        SilemError: The body is unknown, the size or the span is not positive, there is a span for
            a humanoid, or nothing can be drawn offscreen here.
    """
    found = bodies.get(body) if isinstance(body, str) else body
    if isinstance(found, MujocoBody):
        if span_m is not None:
            raise SilemError(f"span_m is for runners; the camera fits {found.name} by its height")
        return _poses(found, np.array([found.standing_pose]), width, height)[0]
    assert isinstance(found, BulletBody)
    simulator = Simulator(found)
    try:
        simulator.reset([min(max(0.0, low), high) for low, high in simulator.limits])
        return Camera(simulator, width, height, span_m).picture()
    finally:
        simulator.close()


def gallery(names: Sequence[str], span_m: float | None = None, n_columns: int = 3) -> Figure:
    """Draw bodies at rest, as in Figures 2a and 2c.

    Args:
        names: Registered bodies.
        span_m: Width of what is seen at each body, metres: one scale for all. None lets each fit.
        n_columns: Pictures per row.
    """
    n_rows = -(-len(names) // n_columns)
    height_in = style.WIDTH_IN / n_columns * _STILL_HEIGHT / _STILL_WIDTH + 0.3
    with style.applied():
        figure, grid = style.new_figure(
            n_rows * height_in, nrows=n_rows, ncols=n_columns, squeeze=False
        )
        for axes in grid.flat[len(names) :]:
            axes.set_axis_off()
        for axes, name in zip(grid.flat, names, strict=False):
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set(visible=True, color=style.FAINT)
            axes.imshow(still(name, _STILL_WIDTH, _STILL_HEIGHT, span_m), interpolation="none")
            _, length_m = bodies.get(name).length
            axes.set_title(f"{name}: {length_m:g} m", pad=3)
    return figure


def rollout(
    body: Body | str,
    policy: Policy | None = None,
    *,
    duration_s: float = 6.0,
    seed: int = 0,
    progress: bool = True,
    steps_per_frame: int | None = None,
    size: tuple[int, int] = Filmed.picture_size,
) -> Clip:
    """Film a policy from the start of an episode; it acts stochastically, as in evaluation.

    The clip ends where the episode does, if that comes first.

    Args:
        body: A body, or a registered body's name.
        policy: The policy; None for uniformly random actions.
        duration_s: Simulated time to film, seconds.
        seed: Seed of the start state and of the policy's random numbers.
        progress: Show a progress bar.
        steps_per_frame: Control steps from one frame to the next; None for the usual ones.
        size: Width and height of the pictures, pixels.

    Raises:
        SilemError: The body is unknown, the duration is not positive, or nothing can be drawn
            offscreen here.
    """
    found = bodies.get(body) if isinstance(body, str) else body
    steps_per_frame = steps_per_frame or _STEPS_PER_FRAME[found.engine]
    frame_s = steps_per_frame * found.control_step_s
    if not (duration_s > 0 and math.isfinite(duration_s)):
        raise SilemError(f"duration_s = {duration_s} is not a positive number of seconds")
    n_frames = max(1, round(duration_s / frame_s))
    policy = policy or random_policy(found)
    if hasattr(policy, "reseed"):
        policy.reseed(seeding.child_seed(seed, "video policy"))
    env: Any = silem.make_vec(found, n_envs=1, seed=seeding.child_seed(seed, "video env"))
    env.picture_size = size
    try:
        observations: Any = env.reset()
        frames: list[Any] = [env.render()]
        steps = range(1, (n_frames - 1) * steps_per_frame + 1)
        for step in tqdm(steps, desc=f"filming {found.name}", unit="step", disable=not progress):
            actions, _ = policy.predict(observations, deterministic=False)
            observations, _, dones, _ = env.step(actions)
            if dones[0]:  # the environment stands at its next start already
                break
            if step % steps_per_frame == 0:
                frames.append(env.render())
    finally:
        env.close()
    return Clip(np.stack(frames), 1 / frame_s)


def motion(
    body: Body | str, qpos: np.ndarray, rate_hz: float, width: int = 640, height: int = 480
) -> Clip:
    """Film a humanoid posed along a given motion, for instance a retargeted clip; no physics acts.

    Args:
        body: A humanoid, or its name.
        qpos: Positions of all joints, (T, nq).
        rate_hz: States per second, which is the clip's frame rate.
        width: Of the pictures, pixels.
        height: Of the pictures, pixels.

    Raises:
        SilemError: It is no humanoid, the motion has another width, or nothing can be drawn
            offscreen here.
    """
    found = body_of(body)
    expected = len(found.standing_pose)
    if qpos.ndim != 2 or qpos.shape[1] != expected or len(qpos) == 0:
        raise SilemError(f"motion of shape {qpos.shape}; {found.name} needs (T, {expected})")
    return Clip(_poses(found, qpos, width, height), rate_hz)


def why_no_pictures(body: str) -> str:
    """Return why a body cannot be pictured on this machine, "" if it can.

    Runners are drawn without OpenGL; humanoids need it offscreen.

    Raises:
        SilemError: The body is unknown.
    """
    found = bodies.get(body)
    if not isinstance(found, MujocoBody):
        return ""
    try:
        _poses(found, np.array([found.standing_pose]), width=8, height=8)
    except SilemError as error:
        return str(error)
    return ""


def _poses(body: MujocoBody, qpos: np.ndarray, width: int, height: int) -> np.ndarray:
    """Picture a humanoid in each of some poses (T, nq): (T, H, W, 3)."""
    simulation = Simulation(body, 1)
    camera = MujocoCamera(simulation, width, height)
    try:
        pictures = []
        for pose in qpos:
            simulation.place(0, pose, np.zeros(simulation.model.nv))
            pictures.append(camera.picture())
        return np.stack(pictures)
    finally:
        camera.close()
