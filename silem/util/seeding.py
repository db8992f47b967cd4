"""One root seed, many named random streams.

A stream is named by words and numbers, so adding a stage to a run, or asking for the stages in
another order, leaves every other stage's random numbers as they were.
"""

import hashlib

import numpy as np


def _sequence(root: int, names: tuple[str | int, ...]) -> np.random.SeedSequence:
    # A type prefix keeps the name "1" and the number 1 apart; hashing gives every name the same
    # fixed number of key words, so that no two lists of names can run into each other.
    key: list[int] = []
    for name in names:
        text = f"{'int' if isinstance(name, int) else 'str'}:{name}"
        digest = hashlib.sha256(text.encode()).digest()
        key.extend(int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4))
    return np.random.SeedSequence(root, spawn_key=tuple(key))


def child_seed(root: int, *names: str | int) -> int:
    """Return the seed in ``[0, 2**31)`` of a stream of a root seed, named e.g. ``"env", 25``."""
    return int(_sequence(root, names).generate_state(1)[0] >> 1)


def generator(root: int, *names: str | int) -> np.random.Generator:
    """Return the NumPy generator of a named stream (see `child_seed`)."""
    return np.random.default_rng(_sequence(root, names))
