"""The one exception of this package and the one way to check a name."""

from __future__ import annotations

from collections.abc import Iterable


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
