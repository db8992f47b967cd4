"""PyBullet's model files: read, edited without touching anything else, and their shapes."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from silem.bodies.body import Body
from silem.util.errors import SilemError


def source(name: str) -> str:
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


@dataclass(frozen=True)
class Shape:
    """A capsule, or a sphere, which is a capsule of length zero.

    Attributes:
        name: Name of the geom in the model.
        link: Link that carries it.
        depth: Number of links with shapes between that link and the root.
        start: (3,) centre of one cap in the link's frame, in m.
        end: (3,) centre of the other.
        radius_m: Radius.
    """

    name: str
    link: str
    depth: int
    start: np.ndarray
    end: np.ndarray
    radius_m: float

    @property
    def length_m(self) -> float:
        """Length between the centres of the caps."""
        return float(np.linalg.norm(self.end - self.start))


def shapes(body: Body) -> list[Shape]:
    """Return the shapes of a body, from the root outwards.

    Raises:
        SilemError: If the model has a geom that is neither a capsule nor a sphere.
    """
    world = ElementTree.fromstring(body.model_xml()).find("worldbody")
    if world is None:
        raise SilemError(f"model of body {body.name!r} has no worldbody")
    found: list[Shape] = []

    def visit(link: ElementTree.Element, depth: int) -> None:
        found.extend(_shape(geom, link.get("name", ""), depth) for geom in link.findall("geom"))
        for child in link.findall("body"):
            visit(child, depth + 1)

    for root in world.findall("body"):
        visit(root, 0)
    return found


def _shape(geom: ElementTree.Element, link: str, depth: int) -> Shape:
    name, kind = geom.get("name", ""), geom.get("type")
    size = _numbers(geom.get("size", ""))
    center = _numbers(geom.get("pos", "0 0 0"))
    if kind == "capsule" and "fromto" in geom.attrib:
        start, end = _numbers(geom.attrib["fromto"]).reshape(2, 3)
    elif kind == "capsule":
        half = size[1] * _turned_z(_numbers(geom.get("axisangle", "0 0 1 0")))
        start, end = center - half, center + half
    elif kind == "sphere":
        start = end = center
    else:
        raise SilemError(f"geom {name!r} is a {kind}; allowed: capsule, sphere")
    return Shape(name, link, depth, start, end, float(size[0]))


def _turned_z(axis_angle: np.ndarray) -> np.ndarray:
    """Return (3,) the z axis, turned about a unit axis by an angle in rad."""
    axis, angle = axis_angle[:3], axis_angle[3]
    z = np.array([0.0, 0.0, 1.0])
    turned = math.cos(angle) * z + math.sin(angle) * np.cross(axis, z)
    return turned + (1 - math.cos(angle)) * axis[2] * axis


def _numbers(text: str) -> np.ndarray:
    return np.array([float(number) for number in text.split()])
