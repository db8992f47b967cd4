"""PyBullet's model files: read, and edited without touching anything else."""

from __future__ import annotations

import re
from importlib.resources import files

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
