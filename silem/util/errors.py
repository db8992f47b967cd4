"""The one exception of this package, and the one way to check a name, a number or a file's name."""

import re
import sys
from collections.abc import Callable, Iterable
from numbers import Integral, Real
from typing import Any, NamedTuple


class SilemError(ValueError):
    """A request that cannot be met; the message says what was wrong and what is allowed."""


def choose(kind: str, value: str, allowed: Iterable[str]) -> str:
    """Return `value` if it is one of the allowed names.

    Raises SilemError: It is not; the message says which `kind` of name and lists what is allowed.
    """
    names = list(allowed)
    if value not in names:
        listed = ", ".join(names) or "none"
        raise SilemError(f"unknown {kind} {clipped(repr(value))}; allowed: {listed}")
    return value


def check_name(kind: str, value: Any, longest: int = 64) -> str:
    """Return `value` if it can be a file's or folder's name, as every name that becomes one must.

    Raises SilemError: It holds anything but letters, digits, ``.``, ``_`` and ``-``, does not begin
    with a letter or digit, or is longer than `longest`.
    """
    allowed = rf"[A-Za-z0-9][A-Za-z0-9._-]{{0,{longest - 1}}}"
    if not isinstance(value, str) or not re.fullmatch(allowed, value):
        rule = f"at most {longest} letters, digits, '.', '_' and '-', a letter or digit first"
        raise SilemError(f"{kind} must be a name of {rule}, not {clipped(repr(value))}")
    return value


def reason(error: BaseException) -> str:
    """Return what an exception says, in one line of bearable length."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return clipped(" ".join(str(text).split()))


def clipped(text: str, longest: int = 200) -> str:
    """Return a text, cut where it is too long for a message."""
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


LARGEST = 10**9  #: more of anything cannot be run through
_HIGHEST = sys.float_info.max


class NumberKind(NamedTuple):
    """A kind of number: what it is called, and which numbers are of it."""

    words: str
    holds: Callable[[Any], bool]

    def check(self, name: str, value: Any) -> None:
        """Raise SilemError unless the value of that name is a number of this kind."""
        number = isinstance(value, Real) and not isinstance(value, bool)
        if not number or not self.holds(value if isinstance(value, Integral) else float(value)):
            raise SilemError(f"{name} must be {self.words}, not {clipped(repr(value))}")


COUNT = NumberKind(
    f"a whole number from 1 to {LARGEST}",
    lambda n: isinstance(n, Integral) and 0 < int(n) <= LARGEST,
)
SEED = NumberKind(
    "a whole number from 0 to 2**32 - 1", lambda n: isinstance(n, Integral) and 0 <= int(n) < 2**32
)
NUMBER = NumberKind("a finite number", lambda x: abs(x) <= _HIGHEST)
RATE = NumberKind("a finite number above 0", lambda x: 0 < x <= _HIGHEST)
BOUND = NumberKind("a number above 0", lambda x: x > 0)
WEIGHT = NumberKind("a finite number from 0", lambda x: 0 <= x <= _HIGHEST)
FACTOR = NumberKind("a number from 0 to 1", lambda x: 0 <= x <= 1)
