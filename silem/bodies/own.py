"""Bodies of one's own: from modules that are named, and from installed packages."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import importlib.metadata
import os
import sys
import warnings

from silem import bodies
from silem.bodies import Body, Entry
from silem.util.errors import SilemError

_OWN: dict[str, tuple[Body | Entry, str]] = {}  # and the module whose `load` registered each
_loading = ""


def load(module: str) -> None:
    """Import a module that registers bodies of one's own, looked for in the working folder too.

    Raises:
        SilemError: It cannot be imported, whatever the reason.
    """
    global _loading
    if (here := os.getcwd()) not in sys.path:
        sys.path.insert(0, here)  # as `python -m` has it; a console script has not
    _loading = module
    try:
        importlib.import_module(module)
    except Exception as error:  # a stranger's module may raise anything
        raise SilemError(f"cannot import {module}: {type(error).__name__}: {error}") from error
    finally:
        _loading = ""


def _note(body: Body | Entry) -> None:
    _OWN[body.name] = body, _loading


bodies.watch(_note)
_OWN.clear()  # those are the package's


def identity(name: str) -> dict[str, str] | None:
    """Return what tells a body of one's own from others of its name: its module, and a hash of it.

    None for the package's bodies and for Gymnasium's environments. The module is "" where no
    `load` registered the body.
    """
    known, module = _OWN.get(name, (None, ""))
    if known is None or name not in bodies.names() or bodies.get(name) is not known:
        return None
    body = bodies.get(name)
    told = {
        field.name: getattr(body, field.name) for field in dataclasses.fields(body) if field.repr
    }
    del told["description"]
    digest = hashlib.sha256(f"{told}\n{body.model_xml()}".encode()).hexdigest()
    return {"module": module, "sha256": digest}


def module_of(name: str) -> str:
    """Return the module whose `load` registered a body, or ""."""
    return (identity(name) or {}).get("module", "")


def load_installed() -> None:
    """Load the bodies of installed packages: their entry points in the group ``silem.bodies``.

    An entry point names a module, whose import registers them, or a function, which is called. One
    that fails is told of in a warning; the others are loaded nevertheless.
    """
    for point in importlib.metadata.entry_points(group="silem.bodies"):
        try:
            found = point.load()
            if callable(found):
                found()
        except Exception as error:
            warnings.warn(
                f"the bodies of {point.value} are left out: {type(error).__name__}: {error}",
                stacklevel=2,
            )
