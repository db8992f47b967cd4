"""What every measurement has in common: contenders take turns, the table compares them."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import gymnasium
import numpy as np

from silem.envs import BatchedEnv

STEPS = 200  # per environment and repetition


class Contender(Protocol):
    """Something that steps a body."""

    def reset(self, seed: int) -> None:
        """Start an episode."""

    def run(self, actions: np.ndarray) -> None:
        """Step through (T, E, A) actions."""


class Batched:
    """One of our batched environments."""

    def __init__(self, env: BatchedEnv) -> None:
        """Keep the environment."""
        self.env = env

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self.env.seed(seed)
        self.env.reset()

    def run(self, actions: np.ndarray) -> None:
        """Step through (T, E, A) actions."""
        step = self.env.step
        for action in actions:
            step(action)


class Single:
    """Any Gymnasium environment."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        """Keep the environment."""
        self.env = env

    def reset(self, seed: int) -> None:
        """Start an episode."""
        self.env.reset(seed=seed)

    def run(self, actions: np.ndarray) -> None:
        """Step through (T, 1, A) actions."""
        step = self.env.step
        for action in actions[:, 0]:
            step(action)


@dataclass
class Row:
    """One row of the table.

    Attributes:
        name: What was timed.
        n_envs: Number of bodies that it steps.
        contender: Steps them.
        clock: Seconds: the processor's, unless threads share the work.
        rates: (N,) steps of one body per second, one per repetition.
    """

    name: str
    n_envs: int
    contender: Contender
    clock: Callable[[], float] = time.process_time
    rates: list[float] = field(default_factory=list)

    def repeat(self, seed: int, actions: np.ndarray) -> None:
        """Time the first E of (T, ..., A) actions from a new start."""
        self.contender.reset(seed)
        mine = np.ascontiguousarray(actions[:, : self.n_envs])
        start = self.clock()
        self.contender.run(mine)
        self.rates.append(len(actions) * self.n_envs / (self.clock() - start))

    def times(self, other: Row) -> float:
        """Median over repetitions of this row's rate over the other's."""
        return float(np.median(np.divide(self.rates, other.rates)))


@dataclass
class Measurement:
    """All rows of one body.

    Attributes:
        body: Its name.
        action_size: A.
        raw: Bare simulation, a row per number of environments.
        batched: Our batched environment, on as many each.
        others: More rows to compare.
        peer: The public environment, if there is one.
        target_times_peer: How often our batched environment should be as fast as that.
        target_share_of_raw: And what share of the bare simulation's rate it should reach.
    """

    body: str
    action_size: int
    raw: list[Row]
    batched: list[Row]
    others: list[Row]
    peer: Row | None = None
    target_times_peer: float = 1.0
    target_share_of_raw: float = 0.80

    @property
    def rows(self) -> list[Row]:
        """All rows, raw and batched alternating, so that they are timed one after the other."""
        pairs = [row for pair in zip(self.raw, self.batched, strict=True) for row in pair]
        return [*pairs, *self.others, *([self.peer] if self.peer else [])]

    def repeat(self, seed: int) -> None:
        """Time every row once, on the same actions."""
        rng = np.random.default_rng(seed)
        most = max(row.n_envs for row in self.rows)
        actions = rng.uniform(-1, 1, (STEPS, most, self.action_size)).astype(np.float32)
        for row in self.rows:
            row.repeat(seed, actions)

    def table(self) -> str:
        """Return the rows as text."""
        raw = {row.n_envs: row for row in self.raw}
        return "\n".join(
            f"{self.body:8} {row.name:34} {row.n_envs:4} {max(row.rates):9,.0f} "
            f"{np.median(row.rates):9,.0f} "
            + (f"{row.times(raw[row.n_envs]):9.1%} " if row.n_envs in raw else " " * 10)
            + (f"{row.times(self.peer):9.2f}" if self.peer else "")
            for row in self.rows
        )

    def verdict(self) -> str:
        """Say how our batched environment stands against the targets, at its best."""
        pairs = zip(self.raw, self.batched, strict=True)
        share, n = max((ours.times(raw), raw.n_envs) for raw, ours in pairs)
        text = f"{self.body}: {share:.1%} of raw with {n} " + _against(
            share, self.target_share_of_raw, f"{self.target_share_of_raw:.0%}"
        )
        if self.peer is None:
            return text
        times, n = max((row.times(self.peer), row.n_envs) for row in self.batched)
        return f"{text}, {times:.2f} times {self.peer.name} with {n} " + _against(
            times, self.target_times_peer, f"{self.target_times_peer}"
        )


def _against(value: float, target: float, text: str) -> str:
    return f"(target {text}: {'reached' if value >= target else 'missed'})"


def head() -> str:
    """Return the head of the tables."""
    titles = "".join(f"{title:>10}" for title in ("best", "median", "of raw", "x peer"))
    return f"{'body':8} {'what':34} envs{titles}"
