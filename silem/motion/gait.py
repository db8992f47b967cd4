"""How a man or a humanoid walks, measured on skeletal features g alone.

Seen from a walking body, a foot on the floor goes backward and one in the air goes forward. So a
foot lands where it is farthest ahead of the torso and leaves the floor where it is farthest behind,
and a man's clip is measured as a policy's episode is: without forces, floor or height of the torso.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from silem.motion.features import FEATURES
from silem.util.errors import SilemError

MIN_SWING_M = 0.1  #: a foot that moves less far back and forth makes no step
PIECE_S = 1.0  #: length of the pieces that `distance` compares, about a man's stride
_NAMES = [feature.name for feature in FEATURES]
_FEET = [[_NAMES.index(f"{side}_foot_{axis}") for axis in "xyz"] for side in ("left", "right")]
_UP = [_NAMES.index(f"torso_vertical_{axis}") for axis in "xyz"]


class Walk(NamedTuple):
    """Measures of a walk; NaN of a body that makes no steps, whose `step_hz` is 0."""

    step_hz: float  #: steps per second, of both feet together
    stance_left: float  #: share of the left foot's strides that it is on the floor
    stance_right: float
    clearance_m: float  #: how high a swinging foot gets above the other, median over swings
    #: the smaller over the larger of left's and right's stance, length of swing and time until the
    #: other foot lands, the least of the three: 1 if even, 0 if one foot makes all the steps
    symmetry: float


def walk(features: np.ndarray, rate_hz: float) -> Walk:
    """Measure consecutive states' features (T, F), `rate_hz` states a second."""
    _check(features)
    vertical = features[:, None, _UP].astype(np.float64)
    level = np.eye(3)[0] - vertical[..., :1] * vertical  # the torso's forward axis, made level
    level /= np.maximum(np.linalg.norm(level, axis=-1, keepdims=True), 1e-9)
    feet = features[:, _FEET].astype(np.float64)  # (T, 2, 3)
    ahead, height = (feet * level).sum(axis=-1), (feet * vertical).sum(axis=-1)
    above = height - height[:, ::-1]  # the other foot
    turns = [_turns(ahead[:, foot]) for foot in (0, 1)]
    n_turns, duration_s = sum(map(len, turns)), max(len(features) - 1, 1) / rate_hz
    stances, lengths, clearances = [], [], []
    for foot, found in enumerate(turns):
        phases = [(a, b, front) for (a, _), (b, front) in pairwise(found)]
        swings = [(a, b) for a, b, front in phases if front]
        on_floor, in_air = (_median([b - a for a, b, f in phases if f == x]) for x in (False, True))
        stances.append(on_floor / (on_floor + in_air))
        lengths.append(_median([ahead[b, foot] - ahead[a, foot] for a, b in swings]))
        clearances += [above[a : b + 1, foot].max() for a, b in swings]
    landings = [np.array([t for t, front in found if front]) for found in turns]
    times = [_median(_until_next(*pair)) for pair in (landings, landings[::-1])]
    ratios = [float(np.min(pair) / np.max(pair)) for pair in (stances, lengths, times)]
    even = min((ratio for ratio in ratios if ratio == ratio), default=np.nan)
    if min(map(len, landings)) == 0 < max(map(len, landings)):
        even = 0.0
    left, right = stances
    return Walk(n_turns / 2 / duration_s, left, right, _median(clearances), even)


def distance(features: np.ndarray, shown: np.ndarray, rate_hz: float) -> float:
    """Return how far features (T, F) are from a demonstration's (S, F), per state and feature.

    The unit is the feature's standard deviation in the demonstration. Pieces of `PIECE_S` are laid
    anywhere along it by dynamic time warping, at half to twice its pace: at each state of theirs it
    goes on by one state or two, or once by none. So standing in one of its states is no match.
    """
    _check(features)
    _check(shown)
    scale, total = shown.std(axis=0, dtype=np.float64), 0.0
    varied = scale > 0
    ours, theirs = (x[:, varied] / scale[varied] for x in (features, shown))
    for piece in np.array_split(ours, max(1, round(len(ours) / (PIECE_S * rate_hz)))):
        costs = np.abs(piece[:, None] - theirs).mean(axis=-1)
        stayed = np.full(len(shown), np.inf)
        moved = np.pad(costs[0], (2, 0), constant_values=np.inf)
        for row in costs[1:]:
            best = np.minimum(moved[2:], stayed)
            before = np.pad(best, (2, 0), constant_values=np.inf)
            stayed = row + moved[2:]
            moved[2:] = row + np.minimum(before[1:-1], before[:-2])
        total += np.minimum(moved[2:], stayed).min()
    return float(total / len(ours))


def _check(features: np.ndarray) -> None:
    if features.ndim != 2 or features.shape[1] != len(FEATURES) or not len(features):
        raise SilemError(f"features of shape {features.shape}; allowed: (T, {len(FEATURES)})")


def _turns(values: np.ndarray) -> list[tuple[int, bool]]:
    """Return where values (T,) turn after `MIN_SWING_M` or more, and whether they were highest."""
    found: list[tuple[int, bool]] = []
    low, high, up = 0, 0, None
    for t, value in enumerate(values):
        low, high = low if value > values[low] else t, high if value < values[high] else t
        if up is not False and values[high] - value >= MIN_SWING_M:
            found, up, low = [*found, (high, True)], False, t
        elif up is not True and value - values[low] >= MIN_SWING_M:
            found, up, high = [*found, (low, False)], True, t
    return found[1:] if found and found[0][0] == 0 else found  # where it began it did not turn


def _until_next(ones: np.ndarray, others: np.ndarray) -> list[float]:
    """Return how long after each of some times the next of the others comes, where one does."""
    return [float(others[others > t].min() - t) for t in ones if (others > t).any()]


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else np.nan
