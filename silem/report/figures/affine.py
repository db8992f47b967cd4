"""The affine transforms that were learned: of every body by feature, and Figures 4a and 4b."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from silem import paper
from silem.report import results, style
from silem.report.features import Group, feature_groups, feature_names
from silem.report.figures import sources
from silem.util.errors import SilemError, choose

_BODY_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
_ENTRIES = {"scale": ("A", 1.0), "offset": ("b", 0.0)}
_TITLES = {
    "scale": "A, diagonal: 1 leaves a feature as it is",
    "offset": "b, offset in each feature's unit: 0 leaves a feature as it is",
}
_ARMS = ("left hand", "right hand", "elbow")
_GROUP_GAP = 0.7  # between two groups' features, which stand 1 apart


def transforms(frame: pd.DataFrame) -> Figure:
    """Draw the affine transforms that were learned: A's diagonal and b, for each feature.

    One row per named feature: a small mark per trial, a large one for the trials' mean. An
    untrained transform has A = 1 and b = 0. Bands tell groups of features apart.

    Args:
        frame: Runs of one study at one budget.

    Raises:
        SilemError: Some transform has not as many entries as its body has features.
    """
    frame = sources.runs_of("transforms", frame)
    names = results.body_names(frame)
    features = feature_names(names[0])
    with style.applied():
        figure, (left, right) = style.new_figure(6.4, ncols=2, sharey=True)
        left.set(title="A, diagonal (1: unchanged)", ylim=(len(features) - 0.4, -0.6))
        right.set(title="b, offset (0: unchanged)")
        left.set_yticks(range(len(features)), features)
        for axes, neutral in ((left, 1.0), (right, 0.0)):
            _feature_lines(axes, names[0], neutral)
        handles = []
        for index, body in enumerate(names):
            policies = _policies(frame, body)
            handles.append(_body_handle(body, index, len(names), len(policies.rows)))
            if len(policies.rows):
                _draw_marks(left, policies.values("A"), index, len(names))
                _draw_marks(right, policies.values("b"), index, len(names))
        figure.legend(handles=handles, loc="outside upper left", ncols=len(names))
        sources.footer(figure, frame)
    return figure


def affine_transforms(frame: pd.DataFrame, which: str) -> Figure:
    """Draw Figure 4a or 4b: A or b of Humanoid's and HumanoidR's best policies, by feature.

    A thin line is a policy, a thick one their mean; lines join the features of one group. Thick
    gridlines stand under the features of the arms, which HumanoidR's asymmetry touches. x is
    forward, y left and z up. A run of another number of iterations than planned
    is dashed and enters no mean.

    Args:
        frame: Runs of the study of the humanoids at one budget.
        which: "scale" (A, Figure 4a) or "offset" (b, Figure 4b).

    Raises:
        SilemError: Another `which`, runs of other bodies, or a transform of another length.
    """
    choose("part of the transform", which, _ENTRIES)
    frame = sources.runs_of("affine_transforms", frame)
    key, neutral = _ENTRIES[which]
    names = results.body_names(frame)
    groups = feature_groups(names[0])
    n_best = paper.number("best_policies_shown")
    with style.applied():
        figure, axes = style.new_figure(3.9)
        axes.set_title(_TITLES[which])
        axes.axhline(neutral, color=style.MUTED, lw=1, ls=(0, (4, 3)))
        places = _feature_axis(axes, groups)
        handles = []
        for index, body in enumerate(names):
            color = style.MUTED if index == 0 else style.body_color(1, 2)
            policies = _policies(frame, body).best(n_best)
            others = _policies(frame, body, stand_ins=True)
            for values in policies.values(key):
                _draw_line(
                    axes, groups, places, values, color=color, lw=0.8, alpha=0.55, marker=".", ms=3
                )
            for values in others.values(key):
                _draw_line(
                    axes,
                    groups,
                    places,
                    values,
                    color=color,
                    lw=1,
                    ls=(0, (3, 2)),
                    marker="x",
                    ms=4,
                )
            if len(policies.rows):
                mean = policies.values(key).mean(axis=0)
                mark = {"marker": _BODY_MARKERS[index], "ms": 5, "mec": "white", "mew": 0.6}
                _draw_line(axes, groups, places, mean, color=color, lw=2.4, **mark)
            handles.append(_line_handle(body, index, color, policies, others))
        axes.update_datalim([(0, neutral - 0.1), (0, neutral + 0.1)])  # shown at least
        axes.autoscale_view(scalex=False)
        figure.legend(handles=handles, loc="outside upper left", ncols=len(names))
        note = f"thin: a policy, thick: their mean; the paper shows each body's best {n_best}"
        sources.footer(figure, frame, note)
    return figure


@dataclass(frozen=True)
class _Policies:
    """The SILEM runs of one body."""

    body: str
    rows: pd.DataFrame

    def best(self, n: int) -> _Policies:
        """Keep the n runs of the highest return."""
        return _Policies(self.body, self.rows.sort_values("return_mean", ascending=False).head(n))

    def values(self, key: str) -> np.ndarray:
        """Return A or b of every run, (N, F)."""
        n_features = len(feature_names(self.body))
        loaded = [results.load_transform(run_id)[key] for run_id in self.rows["run_id"]]
        for values in loaded:
            if values.shape != (n_features,):
                raise SilemError(
                    f"transforms of {self.body}: {values.shape} for {n_features} features"
                )
        return np.array(loaded).reshape(-1, n_features)


def _policies(frame: pd.DataFrame, body: str, *, stand_ins: bool = False) -> _Policies:
    rows = (results.stand_ins if stand_ins else results.cell)(frame, "silem", body)
    return _Policies(body, rows)


def _feature_lines(axes: Axes, body: str, neutral: float) -> None:
    """Draw what lies behind the marks: a line per feature, and where nothing is changed."""
    axes.grid(axis="y", visible=True)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    axes.axvline(neutral, color=style.MUTED, lw=1, ls=(0, (4, 3)))
    axes.update_datalim([(neutral - 0.1, 0), (neutral + 0.1, 0)])  # shown at least
    axes.autoscale_view(scaley=False)
    for first, last in _spans(feature_groups(body))[1::2]:
        axes.axhspan(first - 0.5, last + 0.5, color="#f6f6f6", lw=0, zorder=0)


def _spans(groups: list[Group]) -> list[tuple[int, int]]:
    """Return first and last row of the groups; a joint's angle and velocity take turns, as one."""
    spans: list[tuple[int, int]] = []
    for group in groups:
        first, last = min(group.columns), max(group.columns)
        if spans and first < spans[-1][1]:
            first, last = spans[-1][0], max(last, spans.pop()[1])
        spans.append((first, last))
    return spans


def _draw_marks(axes: Axes, values: np.ndarray, index: int, count: int) -> None:
    """Draw one body's transforms, values (N, F), as marks in the features' rows."""
    rows = np.arange(values.shape[1]) + (index - (count - 1) / 2) * 0.26
    color, marker = style.body_color(index, count), _BODY_MARKERS[index]
    if len(values) > 1:
        for trial in values:
            axes.plot(trial, rows, marker, ms=2.5, color=color, alpha=0.45, mec="none")
    axes.plot(values.mean(axis=0), rows, marker, ms=5, color=color, mec="white", mew=0.5)


def _feature_axis(axes: Axes, groups: list[Group]) -> np.ndarray:
    """Lay the features along the x axis, named, in groups; return their places (F,)."""
    places = np.empty(sum(len(group.columns) for group in groups))
    for index, group in enumerate(groups):
        places[list(group.columns)] = np.array(group.columns) + index * _GROUP_GAP
        arm = group.name in _ARMS
        for place in places[list(group.columns)]:
            axes.axvline(
                place, color="#c9c9c9" if arm else "#ececec", lw=3 if arm else 0.8, zorder=0
            )
    labels = dict(chain.from_iterable(zip(g.columns, g.labels, strict=True) for g in groups))
    axes.set_xticks(places, [labels[column] for column in range(len(places))])
    axes.set_xlim(places[0] - 0.7, places[-1] + 0.7)
    axes.tick_params(axis="x", length=0, labelsize=7.5)
    names = axes.secondary_xaxis(-0.06)
    names.set_xticks(
        [places[list(group.columns)].mean() for group in groups],
        [f"{group.name}\n{f'({group.unit})' if group.unit else ' '}" for group in groups],
    )
    names.tick_params(length=0)
    names.spines[:].set_visible(False)
    return places


def _draw_line(
    axes: Axes, groups: list[Group], places: np.ndarray, values: np.ndarray, **line: Any
) -> None:
    """Draw one policy's values (F,), joined within each group."""
    for group in groups:
        columns = list(group.columns)
        axes.plot(places[columns], values[columns], **line)


def _body_handle(body: str, index: int, count: int, n_trials: int) -> Line2D:
    return Line2D(
        [], [], ls="none", marker=_BODY_MARKERS[index], ms=7, mec="white",
        color=style.body_color(index, count), label=f"{body}, {style.trials(n_trials)}",
    )  # fmt: skip


def _line_handle(
    body: str, index: int, color: str, policies: _Policies, others: _Policies
) -> Line2D:
    """Return a body's legend entry: its policies, and the iterations of its stand-ins."""
    count = len(policies.rows)
    words = {0: "no run", 1: "one policy"}.get(count, f"{count} policies")
    for row in others.rows.itertuples():
        words += f"; dashed: {row.n_iterations:,} iterations"
    return Line2D(
        [], [], color=color, lw=2.4, marker=_BODY_MARKERS[index], label=f"{body}, {words}"
    )
