"""The affine transforms that were learned, feature by feature: of bodies (Figure 4), of one run."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from silem import bodies, paper
from silem.bodies import BulletBody
from silem.motion.demonstrations import Demonstrations, file_of, retargeted
from silem.motion.features import FEATURES
from silem.report import results, scores, statistics, style
from silem.report.style import number
from silem.study.runs import TRANSFORM, RunRecord
from silem.study.settings import HUMAN
from silem.util import files
from silem.util.errors import SilemError, choose

_MARKERS = ("o", "s", "^", "D", "v", "P", "X")
_ENTRIES = {
    "A": ("A, diagonal (1: unchanged)", 1.0),
    "b": ("b, offset (0: unchanged)", 0.0),
}
_ARMS = ("left hand", "right hand", "elbow")
_LIMBS = (*_ARMS[:2], "left foot", "right foot")
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
    """Sort a body's features: a runner's torso, joints and contacts, or a humanoid's limbs."""
    known = bodies.get(body)
    if not isinstance(known, BulletBody):
        members: dict[tuple[str, str], list[tuple[int, str]]] = {}
        for column, feature in enumerate(FEATURES):
            first, _, last = feature.label.rpartition(" ")
            if last in ("elbow", "knee"):  # left and right stand side by side
                first, last = last, first
            members.setdefault((first, feature.unit), []).append((column, last))
        return [Group(*key, *zip(*entries, strict=True)) for key, entries in members.items()]

    def readable(name: str) -> str:
        short = known.family == "halfcheetah" and name[0] in _PARTS
        return _PARTS[name[0]] + name[1:] if short else name.replace("_", " ")

    joints = tuple(readable(motor.joint) for motor in known.motors)
    feet = tuple(map(readable, known.feet))
    start, end = len(_TORSO), len(_TORSO) + 2 * len(joints)
    return [
        Group("torso", "m; 0.3 × m/s; rad", tuple(range(start)), _TORSO),
        Group("joint angle", "−1, 1: its limits", tuple(range(start, end, 2)), joints),
        Group("joint velocity", "0.1 × rad/s", tuple(range(start + 1, end, 2)), joints),
        Group("floor contact", "", tuple(range(end, end + len(feet))), feet),
    ]


@style.applied()
def by_feature(frame: pd.DataFrame) -> Figure:
    """Draw A's diagonal and b by feature, as Figure 4: large marks are means over policies.

    They are those of the best policies, at most as many as the paper shows, each a small mark.
    Lines join the features of a group, and stripes lie under those of a humanoid's arms, which
    HumanoidR's asymmetry touches; an upright stroke is what is `expected` by the limbs' lengths.
    """
    frame = scores.runs_of("by_feature", frame)
    names, handles, n_best = results.body_names(frame), [], paper.number("best_policies_shown")
    figure, panels, rows = sheet(names[0], 6.4)
    for index, body in enumerate(names):
        runs = results.cell(frame, "silem", body)
        best = runs.sort_values("return_mean", ascending=False).head(n_best)
        look: dict[str, Any] = {"color": style.body_color(index, len(names))}
        look |= {"marker": _MARKERS[index], "mec": "white"}
        places = rows + (index - (len(names) - 1) / 2) * 0.7 / len(names)
        tidy = learned(best)
        for entry, axes in panels.items():
            values = tidy[entry].to_numpy(float).reshape(-1, len(places))
            for trial in values if len(values) > 1 else ():
                small = {"ls": "none", "ms": 2.5, "alpha": 0.45, "mec": "none"}
                axes.plot(trial, places, **look | small)
            for group in feature_groups(body) if len(values) else ():
                columns = list(group.columns)
                axes.plot(values.mean(axis=0)[columns], places[columns], ms=5, lw=0.8, **look)
        if np.isfinite(hoped := expected(body)).any():
            panels["A"].plot(hoped, places, "|", color=look["color"], ms=8, mew=2)
        label = f"{body}, {style.trials(len(best))}"
        handles.append(style.handle(label=label, ms=7, ls="none", **look))
    note = f"small: a policy, large: their mean; a body's best {n_best} at most, as in Figure 4"
    if any(np.isfinite(expected(body)).any() for body in names):
        note += "; upright strokes: the ratio of the limbs' distances from the torso"
    return scores.finish(figure, frame, handles, note)


def expected(body: str) -> np.ndarray:
    """Return what a humanoid's A, (F,), is by its limbs: the man's distances over the body's.

    They are a hand's or foot's from the torso, means over his walk and over the same walk that
    inverse kinematics gives the body; NaN of other features, and of bodies that no walk is given.
    """
    ratios = np.full(len(feature_names(body)), np.nan)
    if file_of(retargeted(HUMAN, body)).exists():
        walks = [Demonstrations.load(n).features[0] for n in (HUMAN, retargeted(HUMAN, body))]
        for columns in (list(g.columns) for g in feature_groups(body) if g.name in _LIMBS):
            man, ours = (np.linalg.norm(walk[:, columns], axis=1).mean() for walk in walks)
            ratios[columns] = man / ours
    return ratios


def agreement(frame: pd.DataFrame) -> pd.DataFrame:
    """Return, as text, A of humanoids' limbs beside `expected`, and their rank correlation.

    A is the mean over a body's best policies. The correlation is over the limbs' coordinates, three
    of which share an expectation.
    """
    rows = []
    for body in results.body_names(frame):
        runs = results.cell(frame, "silem", body).sort_values("return_mean", ascending=False)
        hoped, best = expected(body), learned(runs.head(paper.number("best_policies_shown")))
        best = best["A"].to_numpy(float).reshape(-1, len(hoped))
        row = {"body": body, "policies": str(len(best))}
        for group in (g for g in feature_groups(body) if g.name in _LIMBS):
            columns = list(group.columns)
            scale = number(best[:, columns].mean() if len(best) else None, 2)
            row[group.name] = f"{number(hoped[columns[0]], 2)} → {scale}"
        known = np.isfinite(hoped)
        row["rank correlation"] = style.DASH
        if len(best) and known.any():
            rho, *ends = statistics.rank_correlation(hoped[known], best.mean(axis=0)[known])
            row["rank correlation"] = style.estimate(rho, (ends[0], ends[1]), 2)
        rows.append(row)
    return pd.DataFrame(rows)


@style.applied()
def of_run(record: RunRecord) -> Figure:
    """Draw the affine transform that one run learned, feature by feature."""
    arrays, body = files.read_npz(record.file(TRANSFORM)), record.config["body"]
    color = style.method("silem").color
    figure, panels, rows = sheet(body, 0.21 * len(feature_names(body)) + 1.0)
    for entry, axes in panels.items():
        axes.hlines(rows, _ENTRIES[entry][1], arrays[entry], color=color, lw=1.6)
        axes.plot(arrays[entry], rows, "o", ms=4.5, color=color)
        axes.ticklabel_format(axis="x", useOffset=False)
        axes.xaxis.set_major_locator(MaxNLocator(5))
    return style.finish(figure, note=record.run_id)


@style.applied()
def against(
    frame: pd.DataFrame, x: Mapping[str, float], label: str, features: Sequence[str]
) -> Figure:
    """Draw A and b of some features (`feature_names`) against a number of each body, say a length.

    Lines are means over trials.
    """
    runs, known = results.select(frame, ["silem"], list(x)), feature_names(next(iter(x)))
    looks = {
        choose("feature", name, known): style.MethodStyle(name, name, f"C{index}", marker)
        for index, (name, marker) in enumerate(zip(features, _MARKERS, strict=False))
    }
    titles = {entry: title for entry, (title, _) in _ENTRIES.items()}
    figure = scores.draw_against(learned(runs), x, label, titles, "feature", looks)
    for axes, (_, neutral) in zip(figure.axes, _ENTRIES.values(), strict=True):
        axes.axhline(neutral, color=style.MUTED, lw=1, ls=style.DASHED)
    note = "lines: means over trials"
    return scores.finish(figure, runs, style.marks(looks.values()), note, ncols=4)


def learned(frame: pd.DataFrame) -> pd.DataFrame:
    """Return what T learned in a table's runs of SILEM: a row for each run and feature.

    Columns are ``run_id``, ``body``, ``method``, ``feature`` (`feature_names`), ``A`` and ``b``.
    """
    columns = ["run_id", "body", "method"]
    parts = [pd.DataFrame(columns=[*columns, "feature", *_ENTRIES])]
    for run in frame.loc[frame["method"].eq("silem"), columns].to_dict("records"):
        arrays, names = results.load_transform(run["run_id"]), feature_names(run["body"])
        if arrays["A"].shape != (len(names),):
            found = f"{arrays['A'].shape} for {len(names)} features"
            raise SilemError(f"transforms of {run['body']}: {found}")
        entries = {entry: arrays[entry] for entry in _ENTRIES}
        parts.append(pd.DataFrame(run | {"feature": names} | entries))
    return pd.concat(parts[1:] or parts, ignore_index=True)


def sheet(
    body: str, height_in: float, entries: Mapping[str, tuple[str, float]] = _ENTRIES
) -> tuple[Figure, dict[str, Axes], np.ndarray]:
    """Return an empty figure of transforms, its panels by entry, and each feature's row, (F,).

    Of each entry there is a title and a value that a line marks. Groups of features stand together,
    every other one on grey, their units to the right.
    """
    figure, panels = style.new_figure(height_in, ncols=2, sharey=True)
    groups, names = feature_groups(body), feature_names(body)
    order = [column for group in groups for column in group.columns]
    rows = np.argsort(order).astype(float)
    for axes, (title, neutral) in zip(panels, entries.values(), strict=True):
        axes.set(title=title, ylim=(len(names) - 0.4, -0.6))
        axes.grid(axis="y", visible=True)
        axes.tick_params(axis="y", length=0)
        axes.spines["left"].set_visible(False)
        axes.axvline(neutral, color=style.MUTED, lw=1, ls=style.DASHED)
        axes.update_datalim([(neutral - 0.1, 0), (neutral + 0.1, 0)])  # shown at least
        axes.autoscale_view(scaley=False)
        for index, group in enumerate(groups):
            ends = rows[group.columns[0]] - 0.5, rows[group.columns[-1]] + 0.5
            color = "#ececec" if group.name in _ARMS else "#f6f6f6"
            if index % 2 or group.name in _ARMS:
                axes.axhspan(*ends, color=color, lw=0, zorder=0)
    panels[0].set_yticks(rows, names)
    units = panels[1].secondary_yaxis("right")
    units.set_yticks(
        [rows[list(group.columns)].mean() for group in groups], [g.unit for g in groups]
    )
    units.tick_params(length=0)
    units.spines[:].set_visible(False)
    return figure, dict(zip(entries, panels, strict=True)), rows
