"""The one exception of this package, and the one way to check a name or a number."""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any


class SilemError(ValueError):
    """A request that cannot be met; the message says what was wrong and what is allowed."""


def choose(kind: str, value: str, allowed: Iterable[str]) -> str:
    """Return `value` if it is one of the allowed names.

    Args:
        kind: What the name stands for ("body", "method", ...), used in the message.
        value: The name to check.
        allowed: The allowed names, in the order in which the message lists them.

    Returns:
        `value`, unchanged.

    Raises:
        SilemError: If `value` is not allowed.
    """
    names = list(allowed)
    if value not in names:
        raise SilemError(f"unknown {kind} {value!r}; allowed: {', '.join(names)}")
    return value


@dataclass(frozen=True)
class NumberKind:
    """A kind of number: what it is called, and which numbers are of it."""

    words: str
    holds: Callable[[Any], bool]


COUNT = NumberKind(
    "a whole number from 1", lambda n: isinstance(n, numbers.Integral) and int(n) >= 1
)
RATE = NumberKind("a number above 0", lambda x: x > 0)
WEIGHT = NumberKind("a finite number from 0", lambda x: 0 <= x < math.inf)
FACTOR = NumberKind("a number above 0 and at most 1", lambda x: 0 < x <= 1)


def check_numbers(values: Mapping[str, Any], kinds: Mapping[str, NumberKind]) -> None:
    """Check those of the named values that there are.

    Raises:
        SilemError: A value is no number, or not of its kind.
    """
    for name, kind in kinds.items():
        value = values.get(name, 1)
        number = isinstance(value, numbers.Real) and not isinstance(value, bool)
        if not number or not kind.holds(value):
            raise SilemError(f"{name} must be {kind.words}, not {value!r}")
