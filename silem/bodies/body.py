"""What a body is: data only. How to build it, what moves, what is measured."""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib.resources import files
from typing import Literal

from silem.util.errors import SilemError, choose

MAX_STEPS = 1000  #: steps after which an episode of every body of the paper is cut off
AT_LIMIT = 0.99
"""|scaled angle| beyond which a joint counts as at its limit; PyBullet's task charges it."""

VELOCITY_SCALE = 0.3  #: of the root's velocity in the observation of PyBullet's task
Engine = Literal["bullet", "mujoco", "gymnasium"]


@dataclass(frozen=True)
class Motor:
    """A torque motor on a hinge of the model; `torque_n_m` is its torque at action 1."""

    joint: str
    torque_n_m: float


@dataclass(frozen=True)
class Part:
    """A point of a body whose position enters the mean that measures progress."""

    link: str
    weight: float  #: how many parts of the model the point stands for
    #: the link's centre of mass, or the origin of its frame, which is its joint
    point: Literal["center", "origin"] = "center"


@dataclass(frozen=True)
class AliveRule:
    """When a body counts as upright: it earns +1 per step upright and -1 otherwise."""

    min_height_m: float = -float("inf")  #: height the torso must exceed
    max_pitch_rad: float = float("inf")  #: pitch it must stay below, in absolute value
    no_contact: tuple[str, ...] = ()  #: feet that must not touch the floor
    terminates: bool = False  #: whether the episode ends when the body is no longer upright


@dataclass(frozen=True)
class View:
    """How a body's camera looks at it, following it along the floor."""

    direction: tuple[float, float, float]  #: of view, in the world (x, y, z)
    look_at_m: float  #: height of what is in the middle of the picture
    #: extent of what is seen there: width of PyBullet's bodies, which are long, height of MuJoCo's
    span_m: float


@dataclass(frozen=True, kw_only=True, repr=False)
class Body:
    """One entry of the registry: what every simulator's bodies have."""

    name: str  #: in the paper, for example "HC2"
    family: str  #: bodies of one family share observation and task
    engine: Engine  #: what moves it
    description: str  #: one sentence for tables and figure captions
    build: Callable[[], str] = field(repr=False, compare=False)  #: returns the MJCF text
    motors: tuple[Motor, ...]  #: in the order of the action and of the joints in the model
    length: tuple[str, float]  #: name and value in m of what sets the body apart in its family
    varied: tuple[str, ...]  #: links that have that length
    view: View  #: how it is looked at
    control_step_s: float
    max_steps: int = MAX_STEPS  #: control steps after which an episode is cut off
    #: of the floor, which rises along x; the floor stays the world's plane, and gravity is tilted
    slope_deg: float = 0.0
    #: what can be chosen of it, and its choice, by name
    parameters: Mapping[str, float] = field(default_factory=dict, hash=False)
    #: returns the body for other values of its parameters
    variants: "Callable[..., Body] | None" = field(default=None, repr=False, compare=False)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}: {self.description}>"

    def variant(self, **parameters: float) -> "Body":
        """Return this body with other values of some of its parameters.

        Raises SilemError if it has no such parameter, or a value is not allowed.
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
    def up(self) -> tuple[float, float, float]:
        """The direction against gravity, (x, y, z) in the floor's frame."""
        slope = math.radians(self.slope_deg)
        return math.sin(slope), 0.0, math.cos(slope)

    @property
    def can_fall(self) -> bool:
        """Whether an episode can end before its last step."""
        return True

    @property
    def action_size(self) -> int:
        """Number of motors."""
        return len(self.motors)


@dataclass(frozen=True, kw_only=True, repr=False)
class BulletBody(Body):
    """A body of PyBullet's locomotion tasks.

    Progress is measured by a mean position, over all links of the model and the floor. In `parts`
    a point stands for every link that coincides with it or whose position follows from it.
    """

    engine: Engine = "bullet"
    control_step_s: float = 0.0165  #: of PyBullet's locomotion tasks
    root: str  #: link whose pose and velocity enter the observation
    root_joints: tuple[str, ...]  #: along which a planar root moves (x, z, pitch), or none
    feet: tuple[str, ...]  #: links whose floor contact is observed, in the observation's order
    parts: tuple[Part, ...]  #: the points in the mean, the root first
    n_parts: int  #: number of parts in the mean
    alive: AliveRule

    @property
    def can_fall(self) -> bool:
        """Whether an episode ends when the body is no longer upright."""
        return self.alive.terminates

    @property
    def observation_size(self) -> int:
        """Eight numbers of the torso, two per motor, one per foot."""
        return 8 + 2 * len(self.motors) + len(self.feet)


@dataclass(frozen=True, kw_only=True)
class Skeleton:
    """The landmarks from which skeletal features are computed: origins of MuJoCo bodies.

    Shoulder, elbow, hip and knee are the bodies whose origin lies in that joint, for example the
    upper and the lower arm.
    """

    torso: str  #: whose frame is the torso frame
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
    axes: str = "xyz"  #: of the torso frame, those that point forward, left and up

    @classmethod
    def of_sides(cls, torso: str, head: str, left: str, right: str, **limbs: str) -> "Skeleton":
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
    """A humanoid in MuJoCo: a free root joint first, then hinges."""

    engine: Engine = "mujoco"
    control_step_s: float = 0.025  #: the model's timestep times `n_substeps`
    skeleton: Skeleton  #: its landmarks
    n_substeps: int = 5  #: simulation steps in one control step
    standing_pose: tuple[float, ...]  #: of all joints when it stands, soles on the floor, (nq,)
    standing_head_m: float  #: height of the head from which the reward counts it as standing
    fall_head_m: float  #: height of the head below which an episode ends
    target_speed_m_s: float  #: of the centre of mass, what earns the full reward
    #: returns the bodies of E environments, where each has one of its own in this one's place
    each: Callable[[int], Sequence["MujocoBody"]] | None = field(
        default=None, repr=False, compare=False
    )


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


# ---------------------------------------------------------------- model files


Edits = Mapping[tuple[str, str, str], Sequence[float]]
"""Numbers by tag and name of the one element `<tag name="name">`, and attribute."""


def pybullet_model(file: str, edits: Edits) -> str:
    """Return PyBullet's own `pybullet_data/mjcf/<file>`, `edited`; SilemError if there is none."""
    try:
        xml = (files("pybullet_data") / "mjcf" / file).read_bytes().decode("utf-8")
    except OSError as error:
        raise SilemError(f"pybullet_data has no model {file!r} ({error})") from error
    return edited(xml, edits)


def edited(xml: str, edits: Edits) -> str:
    """Return a model's text with some attributes replaced.

    The rest of it stays as it is, byte for byte: bodies of a family differ where they are meant to.
    Raises SilemError unless there is one such element, and the attribute.
    """
    for (tag, name, attribute), values in edits.items():
        elements = [e for e in re.findall(rf"<{tag}\b[^>]*>", xml) if f' name="{name}"' in e]
        if len(elements) != 1:
            raise SilemError(f"{len(elements)} elements <{tag} name={name!r}>, not one")
        replaced = rf'\g<1>{numbers(*values)}"'
        changed, count = re.subn(rf'(\s{attribute}=")[^"]*"', replaced, elements[0])
        if count != 1:
            raise SilemError(f"<{tag} name={name!r}> has no attribute {attribute!r}")
        xml = xml.replace(elements[0], changed)
    return xml


def numbers(*values: float) -> str:
    """Format numbers as MJCF writes them: at most six significant digits, by spaces."""
    return " ".join(f"{value:.6g}" for value in values)
