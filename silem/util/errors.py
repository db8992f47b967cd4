"""The one exception of this package, and the one way to check a name, a number or a file's name."""

from __future__ import annotations

import math
import numbers
import re
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
        raise SilemError(f"unknown {kind} {clipped(repr(value))}; allowed: {', '.join(names)}")
    return value


def check_name(kind: str, value: Any, longest: int = 64) -> str:
    """Return `value` if it can be the name of a file or folder; every name that becomes one may.

    Args:
        kind: What the name stands for ("study", "run id", ...), used in the message.
        value: The name to check.
        longest: How many characters it may have.

    Raises:
        SilemError: If it holds anything but letters, digits, ``.``, ``_`` and ``-``, does not begin
            with a letter or digit, or is too long.
    """
    if (
        not isinstance(value, str)
        or len(value) > longest
        or not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", value)
    ):
        raise SilemError(
            f"{kind} must be a name of at most {longest} letters, digits, '.', '_' and '-', and"
            f" begin with a letter or digit, not {clipped(repr(value))}"
        )
    return value


def reason(error: BaseException) -> str:
    """Return what an exception says, in one line of bearable length."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return clipped(" ".join(str(text).split()))


def clipped(text: str, longest: int = 200) -> str:
    """Return a text, cut where it is too long for a message."""
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


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
