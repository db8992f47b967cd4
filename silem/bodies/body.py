"""What a body is: data only. How to build it, what moves, what is measured."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from importlib.resources import files
from typing import Literal

from silem.util.errors import SilemError, choose

MAX_STEPS = 1000
"""Steps after which an episode of every body of the paper is cut off."""

AT_LIMIT = 0.99
"""|scaled angle| beyond which a joint counts as at its limit; PyBullet's task charges it."""

VELOCITY_SCALE = 0.3
"""Of the root's velocity in the observation of PyBullet's task."""

Engine = Literal["bullet", "mujoco", "gymnasium"]


@dataclass(frozen=True)
class Motor:
    """A torque motor on a hinge of the model; `torque_n_m` is its torque at action 1."""

    joint: str
    torque_n_m: float


@dataclass(frozen=True)
class Part:
    """A point of a body whose position enters the mean that measures progress.

    Attributes:
        link: The link.
        weight: How many parts of the model the point stands for.
        point: The link's centre of mass, or the origin of its frame, which is its joint.
    """

    link: str
    weight: float
    point: Literal["center", "origin"] = "center"


@dataclass(frozen=True)
class AliveRule:
    """When a body counts as upright: it earns +1 per step upright and -1 otherwise.

    Attributes:
        min_height_m: Height the torso must exceed.
        max_pitch_rad: Pitch the torso must stay below, in absolute value.
        no_contact: Names of feet that must not touch the floor.
        terminates: Whether the episode ends when the body is no longer upright.
    """

    min_height_m: float = -float("inf")
    max_pitch_rad: float = float("inf")
    no_contact: tuple[str, ...] = ()
    terminates: bool = False


@dataclass(frozen=True)
class View:
    """How a body's camera looks at it, following it along the floor.

    Attributes:
        direction: Of view, in the world (x, y, z).
        look_at_m: Height of what is in the middle of the picture.
        span_m: Extent of what is seen there: its width for PyBullet's bodies, which are long, its
            height for MuJoCo's, which are tall.
    """

    direction: tuple[float, float, float]
    look_at_m: float
    span_m: float


@dataclass(frozen=True, kw_only=True, repr=False)
class Body:
    """One entry of the registry: what every simulator's bodies have.

    Attributes:
        name: Name in the paper, for example "HC2".
        family: Bodies of one family share observation and task.
        description: One sentence for tables and figure captions.
        build: Returns the model file's text (MJCF).
        motors: The actuators, in the order of the action and of the joints in the model.
        length: Name and value, in metres, of what sets the body apart in its family.
        varied: Links that have that length.
        view: How it is looked at.
        max_steps: Control steps after which an episode is cut off.
        parameters: What can be chosen of it, and its choice, by name.
        variants: Returns the body for other values of its parameters.
    """

    name: str
    family: str
    engine: Engine
    description: str
    build: Callable[[], str] = field(repr=False, compare=False)
    motors: tuple[Motor, ...]
    length: tuple[str, float]
    varied: tuple[str, ...]
    view: View
    control_step_s: float
    max_steps: int = MAX_STEPS
    parameters: Mapping[str, float] = field(default_factory=dict, hash=False)
    variants: Callable[..., Body] | None = field(default=None, repr=False, compare=False)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}: {self.description}>"

    def variant(self, **parameters: float) -> Body:
        """Return this body with other values of some of its parameters.

        Raises:
            SilemError: If it has no such parameter, or a value is not allowed.
        """
        for name in parameters:
            choose(f"parameter of body {self.name!r}", name, self.parameters)
        if self.variants is None or dict(self.parameters) == {**self.parameters, **parameters}:
            return self
        return self.variants(**{**self.parameters, **parameters})

    def model_xml(self) -> str:
        """Return the model file's text (MJCF)."""
        return self.build()

    @property
    def action_size(self) -> int:
        """Number of motors."""
        return len(self.motors)


@dataclass(frozen=True, kw_only=True, repr=False)
class BulletBody(Body):
    """A body of PyBullet's locomotion tasks.

    Attributes:
        root: Link whose pose and velocity enter the observation.
        root_joints: Joints along which a planar root moves (x, z, pitch); empty if it floats.
        feet: Links whose floor contact is observed, in the order of the observation.
        parts: The points in the mean position that measures progress, the root first. The mean
            runs over all links of the model and the floor; a point stands for every link that
            coincides with it or whose position follows from it.
        n_parts: Number of parts in that mean.
        alive: The alive rule.
    """

    engine: Engine = "bullet"
    control_step_s: float = 0.0165  # of PyBullet's locomotion tasks
    root: str
    root_joints: tuple[str, ...]
    feet: tuple[str, ...]
    parts: tuple[Part, ...]
    n_parts: int
    alive: AliveRule

    @property
    def observation_size(self) -> int:
        """Eight numbers of the torso, two per motor, one per foot."""
        return 8 + 2 * len(self.motors) + len(self.feet)


@dataclass(frozen=True, kw_only=True)
class Skeleton:
    """The landmarks from which skeletal features are computed: origins of MuJoCo bodies.

    Shoulder, elbow, hip and knee are the bodies whose origin lies in that joint, for example the
    upper and the lower arm.

    Attributes:
        torso: The body whose frame is the torso frame.
        axes: The axes of that frame that point forward, left and up.
    """

    torso: str
    head: str
    left_shoulder: str
    left_elbow: str
    left_hand: str
    right_shoulder: str
    right_elbow: str
    right_hand: str
    left_hip: str
    left_knee: str
    left_foot: str
    right_hip: str
    right_knee: str
    right_foot: str
    axes: str = "xyz"

    @classmethod
    def of_sides(cls, torso: str, head: str, left: str, right: str, **limbs: str) -> Skeleton:
        """Return one whose sides differ in a prefix, from the rest of the names: `hip="thigh"`."""
        sided = {
            f"{side}_{point}": prefix + name
            for side, prefix in (("left", left), ("right", right))
            for point, name in limbs.items()
        }
        return cls(torso=torso, head=head, **sided)

    @classmethod
    def points(cls) -> tuple[str, ...]:
        """Return the names of the landmarks, the torso first."""
        return tuple(entry.name for entry in fields(cls) if entry.name != "axes")


@dataclass(frozen=True, kw_only=True, repr=False)
class MujocoBody(Body):
    """A humanoid in MuJoCo: a free root joint first, then hinges.

    Attributes:
        skeleton: Its landmarks.
        n_substeps: Simulation steps in one control step; the model's timestep times this is
            `control_step_s`.
        standing_pose: Position of all joints when it stands, soles on the floor, (nq,).
        standing_head_m: Height of the head from which the reward counts it as standing.
        fall_head_m: Height of the head below which an episode ends.
        target_speed_m_s: Speed of the centre of mass that earns the full reward.
    """

    engine: Engine = "mujoco"
    control_step_s: float = 0.025
    skeleton: Skeleton
    n_substeps: int = 5
    standing_pose: tuple[float, ...]
    standing_head_m: float
    fall_head_m: float
    target_speed_m_s: float


@dataclass(frozen=True, kw_only=True, repr=False)
class GymnasiumBody(Body):
    """Whatever a Gymnasium environment moves; its name is the environment's id."""

    engine: Engine = "gymnasium"
    family: str = "gymnasium"
    description: str = "a Gymnasium environment"
    build: Callable[[], str] = field(default=str, repr=False, compare=False)
    motors: tuple[Motor, ...] = ()
    length: tuple[str, float] = ("", 0.0)
    varied: tuple[str, ...] = ()
    view: View = View((0.0, 1.0, 0.0), 0.0, 1.0)
    control_step_s: float = 1.0

    @property
    def action_size(self) -> int:
        """Number of continuous actions; raises SilemError where there are others."""
        import gymnasium  # which no body of the paper needs

        space = gymnasium.make(self.name).action_space
        if not isinstance(space, gymnasium.spaces.Box) or len(space.shape) != 1:
            raise SilemError(f"{self.name} takes no vector of continuous actions but {space}")
        return int(space.shape[0])


# ---------------------------------------------------------------- PyBullet's model files


def pybullet_model(name: str) -> str:
    """Return PyBullet's own `pybullet_data/mjcf/<name>`, byte for byte.

    Raises:
        SilemError: If the installed `pybullet_data` lacks the file.
    """
    try:
        return (files("pybullet_data") / "mjcf" / name).read_bytes().decode("utf-8")
    except OSError as error:
        raise SilemError(f"pybullet_data has no model {name!r} ({error})") from error


def set_attribute(xml: str, tag: str, name: str, attribute: str, value: str) -> str:
    """Return `xml` with one attribute of the one element `<tag name="name">` replaced.

    The rest of the text stays as it is, comments and order of attributes included, so that two
    bodies of a family differ exactly where they are meant to.

    Raises:
        SilemError: If there is no such element or attribute, or more than one.
    """
    elements = [m for m in re.finditer(rf"<{tag}\b[^>]*>", xml) if f' name="{name}"' in m[0]]
    if len(elements) != 1:
        raise SilemError(f"{len(elements)} elements <{tag} name={name!r}> in the model, not one")
    pattern = rf'(\s{attribute}=")[^"]*(")'
    edited, count = re.subn(pattern, lambda m: m[1] + value + m[2], elements[0][0])
    if count != 1:
        raise SilemError(f"<{tag} name={name!r}> has no attribute {attribute!r}")
    return xml[: elements[0].start()] + edited + xml[elements[0].end() :]


def numbers(*values: float) -> str:
    """Format numbers as MJCF writes them: at most six significant digits, by spaces."""
    return " ".join(f"{value:.6g}" for value in values)
