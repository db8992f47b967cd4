"""The search for the hyper-parameters that the paper leaves open, as it was recorded.

``data/search/<family>.json`` holds one entry per exploratory run: its name, what was set, and its
learning curve in means over a few iterations, which end at the ``iteration`` of their row.
Exploratory runs chose the settings; no result rests on them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

from silem import bodies
from silem.report import results, style, tables
from silem.util import files, paths
from silem.util.errors import SilemError, choose

_SHARED = {
    "gradient_penalty": "gradient penalty",
    "transform_learning_rate": "rate of T",
    "schedule": "iterations planned",
}
SETTINGS = {
    "halfcheetah": {"disc_learning_rate": "rate of D"} | _SHARED,
    "humanoids": {
        "learning_rate": "rate of PPO",
        "clip_range": "clip range",
        "passes": "epochs × minibatch",
        "log_std_init": "first std",
        "starts": "starts",
    }
    | _SHARED,
}
"""What the exploratory runs of each family varied, with its heading."""

QUANTITIES = {
    "return_mean": "return of an episode",
    "episode_length": "steps before a fall",
    "speed_m_s": "forward speed (m/s)",
    "disc_reward": "discriminator reward",
}
"""What the curves hold; a runner's episode has no fall."""

_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
_DASHES: tuple[Any, ...] = (
    "-", (0, (5, 2)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5)), (0, (9, 3)), (0, (3, 1, 1, 1, 1, 1)),
)  # fmt: skip
_LAST = {
    "return_mean": ("return", 0),
    "episode_length": ("steps before a fall", 0),
    "speed_m_s": ("speed (m/s)", 2),
    "disc_reward": ("reward of D", 0),
}


def load(family: str = "halfcheetah", method: str | None = None) -> pd.DataFrame:
    """Return the exploratory runs, one row each, with their curve as a DataFrame.

    Args:
        family: A key of `SETTINGS`.
        method: Keep this method's runs alone.

    Raises:
        SilemError: The family is unknown, the file is missing, or an entry lacks something.
    """
    settings = SETTINGS[choose("family", family, SETTINGS)]
    path = paths.REPO / "data" / "search" / f"{family}.json"
    rows = []
    for entry in files.read_json(path):
        if "n_epochs" in entry:
            entry["passes"] = f"{entry['n_epochs']} × {entry['minibatch_size']}"
        wanted = {"name", "body", "method", "columns", "rows", *settings}
        if missing := wanted - entry.keys():
            raise SilemError(f"{path.name}: an entry lacks {', '.join(sorted(missing))}")
        curve = pd.DataFrame(entry["rows"], columns=entry["columns"]).astype(float)
        values = {key: entry[key] for key in ("name", "body", "method", *settings)}
        rows.append(values | {"curve": curve})
    frame = pd.DataFrame([row for row in rows if method in (None, row["method"])])
    frame.attrs["settings"] = settings
    return frame


def prototype() -> pd.DataFrame:
    """Return, as text, what a prototype was seen to do before any run was recorded."""
    return pd.DataFrame(files.read_json(paths.REPO / "data" / "search" / "prototype.json"))


def at(frame: pd.DataFrame, name: str, iteration: int, quantity: str) -> float:
    """Return one number of one exploratory run, for a sentence.

    Raises:
        SilemError: There is no such run, or its curve has no such row.
    """
    runs = dict(zip(frame["name"], frame["curve"], strict=True))
    curve = runs[choose("exploratory run", name, runs)].set_index("iteration")
    if iteration not in curve.index:
        raise SilemError(f"the curve of {name} has no row at iteration {iteration}")
    return float(curve.loc[iteration, quantity])


def table(frame: pd.DataFrame) -> pd.DataFrame:
    """Return, as text, what was varied and what it led to, best return first in each method."""
    last = pd.DataFrame([curve.iloc[-1] for curve in frame["curve"]], index=frame.index)
    ordered = frame.join(last).sort_values(
        ["body", "method", "return_mean"], ascending=[True, True, False]
    )
    varied = [n for n in frame.attrs["settings"] if n != "schedule" and _varies(frame[n])]
    rows = []
    for run in ordered.to_dict("records"):
        names = {"body": run["body"], "method": _label(run["body"], run["method"])}
        row = {name: text for name, text in names.items() if _varies(frame[name])}
        row |= {frame.attrs["settings"][name]: _written(name, run[name]) for name in varied}
        row["iterations"] = f"{run['iteration']:,.0f} of {run['schedule']:,}"
        for name, (heading, digits) in _LAST.items():
            if last.get(name, pd.Series()).notna().any():
                row[heading] = tables.number(run[name], digits)
        rows.append(row)
    return pd.DataFrame(rows)


def curves(
    frame: pd.DataFrame, quantities: Sequence[str] = ("return_mean",), colored: str = "method"
) -> Figure:
    """Draw the exploratory runs over iterations: a row per quantity, a column per body.

    The legend names a run by what is set otherwise than in most of them; those settings stand
    below the figure.

    Args:
        frame: Runs of `load`.
        quantities: Keys of `QUANTITIES`.
        colored: The column by whose values the lines are coloured: ``"method"`` or a setting. Runs
            that share a value differ in their dashes, best return first.

    Raises:
        SilemError: There is no such quantity, or no such column.
    """
    titles = [QUANTITIES[choose("quantity", name, QUANTITIES)] for name in quantities]
    usual = _usual(frame, choose("column", colored, ("method", *frame.attrs["settings"])))
    names = sorted(frame["body"].unique())
    n_most = int(frame["body"].value_counts().max())
    with style.applied():
        figure, grid = style.new_figure(
            1.55 * len(quantities) + 0.19 * n_most + 1.2, nrows=len(quantities),
            ncols=len(names), sharex="col", sharey="row", squeeze=False,
        )  # fmt: skip
        for column, body in zip(grid.T, names, strict=True):
            looks = _looks(frame[frame["body"] == body], colored, usual)
            column[0].set_title(body)
            for axes, quantity in zip(column, quantities, strict=True):
                _panel(axes, looks, quantity)
            column[-1].set_xlabel("iteration")
            below = ScaledTranslation(0, -0.42, figure.dpi_scale_trans)
            column[-1].legend(
                loc="upper left", bbox_to_anchor=(0, 0), borderaxespad=0, fontsize=8,
                bbox_transform=column[-1].transAxes + below, handlelength=3.2,
            )  # fmt: skip
        for axes, title in zip(grid[:, 0], titles, strict=True):
            axes.set_ylabel(title)
        figure.align_ylabels(grid[:, 0])
        unless = ", ".join(
            f"{frame.attrs['settings'][k]} {_written(k, v)}" for k, v in usual.items()
        )
        note = f"{len(frame)} exploratory runs, one seed each; not evidence"
        style.footer(figure, f"{note}; unless named: {unless}")
    return figure


def _varies(values: pd.Series) -> bool:
    return values.nunique() > 1


def _usual(frame: pd.DataFrame, colored: str) -> dict[str, Any]:
    """Return the settings that vary, each with its most frequent value."""
    names = [name for name in frame.attrs["settings"] if name != colored and _varies(frame[name])]
    return {name: frame[name].mode().iloc[0] for name in names}


def _looks(
    runs: pd.DataFrame, colored: str, usual: dict[str, Any]
) -> list[tuple[pd.DataFrame, dict[str, Any]]]:
    """Give every run of a body its curve's look."""
    headings, looks = runs.attrs["settings"], []
    for index, (value, group) in enumerate(runs.groupby(colored)):
        first = f"{headings.get(colored)} {_written(colored, value)}"
        color = _COLORS[index % len(_COLORS)]
        if colored == "method":
            color = style.method(str(value)).color
            first = _label(runs["body"].iloc[0], str(value))
        ordered = sorted(group.to_dict("records"), key=_last_return, reverse=True)
        for rank, run in enumerate(ordered):
            others = [
                f"{headings[name]} {_written(name, run[name])}"
                for name, value_of_most in usual.items()
                if run[name] != value_of_most and pd.notna(run[name])
            ]
            line = {"color": color, "ls": _DASHES[rank % len(_DASHES)], "lw": 1.4}
            looks.append((run["curve"], line | {"label": ", ".join([first, *others])}))
    return looks


def _last_return(run: dict[str, Any]) -> float:
    return float(run["curve"]["return_mean"].iloc[-1])


def _panel(axes: Axes, looks: Sequence[tuple[pd.DataFrame, dict[str, Any]]], quantity: str) -> None:
    for curve, line in looks:
        known = curve[["iteration", quantity]].dropna()
        axes.plot(known["iteration"], known[quantity], **line)


def _written(name: str, value: Any) -> str:
    if isinstance(value, str):
        return value
    if pd.isna(value):
        return tables.DASH
    return f"{math.exp(value):.2g}" if name == "log_std_init" else f"{value:g}"


def _label(body: str, method: str) -> str:
    original = "" if bodies.get(body).family == "humanoid" else "HC0"
    return style.method(method, original).label.partition(" (")[0]


def penalty_table(penalised: pd.DataFrame, unpenalised: pd.DataFrame) -> pd.DataFrame:
    """Return SILEM and SILEM-minus with and without the penalty: means over trials, as text.

    Args:
        penalised: Runs of the study "halfcheetah" (`results.load_records`).
        unpenalised: Runs of the study "no-gradient-penalty" at the same budget.
    """
    rows = []
    for body in results.body_names(unpenalised):
        for method in ("silem", "silem-minus"):
            for name, frame in (("yes", penalised), ("no", unpenalised)):
                runs = results.cell(frame, method, body)
                row = {"body": body, "method": _label(body, method), "penalty": name}
                row["trials"] = str(len(runs)) if len(runs) else "no run"
                for label, (column, digits) in _COMPARED.items():
                    mean = runs[column].mean()
                    row[label] = "–" if pd.isna(mean) else tables.number(mean, digits)
                rows.append(row)
    return pd.DataFrame(rows)


_COMPARED = {
    "return": ("return_mean", 0), "reward of D": ("disc_reward", 0),
    "speed (m/s)": ("speed_m_s", 2),
}  # fmt: skip
