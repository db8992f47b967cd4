"""What "a random policy" returns on HC0, read in every way that its words allow.

The paper gives one number and does not say how its policy acts. It takes about a minute for
`python -m benchmarks.random_policy` to measure the readings and write ``data/random_policy.json``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from silem import bodies
from silem.study.evaluate import evaluate
from silem.util import files
from silem.util.paths import REPO

BODY, N_EPISODES = "HC0", 32
PATH = REPO / "data" / "random_policy.json"

Draw = Callable[[np.random.Generator, tuple[int, int]], np.ndarray]
READINGS: dict[str, Draw] = {
    "untrained Gaussian policy, N(0, 1); the raw action is charged": lambda rng, shape: (
        rng.standard_normal(shape)
    ),
    "the same, clipped to ±1 before it is charged": lambda rng, shape: rng.standard_normal(
        shape
    ).clip(-1, 1),
    "uniform in ±1": lambda rng, shape: rng.uniform(-1, 1, shape),
    "no action: all motors at zero": lambda rng, shape: np.zeros(shape),
}
"""Each reading with what it draws: actions (E, A), which the environment gets as they are."""


class _Reading:
    """Acts by one of `READINGS`, whatever it observes."""

    def __init__(self, draw: Draw) -> None:
        self._draw, self._size = draw, bodies.get(BODY).action_size

    def reseed(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def predict(self, observation: Any, *, deterministic: bool = False) -> tuple[Any, None]:
        actions = self._draw(self._rng, (len(observation), self._size))
        return actions.astype(np.float32), None


def measure(n_episodes: int = N_EPISODES) -> list[dict[str, Any]]:
    """Return each reading with the returns of its episodes; the same numbers on every call."""
    measured = []
    for name, draw in READINGS.items():
        returns = evaluate(_Reading(draw), BODY, n_episodes).returns
        measured.append({"reading": name, "body": BODY, "returns": returns})
    return measured


if __name__ == "__main__":
    files.write_json(PATH, measure())
