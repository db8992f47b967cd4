"""Bodies of one's own: from modules that are named, and from installed packages."""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import sys
import warnings

from silem import bodies
from silem.bodies import Body, Entry
from silem.util.errors import SilemError

_MODULE_OF: dict[str, str] = {}
_loading: str | None = None


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
        _loading = None


def _note(body: Body | Entry) -> None:
    if _loading is not None:
        _MODULE_OF[body.name] = _loading


bodies.watch(_note)


def module_of(name: str) -> str | None:
    """Return the module whose `load` registered a body, or None where it was not loaded so."""
    return _MODULE_OF.get(name)


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
