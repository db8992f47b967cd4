"""The strict door for a notebook's parameters.

A notebook's second cell, tagged ``parameters``, holds plain literals; papermill injects a cell of
overriding literals after it. papermill only warns about a name the notebook does not know and
never checks a type, so a misspelt parameter would silently run the defaults. The third cell
therefore calls :func:`parameters`.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping, Sequence
from itertools import chain, groupby
from types import SimpleNamespace
from typing import Any

from silem.util.errors import SilemError

_PLAIN_TYPES = (str, int, float, bool, list, tuple, dict, type(None))


def parameters(namespace: Mapping[str, Any], /, **schema: type | Sequence[str]) -> SimpleNamespace:
    """Check a notebook's parameters and return them as attributes.

    Call it in the notebook's third cell::

        p = parameters(globals(), body=bodies.names(), budget=list(BUDGETS), seed=int)

    Inside Jupyter and papermill, the names checked are those assigned by the last cells
    that held nothing but assignments of literals: the ``parameters`` cell and the one papermill
    injects after it. Variables of other cells are therefore no parameters, and the cell can be run
    again at any time. A mapping that no notebook stands behind is checked whole.

    Args:
        namespace: The notebook's ``globals()``, or a dict of parameters.
        **schema: For each parameter its type (``str``, ``int``, ``float`` or ``bool``) or the
            strings allowed. An ``int`` is taken for a ``float``; a ``bool`` is never a number.

    Returns:
        The parameters as attributes, in the schema's order.

    Raises:
        SilemError: Some parameter is unknown, missing, of a wrong type, not finite, or not one
            of the strings allowed. The message names each and lists what is allowed.
    """
    problems = [f"unknown parameter {n!r}" for n in _given(namespace) if n not in schema]
    problems += [f"parameter {name!r} is missing" for name in schema if name not in namespace]
    values = {name: namespace[name] for name in schema if name in namespace}
    for name, value in values.items():
        if not _conforms(value, schema[name]):
            problems.append(f"{name} = {value!r} is not {_describe(schema[name])}")
        elif schema[name] is float:
            values[name] = float(value)
    if problems:
        listing = "; ".join(f"{name}: {_describe(allowed)}" for name, allowed in schema.items())
        raise SilemError(f"{'; '.join(problems)}. Allowed: {listing}")
    return SimpleNamespace(**values)


def _given(namespace: Mapping[str, Any]) -> list[str]:
    """Return the names set as parameters: in a notebook, by its last literal-only cells."""
    if "get_ipython" not in namespace:
        return [n for n, v in namespace.items() if n[:1] != "_" and isinstance(v, _PLAIN_TYPES)]
    assigned = [literal_assignments(source) for source in namespace.get("In", [])]
    neighbours = [list(cells) for literal, cells in groupby(assigned, key=bool) if literal]
    names = chain(*neighbours[-1]) if neighbours else ()
    return [name for name in dict.fromkeys(names) if name in namespace]


def literal_assignments(source: str) -> list[str]:
    """Return the names that a cell assigns, if it does nothing but assign literals, else []."""
    try:
        statements = ast.parse(source).body
    except SyntaxError:
        return []
    names = []
    for statement in statements:
        if not isinstance(statement, ast.Assign | ast.AnnAssign) or not _literal(statement.value):
            return []
        targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
        names += [target.id for target in targets if isinstance(target, ast.Name)]
    return names


def _literal(node: ast.expr | None) -> bool:
    """Whether an expression is a literal; papermill writes nan and inf as ``float('nan')``."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "float":
        return all(isinstance(argument, ast.Constant) for argument in node.args)
    try:
        ast.literal_eval(node)  # type: ignore[arg-type]
    except (ValueError, TypeError):
        return False
    return True


def _conforms(value: Any, allowed: type | Sequence[str]) -> bool:
    """Whether a parameter's value is what the schema allows."""
    if not isinstance(allowed, type):
        return isinstance(value, str) and value in allowed
    if isinstance(value, bool) or allowed is bool:
        return isinstance(value, bool) and allowed is bool
    if allowed is float:
        return isinstance(value, int | float) and math.isfinite(value)
    return isinstance(value, allowed)


def _describe(allowed: type | Sequence[str]) -> str:
    """What the schema allows, in words."""
    if isinstance(allowed, type):
        return "a finite float" if allowed is float else f"of type {allowed.__name__}"
    return f"one of {', '.join(allowed)}"
