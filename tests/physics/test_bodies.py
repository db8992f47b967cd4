"""Bodies: the originals stay the originals, the others differ exactly where they should."""

from __future__ import annotations

import dataclasses
import difflib
import errno
import itertools
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pybullet
import pybullet_data
import pytest

from silem import bodies
from silem.bodies import body as bodies_body
from silem.bodies import half_cheetah, measure
from silem.envs import make_vec
from silem.envs.bullet import Client
from silem.util.errors import SilemError
from silem.util.paths import REPO

MJCF = Path(pybullet_data.getDataPath()) / "mjcf"
WATER_KG_M3 = 1000.0  # the density PyBullet gives to shapes


def changed_lines(name: str, original: str) -> list[str]:
    before, after = (bodies.get(body).model_xml().splitlines() for body in (original, name))
    return [line[1:].strip() for line in difflib.ndiff(before, after) if line.startswith("+ ")]


def compiled(name: str) -> mujoco.MjModel:
    return measure.spec(bodies.get(name)).compile()


def ends(name: str, geom: str) -> tuple[np.ndarray, np.ndarray]:
    """Where the centres of a capsule's caps are in its link's frame."""
    shape, axes = compiled(name).geom(geom), np.empty(9)
    mujoco.mju_quat2Mat(axes, shape.quat)
    half = axes[2::3] * shape.size[1]
    back, front = sorted((shape.pos - half, shape.pos + half), key=lambda end: end[0])
    return back, front


def test_names_are_in_the_papers_order():
    assert bodies.names("halfcheetah") == ["HC0", "HC1", "HC2"]
    assert bodies.names("ant") == [f"Ant{i}" for i in range(7)]
    assert bodies.names("humanoid") == ["Humanoid", "HumanoidR", "Atlas"]
    assert bodies.names() == [
        n for f in ("halfcheetah", "ant", "humanoid") for n in bodies.names(f)
    ]


@pytest.mark.parametrize(("name", "file"), [("HC0", "half_cheetah.xml"), ("Ant0", "ant.xml")])
def test_originals_are_pybullets_files_byte_for_byte(name: str, file: str):
    assert bodies.get(name).model_xml().encode() == (MJCF / file).read_bytes()


def test_hc2_differs_from_the_original_in_four_attributes():
    assert changed_lines("HC2", "HC0") == [
        '<geom fromto="-1.5 0 0 1.5 0 0" name="torso" size="0.046" type="capsule"/>',
        '<geom axisangle="0 1 0 .87" name="head" pos="1.6 0 0.1" size="0.046 .15" type="capsule"/>',
        '<body name="bthigh" pos="-1.5 0 0">',
        '<body name="fthigh" pos="1.5 0 0">',
    ]


def test_ant6_differs_from_the_original_in_its_innermost_links():
    lines = changed_lines("Ant6", "Ant0")
    assert len(lines) == 8
    assert '<geom fromto="0.0 0.0 0.0 0.2 0.2 0.0"' not in "".join(lines)
    assert '<body name="aux_3" pos="-0.5 -0.5 0">' in lines
    assert '<geom fromto="0 0 0 -0.5 0.5 0" name="aux_2_geom" size="0.08" type="capsule"/>' in lines


@pytest.mark.parametrize(("name", "length"), [("HC0", 1.0), ("HC1", 2.0), ("HC2", 3.0)])
def test_head_and_thighs_hang_on_the_torsos_ends(name: str, length: float):
    back, front = ends(name, "torso")
    np.testing.assert_allclose(front - back, [length, 0, 0], atol=1e-12)
    neck = min(ends(name, "head"), key=lambda end: end[0])
    original = min(ends("HC0", "head"), key=lambda end: end[0])
    np.testing.assert_allclose(neck - front, original - [0.5, 0, 0], atol=1e-9)
    simulator = Client(bodies.get(name))
    torso = np.array(simulator.place("torso")[0])
    np.testing.assert_allclose(np.subtract(simulator.place("bthigh")[0], torso), back, atol=1e-6)
    np.testing.assert_allclose(np.subtract(simulator.place("fthigh")[0], torso), front, atol=1e-6)


@pytest.mark.parametrize("index", range(7))
def test_ants_reach_grows_by_their_innermost_link(index: int):
    simulator = Client(bodies.get(f"Ant{index}"))
    reach = 0.2 + 0.05 * index
    hip = np.subtract(simulator.place("aux_4")[0], simulator.place("torso")[0])
    ankle = np.subtract(simulator.place("right_back_foot")[0], simulator.place("torso")[0])
    np.testing.assert_allclose(hip, [reach, -reach, 0], atol=1e-6)
    np.testing.assert_allclose(ankle, [reach + 0.2, -reach - 0.2, 0], atol=1e-6)


def test_masses_are_those_pybullet_uses():
    masses = [bodies.describe(name)["masses_kg"] for name in ("HC0", "HC1", "HC2")]
    metre_of_torso = WATER_KG_M3 * math.pi * 0.046**2
    for lighter, heavier in itertools.pairwise(masses):
        difference = {link: heavier[link] - lighter[link] for link in lighter}
        assert difference.pop("torso") == pytest.approx(metre_of_torso, rel=1e-6)
        assert difference == dict.fromkeys(difference, 0.0)
    assert bodies.describe("HC0")["total_mass_kg"] == pytest.approx(38.19, abs=0.01)  # file: 14
    assert bodies.describe("Ant0")["total_mass_kg"] == pytest.approx(182.2, abs=0.1)


def test_description_names_what_can_be_printed():
    hc = bodies.describe("HC1")
    assert hc["lengths_m"]["torso"] == 2.0
    assert hc["lengths_m"]["bthigh"] == pytest.approx(0.29)
    assert hc["actuators"] == pytest.approx(
        {"bthigh": 108, "bshin": 81, "bfoot": 54, "fthigh": 126, "fshin": 54, "ffoot": 27}
    )
    assert hc["joints"]["ffoot"] == pytest.approx((-3.1, -0.3))
    ant = bodies.describe("Ant6")
    assert ant["lengths_m"]["aux_1_geom"] == pytest.approx(math.sqrt(0.5), abs=1e-6)
    assert set(ant["actuators"].values()) == {250.0}
    assert len(ant["joints"]) == 8
    humanoid = bodies.describe("HumanoidR")
    assert humanoid["lengths_m"]["left_lower_arm"] == pytest.approx(
        0.16 * math.sqrt(3) / 2, abs=1e-6
    )
    assert humanoid["joints"]["left_elbow"] == pytest.approx((-math.pi / 2, math.radians(50)))
    assert humanoid["actuators"]["left_hip_y"] == 120.0
    assert humanoid["total_mass_kg"] == pytest.approx(40.844, abs=1e-3)


@pytest.mark.parametrize("name", bodies.names("halfcheetah") + bodies.names("ant"))
def test_weighted_parts_stand_for_all_links(name: str, rng: np.random.Generator):
    """The mean that PyBullet's tasks take over all links and the floor, from fewer of them."""
    body = bodies.get(name)
    simulator = Client(body)
    simulator.reset([0.0] * body.action_size)
    for _ in range(50):
        simulator.advance(rng.uniform(-1, 1, body.action_size).tolist())
    state = simulator.read()
    weights = np.array([part.weight for part in body.parts]) / body.n_parts
    mean = weights @ np.array(state.parts)
    positions = {"floor": (0.0, 0.0, 0.0)}
    client = {"physicsClientId": simulator.client}
    base, _ = pybullet.getBasePositionAndOrientation(simulator.robot, **client)
    if name.startswith("Ant"):
        positions["torso"] = base  # a HalfCheetah's base is the track, its torso a link
    for joint in range(pybullet.getNumJoints(simulator.robot, **client)):
        link = pybullet.getJointInfo(simulator.robot, joint, **client)[12].decode()
        positions[link] = pybullet.getLinkState(simulator.robot, joint, **client)[0]
    assert len(positions) == body.n_parts
    assert np.abs(base).sum() + np.abs(mean).sum() > 0.01  # it has moved
    expected = np.mean(list(positions.values()), axis=0)
    np.testing.assert_allclose(mean[:2], expected[:2], rtol=0, atol=5e-8)


@pytest.mark.parametrize("name", ["HC1", "Ant6"])
def test_mujoco_places_every_link_where_pybullet_has_it(name: str, rng: np.random.Generator):
    """So pictures show what is simulated."""
    body, model = bodies.get(name), compiled(name)
    simulator = Client(body)
    simulator.reset([0.0] * body.action_size)
    for _ in range(60):
        simulator.advance(rng.uniform(-1, 1, body.action_size).tolist())
    client = {"physicsClientId": simulator.client}
    n_links = pybullet.getNumJoints(simulator.robot, **client)
    fresh = {"computeForwardKinematics": True}  # PyBullet's own places trail by a substep
    pybullet.getLinkStates(simulator.robot, list(range(n_links)), **fresh, **client)
    data, at_rest = mujoco.MjData(model), mujoco.MjData(model)
    data.qpos[:] = simulator.qpos()
    far_m = []
    for each in (data, at_rest):
        mujoco.mj_kinematics(model, each)
        for link in (model.body(index).name for index in range(1, model.nbody)):
            position, (x, y, z, w) = simulator.place(link)
            far_m.append(np.linalg.norm(each.body(link).xpos - position))
            if each is data:
                assert abs(each.body(link).xquat @ (w, x, y, z)) == pytest.approx(1, abs=1e-6)
    n = model.nbody - 1
    assert max(far_m[:n]) < 1e-4 and min(far_m[n:]) > 0.05


def test_a_model_that_mujoco_cannot_read_is_one_line():
    body = dataclasses.replace(bodies.get("HC0"), build=lambda: "<mujoco><worldbdy/></mujoco>")
    with pytest.raises(SilemError, match="MuJoCo cannot load body 'HC0'"):
        bodies.describe(body)


def test_unknown_and_repeated_names_are_refused():
    with pytest.raises(SilemError, match="unknown body 'HC9'; allowed: HC0, HC1, HC2, Ant0"):
        bodies.get("HC9")
    with pytest.raises(SilemError, match="unknown family 'cat'; allowed: halfcheetah, ant"):
        bodies.names("cat")


def test_a_name_is_one_bodys_unless_it_is_replaced(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(bodies, "_BODIES", dict(bodies._BODIES))
    monkeypatch.setattr(bodies, "_OWN", {})
    mine = half_cheetah.body("HC1p5", 1.5)
    assert bodies.register(mine) is bodies.get("HC1p5") is mine
    assert bodies.register(half_cheetah.body("HC1p5", 1.5)) is mine  # the same again
    assert gymnasium.spec("silem/HC1p5-v0").max_episode_steps == 1000
    longer = dataclasses.replace(half_cheetah.body("HC1p5", 1.6), max_steps=7)
    # one of another model under the same data is another body, too
    disguised = dataclasses.replace(mine, build=longer.build)
    for other in (longer, disguised):
        with pytest.raises(SilemError, match="another body 'HC1p5' is already registered"):
            bodies.register(other)
    assert bodies.register(longer, replace=True) is bodies.get("HC1p5") is longer
    assert bodies.names("halfcheetah") == ["HC0", "HC1", "HC2", "HC1p5"]
    env = gymnasium.make("silem/HC1p5-v0")
    env.reset(seed=0)
    ends = [env.step(np.zeros(6, np.float32))[3] for _ in range(7)]
    assert ends == [False] * 6 + [True]
    assert make_vec("HC1p5").max_steps == 7 and make_vec("HC0").max_steps == 1000
    for name in ("../HC0", "", "HC 0"):
        with pytest.raises(SilemError, match="body must be a name"):
            bodies.register(dataclasses.replace(mine, name=name))


def test_the_registry_starts_no_simulator_and_compiles_nothing():
    code = (
        "import sys, types; "
        "package = types.ModuleType('silem'); package.__path__ = ['silem']; "
        "sys.modules['silem'] = package; "  # without what `import silem` itself brings
        "from silem import bodies; bodies.names('humanoid'); bodies.get('HC1').model_xml(); "
        "print([m for m in ('pybullet', 'mujoco', 'torch', 'dm_control') if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], cwd=REPO, capture_output=True, text=True, check=True
    )
    assert result.stdout.strip() == "[]"


def test_a_variant_differs_in_its_parameter_alone():
    atlas = bodies.get("Atlas")
    assert atlas.parameters == {"ankle_range_rad": 0.1}
    assert atlas.variant(ankle_range_rad=0.1) is atlas
    wide = atlas.variant(ankle_range_rad=0.3)
    assert wide.parameters == {"ankle_range_rad": 0.3} and wide.name == "Atlas"
    assert wide.motors == atlas.motors and wide.model_xml() != atlas.model_xml()
    with pytest.raises(SilemError, match="unknown parameter of body 'Atlas' 'knee'; all"):
        atlas.variant(knee=1.0)
    with pytest.raises(SilemError, match="unknown parameter of body 'HC0'"):
        bodies.get("HC0").variant(ankle_range_rad=0.1)


def test_edits_that_would_miss_are_refused():
    with pytest.raises(SilemError, match="0 elements <geom name='tail'>"):
        bodies_body.pybullet_model("half_cheetah.xml", {("geom", "tail", "pos"): (0, 0, 0)})
    with pytest.raises(SilemError, match="no attribute 'mass'"):
        bodies_body.pybullet_model("half_cheetah.xml", {("geom", "torso", "mass"): (1,)})
    with pytest.raises(SilemError, match=r"no model 'cat\.xml'"):
        bodies_body.pybullet_model("cat.xml", {})


def test_a_full_temporary_folder_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*arguments: object, **options: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(SilemError, match="no temporary file for HC0: No space left on device"):
        Client(bodies.get("HC0"))
    assert not list(tmp_path.iterdir())
