"""The humanoids in pictures: standing, and falling without torques or with random ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from silem.bodies import MujocoBody
from silem.envs import MujocoCamera
from silem.envs.mujoco.simulator import Simulation, body_of, start_state
from silem.report import rendering
from silem.report.motion_video import STATES_PER_PICTURE
from silem.report.video import Clip, labelled, side_by_side
from silem.util import seeding
from silem.util.errors import SilemError

NO_PICTURE = "No picture: nothing can be drawn offscreen here."

_WIDTH, _HEIGHT = 320, 440  # pixels of one panel of a film
_PORTRAIT_WIDTH, _PORTRAIT_HEIGHT = 480, 600


def portraits(names: Sequence[str]) -> dict[str, np.ndarray]:
    """Picture humanoids in their standing poses, by name: (H, W, 3) each.

    Where nothing can be drawn offscreen, a picture is an empty plate with `NO_PICTURE` on it.

    Raises:
        SilemError: A body is unknown or no humanoid.
    """
    return {name: _portrait(body_of(name)) for name in names}


def _portrait(body: MujocoBody) -> np.ndarray:
    try:
        return rendering.still(body, _PORTRAIT_WIDTH, _PORTRAIT_HEIGHT)
    except SilemError:
        plate = np.full((_WIDTH, _PORTRAIT_WIDTH, 3), 255, np.uint8)
        return labelled(Clip(plate[None], 1.0), NO_PICTURE).frames[0]


def fall(names: Sequence[str], torque: float, duration_s: float, seed: int = 0) -> Clip:
    """Film humanoids that start as in an episode and have no policy, side by side, in real time.

    Unlike an episode, the film goes on when they have fallen.

    Args:
        names: The humanoids.
        torque: Every motor gets a random share of its greatest torque, uniformly from -torque to
            torque and anew at every control step; 0 leaves all joints limp.
        duration_s: Simulated time, seconds.
        seed: Seed of start states and torques.

    Raises:
        SilemError: A body is unknown or no humanoid, the duration is not positive, the torque is
            not from 0 to 1, or nothing can be drawn offscreen here.
    """
    if not (duration_s > 0 and 0 <= torque <= 1):
        raise SilemError(
            f"duration_s = {duration_s}, torque = {torque}; allowed: above 0, and from 0 to 1"
        )
    clips = [_fall(body_of(name), torque, duration_s, seed) for name in names]
    return side_by_side(clips, list(names))


def _fall(body: MujocoBody, torque: float, duration_s: float, seed: int) -> Clip:
    generator = np.random.default_rng(seeding.child_seed(seed, "fall", body.name))
    simulation = Simulation(body, 1)
    camera = MujocoCamera(simulation, _WIDTH, _HEIGHT)
    try:
        simulation.place(0, *start_state(generator, body))
        pictures = [camera.picture()]
        n_steps = round(duration_s / body.control_step_s)
        for step in tqdm(range(1, n_steps + 1), desc=f"filming {body.name}", unit="step"):
            simulation.advance(generator.uniform(-torque, torque, (1, body.action_size)))
            if step % STATES_PER_PICTURE == 0:
                pictures.append(camera.picture())
    finally:
        camera.close()
    return Clip(np.stack(pictures), 1 / (STATES_PER_PICTURE * body.control_step_s))
