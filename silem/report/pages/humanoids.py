"""The page of the humanoids: Figure 3a, measures and distances, the reward's factors, falls."""

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from pandas.io.formats.style import Styler

from silem import bodies, paper
from silem.bodies import MujocoBody, describe
from silem.bodies.body import MAX_STEPS
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.envs import mujoco as walking
from silem.envs.mujoco import Reading, Simulation, start_state
from silem.motion.demonstrator import Motion
from silem.motion.features import POINTS, Landmarks
from silem.motion.kinematics import SIDES
from silem.motion.retargeting import Limbs
from silem.report import film, style
from silem.report.pages import demonstration
from silem.report.style import number
from silem.report.tables import styled
from silem.study.evaluate import RandomPolicy, evaluate
from silem.util import seeding
from silem.util.errors import SilemError

_humanoid = functools.partial(bodies.of_kind, kind=MujocoBody)
_N_POSES = 7
_AZIMUTH_RAD = np.deg2rad(25.0)  # seen from the right and a little from the front, level
_PORTRAIT = 480, 600  # pixels
_ALIKE = {  # joints of Humanoid and of Atlas that do the same
    "hip, forward and back": ("right_hip_y", "r_leg_hpy"),
    "hip, sideways": ("right_hip_x", "r_leg_hpx"),
    "hip, turning": ("right_hip_z", "r_leg_hpz"),
    "knee": ("right_knee", "r_leg_kny"),
    "ankle, pitch": ("right_ankle_y", "r_leg_aky"),
    "ankle, roll": ("right_ankle_x", "r_leg_akx"),
    "waist, forward and back": ("abdomen_y", "back_bky"),
    "waist, sideways": ("abdomen_x", "back_bkx"),
    "waist, turning": ("abdomen_z", "back_bkz"),
    "shoulder, first": ("right_shoulder1", "r_arm_shz"),
    "shoulder, second": ("right_shoulder2", "r_arm_shx"),
    "elbow, bending": ("right_elbow", "r_arm_elx"),
}
_GRAVITY_M_S2 = 9.81
_TRUNK = ("pelvis", "ltorso", "mtorso", "utorso")  # of Atlas, from below
DEMONSTRATOR = "demonstrator"
_LIMBS = {"feet": "foot", "hand": "hand"}  # the paper's numbers, and what they are of
_PRINTED_M = {
    part: dict(
        zip((DEMONSTRATOR, "Humanoid", "Atlas"), paper.number(f"{part}_distances"), strict=True)
    )
    for part in _LIMBS
}
_EQUAL_M = 0.005  # left and right are written as one number where they differ by less
_SUITE_SPEED_M_S = 1.0  # what dm_control's own task asks for
_N = 201  # points of a curve


@style.applied()
def figure_3a(motion: Motion, names: Sequence[str]) -> Figure:
    """Draw Figure 3a: the demonstrator's walk on strokes a metre apart, the learners below it."""
    points = motion.points
    right = np.array([np.cos(_AZIMUTH_RAD), np.sin(_AZIMUTH_RAD), 0.0])
    seen = points @ np.stack([right, [0.0, 0.0, 1.0]], axis=1)  # to the right and up, (T, P, 2)
    rows: list[Any] = [["walk"] * len(names), list(names)]
    figure = Figure(figsize=(style.WIDTH_IN, 5.9), layout="constrained")
    panels = figure.subplot_mosaic(rows, height_ratios=[1, 1.2])
    walk = panels["walk"]
    low, high = demonstration.floor(walk, seen)
    walk.set_ylim(min(low[1], -demonstration.MARGIN_M), high[1])
    metre = float(right[0])  # as long as it is seen
    strokes = np.arange(np.ceil(low[0] / metre), np.floor(high[0] / metre) + 1) * metre
    walk.plot(strokes, np.zeros(len(strokes)), "|", ms=9, color=style.MUTED, zorder=0)
    walk.set_axis_off()
    look: dict[str, Any] = {"loc": "upper right", "bbox_to_anchor": (1, 1.12), "fontsize": 8}
    walk.legend(handles=demonstration.handles("side"), ncols=2, **look)
    shown = demonstration.equal_times(len(points), _N_POSES)
    for rank, state in enumerate(shown, start=1):
        demonstration.draw(walk, seen[state], alpha=0.35 + 0.65 * rank / _N_POSES)
    way_m = float(np.linalg.norm(points[-1, 0, :2] - points[0, 0, :2]))
    walk.set_title(f"The demonstrator: {way_m:.1f} m in {motion.duration_s:.1f} s")
    for name in names:
        panels[name].set(title=name, xticks=[], yticks=[])
        panels[name].spines[:].set(visible=True, color=style.FAINT)
        try:
            panels[name].imshow(film.still(name, _PORTRAIT), interpolation="none")
        except SilemError:
            style.say(panels[name], "No picture: nothing can be\ndrawn offscreen here.")
    return figure


def posed(
    body: MujocoBody, qpos: Sequence[float] | None = None
) -> tuple[mujoco.MjData, np.ndarray]:
    """Put a humanoid into a pose, all joints at zero for None; return data and landmarks (P, 3)."""
    model = mujoco.MjModel.from_xml_string(body.model_xml())
    data = mujoco.MjData(model)
    if qpos is not None:
        data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    return data, data.xpos[Landmarks(model, body.skeleton).ids]


def overview(names: Sequence[str]) -> pd.DataFrame:
    """Return what humanoids measure, a row each: mass in kg, lengths and heights in m."""
    rows = {}
    for body in map(_humanoid, names):
        limbs = Limbs.of(posed(body)[1])
        mass, head_m = describe(body.name)["total_mass_kg"], heights([body.name]).iloc[0, 0]
        arms = {"left arm (m)": limbs.left_arm, "right arm (m)": limbs.right_arm}
        rows[body.name] = {"mass (kg)": mass, "head (m)": head_m, "leg (m)": limbs.leg, **arms}
        rows[body.name] |= {"hips to torso (m)": limbs.spine, "motors": body.action_size}
    return pd.DataFrame(rows).T.astype({"motors": int}).rename_axis("body")


def arms(first: str, second: str) -> pd.DataFrame:
    """Compare two humanoids' links that differ in mass: their masses in kg, a row per link."""
    masses = pd.DataFrame({name: describe(name)["masses_kg"] for name in (first, second)})
    return masses[masses[first] != masses[second]].rename_axis("mass (kg)")


def strength() -> pd.DataFrame:
    """Compare the motors of Humanoid and Atlas, joint by joint.

    The columns are the torque at action 1 in N m, and that over the body's weight times the length
    of its leg, in per cent.
    """
    table = pd.DataFrame(index=pd.Index(_ALIKE, name="joint"))
    shares = {}
    for name, joints in zip(("Humanoid", "Atlas"), zip(*_ALIKE.values(), strict=True), strict=True):
        facts = describe(name)
        torques = np.array([facts["actuators"][joint] for joint in joints])
        leg_m = Limbs.of(posed(_humanoid(name))[1]).leg
        table[f"{name} (N m)"] = torques.round().astype(int)
        shares[f"{name} (%)"] = 100 * torques / (facts["total_mass_kg"] * _GRAVITY_M_S2 * leg_m)
    return table.assign(**shares)


def heights(names: Sequence[str]) -> pd.DataFrame:
    """Return the heights of the head in m that the walking task goes by, a row per body."""
    columns = ("standing pose", "counts as standing from", "episode ends below")
    head = POINTS.index("head")
    rows = [
        (posed(b, b.standing_pose)[1][head, 2], b.standing_head_m, b.fall_head_m)
        for b in map(_humanoid, names)
    ]
    return pd.DataFrame(rows, names, columns).rename_axis("height of the head (m)")


def limb_distances_m(body: MujocoBody, qpos: Sequence[float] | None = None) -> dict[str, float]:
    """Return how far hands and feet are from the torso in m by name; None: all joints at zero."""
    _, points = posed(body, qpos)
    distances = np.linalg.norm(points - points[POINTS.index("torso")], axis=1)
    limbs = [f"{side}_{limb}" for limb in _LIMBS.values() for side in SIDES]
    return {limb: float(distances[POINTS.index(limb)]) for limb in limbs}


def limb_distances() -> dict[str, dict[str, float]]:
    """Return `limb_distances_m` of the demonstrator and the humanoids, all joints at zero."""
    found = {DEMONSTRATOR: limb_distances_m(film.man())}
    return found | {n: limb_distances_m(_humanoid(n)) for n in bodies.names("humanoid")}


def distance_table(found: Mapping[str, Mapping[str, float]]) -> Styler:
    """Return a table of `limb_distances`: the paper's, ours, and the difference."""
    rows = []
    for body, limbs in found.items():
        row = {("", "body"): body}
        for part, limb in _LIMBS.items():
            left, right = (limbs[f"{side}_{limb}"] for side in SIDES)
            printed, mean = _PRINTED_M[part].get(body), (left + right) / 2
            both = f"{number(left, 2)} left, {number(right, 2)} right"
            off = round(mean - (printed or 0.0), 2) + 0.0  # never a negative zero
            heading = f"{'feet' if part == 'feet' else 'hands'} from the torso (m)"
            row[heading, "paper"] = number(printed, 2)
            row[heading, "ours"] = number(mean, 2) if abs(left - right) < _EQUAL_M else both
            difference = "+" * (off > 0) + number(off, 2)
            row[heading, "difference"] = difference if printed else style.DASH
        rows.append(row)
    return styled(pd.DataFrame(rows))


def gaps() -> dict[str, float]:
    """Return by how much limb distances differ from the demonstrator's: "our_hand_Atlas"."""
    found, differences = limb_distances(), {}
    for part, limb in _LIMBS.items():
        ours = {n: (d[f"left_{limb}"] + d[f"right_{limb}"]) / 2 for n, d in found.items()}
        for whose, distances in (("paper", _PRINTED_M[part]), ("our", ours)):
            for name in ("Humanoid", "Atlas"):
                gap = abs(distances[name] - distances[DEMONSTRATOR])
                differences[f"{whose}_{part}_{name}"] = gap
    return differences


def trunk_distances() -> pd.DataFrame:
    """Return how far Atlas's feet and hands are from each part of its trunk, joints at zero, m."""
    body = _humanoid("Atlas")
    data, _ = posed(body)
    trunk = np.array([data.body(part).xpos for part in _TRUNK])
    ends = {"feet (m)": body.skeleton.left_foot, "hands (m)": body.skeleton.left_hand}
    distances = {e: np.linalg.norm(trunk - data.body(b).xpos, axis=1) for e, b in ends.items()}
    return pd.DataFrame(distances, index=pd.Index(_TRUNK, name="from"))


@style.applied()
def reward_factors() -> Figure:
    """Draw the factors of the environments' own reward, each with the others at their best."""
    body = _humanoid("Humanoid")
    shown = {  # of the state: title, label, values, and how the axis shows them
        "head_m": ("Standing", "head's height (m)", 1.2 * body.standing_head_m, 1.0),
        "tilt_rad": ("Upright", "torso's tilt (degrees)", np.pi, np.rad2deg(1.0)),
        "torque": ("Small control", "size of all actions", 1.0, 1.0),
        "speed_m_s": ("Speed", "horizontal speed (m/s)", 2.5, 1.0),
    }
    figure, grid = style.panels([entry[0] for entry in shown.values()], 2.1, 4, sharey=True)
    for axes, (name, (_, label, top, unit)) in zip(grid, shown.items(), strict=True):
        values = np.linspace(0.0, top, _N)
        for target, line in ((DEMONSTRATOR_SPEED_M_S, "-"), (_SUITE_SPEED_M_S, ":")):
            if name == "speed_m_s" or line == "-":
                rewards = _rewards(body, target, **{name: values})
                word = f"target {target:g} m/s"
                axes.plot(unit * values, rewards, line, color=style.INK, label=word)
        axes.set(xlabel=label, ylim=(0, 1.05))
    grid[0].axvspan(0.0, body.fall_head_m, color=style.FAINT, lw=0)
    grid[0].set_ylabel("factor of the reward")
    grid[1].set_xticks([0, 90, 180])
    grid[3].legend(fontsize=7.5, loc="lower right")
    return figure


def _rewards(body: MujocoBody, target_m_s: float, **given: np.ndarray) -> np.ndarray:
    """Return rewards (N,) of made-up states that are perfect but in the quantity given."""
    perfect = {"head_m": body.standing_head_m, "tilt_rad": 0.0, "torque": 0.0}
    state: dict[str, Any] = {**perfect, "speed_m_s": target_m_s, **given}
    points, axes, velocity = np.zeros((_N, len(POINTS), 3)), np.zeros((_N, 3, 3)), np.zeros((_N, 3))
    points[:, POINTS.index("head"), 2] = state["head_m"]
    axes[:, 2, 2] = np.cos(state["tilt_rad"])
    velocity[:, 0] = state["speed_m_s"]
    actions = np.zeros((_N, 1)) + np.reshape(state["torque"], (-1, 1))
    reading = Reading(np.empty((_N, 0)), np.empty((_N, 0)), points, axes, velocity)
    return walking.rewards(reading, actions, body.standing_head_m, target_m_s)


def fall(names: Sequence[str], torque: float, duration_s: float, seed: int = 0) -> film.Clip:
    """Film humanoids that start as in an episode and have no policy, side by side, in real time.

    Unlike an episode, the film goes on when they have fallen. Every motor gets a random share of
    its greatest torque, uniformly from -torque to torque, 0 to 1, anew at every control step.
    """
    if not (duration_s > 0 and 0 <= torque <= 1):
        raise SilemError(
            f"duration_s = {duration_s}, torque = {torque}; allowed: above 0, and from 0 to 1"
        )
    clips = {}
    for body in map(_humanoid, names):
        rng = np.random.default_rng(seeding.child_seed(seed, "fall", body.name))
        simulation = Simulation(body, 1)
        simulation.place(0, *start_state(rng, body))
        states = [simulation.read().qpos[0]]
        for _ in range(round(duration_s / body.control_step_s)):
            simulation.advance(rng.uniform(-torque, torque, (1, body.action_size)))
            states.append(simulation.read().qpos[0])
        rate_hz = 1 / body.control_step_s
        clips[body.name] = film.motion(body, np.stack(states), rate_hz, size=film.PANEL)
    return film.grid(clips)


def falls(names: Sequence[str], n_episodes: int, seed: int) -> pd.DataFrame:
    """Return how long humanoids stand without a policy, and what it earns: means over episodes."""
    rows: dict[str, dict[str, float]] = {}
    for body in map(_humanoid, names):
        row = rows.setdefault(body.name, {})
        for label, std in (("no torques", 0.0), ("random torques", 1.0)):
            found = evaluate(RandomPolicy(body, std=std), body.name, n_episodes, seed)
            row[f"{label}: seconds"] = (found.upright or 0.0) * MAX_STEPS * body.control_step_s
            row[f"{label}: return"] = found.return_mean
    return pd.DataFrame(rows).T.rename_axis("body")
