"""The affine transforms that were learned, feature by feature: of bodies, of one run, Figure 4."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from silem import bodies, paper
from silem.bodies import BulletBody
from silem.motion.features import FEATURES
from silem.report import results, scores, style
from silem.study.record import TRANSFORM, RunRecord
from silem.util import files
from silem.util.errors import SilemError, choose

_BODY_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
_ENTRIES = {
    "scale": ("A", 1.0, "A, diagonal: 1 leaves a feature as it is"),
    "offset": ("b", 0.0, "b, offset in each feature's unit: 0 leaves a feature as it is"),
}
_ARMS = ("left hand", "right hand", "elbow")
_GROUP_GAP = 0.7  # between two groups' features, which stand 1 apart
_TORSO = (
    "height above start", "bearing, sine", "bearing, cosine", "forward velocity",
    "sideways velocity", "vertical velocity", "roll", "pitch",
)  # fmt: skip
_PARTS = {"b": "back ", "f": "front "}  # of HalfCheetah's joints and feet: `bthigh`


class Group(NamedTuple):
    """Features that belong together, "left hand" for instance, and are measured in one unit.

    Of a direction the unit is "", of a scaled feature it has a factor. `columns` are indices into
    `feature_names`; `labels` tell them apart within the group, e.g. x, y, z.
    """

    name: str
    unit: str
    columns: tuple[int, ...]
    labels: tuple[str, ...]


def feature_names(body: str) -> list[str]:
    """Name a body's features in their order: a PyBullet body's observation, or `FEATURES`."""
    if not isinstance(bodies.get(body), BulletBody):
        return [feature.label for feature in FEATURES]
    names: dict[int, str] = {}
    for group in feature_groups(body):
        kind = "" if group.name == "torso" else f" {group.name.rpartition(' ')[2]}"
        names |= {c: label + kind for c, label in zip(group.columns, group.labels, strict=True)}
    return [names[column] for column in sorted(names)]


def feature_groups(body: str) -> list[Group]:
    """Sort a body's features into groups: a runner's torso, angles, velocities and contacts."""
    known = bodies.get(body)
    if not isinstance(known, BulletBody):
        return _humanoid_groups()

    def readable(name: str) -> str:
        short = known.family == "halfcheetah" and name[0] in _PARTS
        return _PARTS[name[0]] + name[1:] if short else name.replace("_", " ")

    joints = tuple(readable(motor.joint) for motor in known.motors)
    feet = tuple(map(readable, known.feet))
    first, last = len(_TORSO), len(_TORSO) + 2 * len(joints)
    return [
        Group("torso", "m; 0.3 × m/s; rad", tuple(range(first)), _TORSO),
        Group("joint angle", "−1, 1: its limits", tuple(range(first, last, 2)), joints),
        Group("joint velocity", "0.1 × rad/s", tuple(range(first + 1, last, 2)), joints),
        Group("floor contact", "", tuple(range(last, last + len(feet))), feet),
    ]


def _humanoid_groups() -> list[Group]:
    """Return the limbs' positions, elbows, knees, head, torso's vertical and velocity."""
    members: dict[tuple[str, str], list[tuple[int, str]]] = {}
    for column, feature in enumerate(FEATURES):
        first, _, last = feature.label.rpartition(" ")
        if last in ("elbow", "knee"):  # left and right stand side by side
            first, last = last, first
        members.setdefault((first, feature.unit), []).append((column, last))
    return [
        Group(name, unit, *(tuple(part) for part in zip(*entries, strict=True)))
        for (name, unit), entries in members.items()
    ]


@style.applied()
def by_feature(frame: pd.DataFrame) -> Figure:
    """Draw A's diagonal and b by feature: small marks are trials, large ones their means."""
    frame = scores.runs_of("by_feature", frame)
    names, handles = results.body_names(frame), []
    figure, panels = _sheet(names[0], 6.4)
    for index, body in enumerate(names):
        rows = results.cell(frame, "silem", body)
        look: dict[str, Any] = {"ls": "none", "marker": _BODY_MARKERS[index]}
        look["color"] = style.body_color(index, len(names))
        label = f"{body}, {style.trials(len(rows))}"
        handles.append(style.handle(label=label, ms=7, mec="white", **look))
        for entry, axes in panels.items():
            values = _values(rows, entry)
            places = np.arange(values.shape[1]) + (index - (len(names) - 1) / 2) * 0.78 / len(names)
            for trial in values if len(values) > 1 else ():
                axes.plot(trial, places, ms=2.5, alpha=0.45, mec="none", **look)
            if len(values):
                axes.plot(values.mean(axis=0), places, ms=5, mec="white", mew=0.5, **look)
    for axes in panels.values() if frame.empty else ():
        style.say(axes, "no run")
    figure.legend(handles=handles, loc="outside upper left", ncols=min(len(names), 4))
    scores.footer(figure, frame)
    return figure


@style.applied()
def of_run(record: RunRecord) -> Figure:
    """Draw the affine transform that one run learned, feature by feature."""
    arrays, body = files.read_npz(record.file(TRANSFORM)), record.config["body"]
    rows, color = np.arange(len(feature_names(body))), style.method("silem").color
    figure, panels = _sheet(body, 0.21 * len(rows) + 1.0)
    for (entry, axes), neutral in zip(panels.items(), (1.0, 0.0), strict=True):
        axes.hlines(rows, neutral, arrays[entry], color=color, lw=1.6)
        axes.plot(arrays[entry], rows, "o", ms=4.5, color=color)
        axes.ticklabel_format(axis="x", useOffset=False)
        axes.xaxis.set_major_locator(MaxNLocator(5))
    style.footer(figure, record.run_id)
    return figure


@style.applied()
def figure_4(frame: pd.DataFrame, which: str) -> Figure:
    """Draw Figure 4a or 4b: A or b of Humanoid's and HumanoidR's best policies, by feature.

    A thin line is a policy, a thick one their mean; lines join the features of one group. Thick
    gridlines stand under the features of the arms, which HumanoidR's asymmetry touches. A run of
    another number of iterations than planned is dashed and enters no mean. `which` is "scale" (A,
    Figure 4a) or "offset" (b, Figure 4b).
    """
    entry, neutral, title = _ENTRIES[choose("part of the transform", which, _ENTRIES)]
    frame = scores.runs_of("figure_4", frame)
    names, handles = results.body_names(frame), []
    groups, n_best = feature_groups(names[0]), paper.number("best_policies_shown")
    figure, axes = style.new_figure(3.9)
    axes.set_title(title)
    axes.axhline(neutral, color=style.MUTED, lw=1, ls=style.DASHED)
    places = _feature_axis(axes, groups)
    for index, body in enumerate(names):
        color = style.MUTED if index == 0 else style.body_color(1, 2)
        thick: dict[str, Any] = {"color": color, "lw": 2.4, "marker": _BODY_MARKERS[index]}
        thin: dict[str, Any] = {"lw": 0.8, "alpha": 0.55, "marker": ".", "ms": 3}
        dashed: dict[str, Any] = {"lw": 1, "ls": (0, (3, 2)), "marker": "x", "ms": 4}
        rows, others = (of(frame, "silem", body) for of in (results.cell, results.stand_ins))
        best = _values(rows.sort_values("return_mean", ascending=False).head(n_best), entry)
        lines = [(values, thin) for values in best]
        lines += [(values, dashed) for values in _values(others, entry)]
        if len(best):
            lines.append((best.mean(axis=0), thick | {"ms": 5, "mec": "white", "mew": 0.6}))
        for values, look in lines:
            for columns in (list(group.columns) for group in groups):
                axes.plot(places[columns], values[columns], **{"color": color} | look)
        words = {0: "no run", 1: "one policy"}.get(len(best), f"{len(best)} policies")
        words += "".join(f"; dashed: {n:,} iterations" for n in others["n_iterations"])
        handles.append(style.handle(label=f"{body}, {words}", **thick))
    axes.update_datalim([(0, neutral - 0.1), (0, neutral + 0.1)])  # shown at least
    axes.autoscale_view(scalex=False)
    figure.legend(handles=handles, loc="outside upper left", ncols=len(names))
    note = f"thin: a policy, thick: their mean; the paper shows each body's best {n_best}"
    scores.footer(figure, frame, note)
    return figure


def _values(rows: pd.DataFrame, entry: str) -> np.ndarray:
    """Return A or b of some runs of one body, (N, F); (0, 0) without any."""
    loaded = [results.load_transform(run_id)[entry] for run_id in rows["run_id"]]
    for body, values in zip(rows["body"], loaded, strict=True):
        if values.shape != (n_features := len(feature_names(body)),):
            raise SilemError(f"transforms of {body}: {values.shape} for {n_features} features")
    return np.array(loaded) if loaded else np.empty((0, 0))


def _sheet(body: str, height_in: float) -> tuple[Figure, dict[str, Axes]]:
    """Return an empty figure of transforms, a row per feature, and its panels by entry, A and b."""
    names = feature_names(body)
    figure, panels = style.new_figure(height_in, ncols=2, sharey=True)
    panels[0].set(ylim=(len(names) - 0.4, -0.6))
    panels[0].set_yticks(range(len(names)), names)
    titles = ("A, diagonal (1: unchanged)", "b, offset (0: unchanged)")
    for axes, title, (_, neutral, _) in zip(panels, titles, _ENTRIES.values(), strict=True):
        axes.set_title(title)
        axes.grid(axis="y", visible=True)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        axes.axvline(neutral, color=style.MUTED, lw=1, ls=style.DASHED)
        axes.update_datalim([(neutral - 0.1, 0), (neutral + 0.1, 0)])  # shown at least
        axes.autoscale_view(scaley=False)
        for first, last in _spans(feature_groups(body))[1::2]:
            axes.axhspan(first - 0.5, last + 0.5, color="#f6f6f6", lw=0, zorder=0)
    return figure, {"A": panels[0], "b": panels[1]}


def _spans(groups: list[Group]) -> list[tuple[int, int]]:
    """Return first and last row of the groups; a joint's angle and velocity take turns, as one."""
    spans: list[tuple[int, int]] = []
    for group in groups:
        first, last = min(group.columns), max(group.columns)
        if spans and first < spans[-1][1]:
            first, last = spans[-1][0], max(last, spans.pop()[1])
        spans.append((first, last))
    return spans


def _feature_axis(axes: Axes, groups: list[Group]) -> np.ndarray:
    """Lay the features along the x axis, named, in groups; return their places (F,)."""
    labels = {c: t for g in groups for c, t in zip(g.columns, g.labels, strict=True)}
    places = np.arange(len(labels), dtype=float)
    for index, group in enumerate(groups):
        columns = list(group.columns)
        places[columns] += index * _GROUP_GAP
        color, lw = ("#c9c9c9", 3.0) if group.name in _ARMS else ("#ececec", 0.8)
        for place in places[columns]:
            axes.axvline(place, zorder=0, color=color, lw=lw)
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
