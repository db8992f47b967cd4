"""The search for the hyper-parameters that the paper leaves open, as it was recorded.

``data/search/<family>.json`` holds one entry per exploratory run: what was set, and its learning
curve in means over 20 iterations. Exploratory runs chose the settings; no result rests on them.
"""

from __future__ import annotations

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from silem import files, paths
from silem.errors import SilemError
from silem.report import results, style, tables

_COLUMNS = ["iteration", "return_mean", "speed_m_s", "disc_reward"]
SETTINGS = {
    "gradient_penalty": "gradient penalty",
    "disc_learning_rate": "rate of D",
    "transform_learning_rate": "rate of T",
    "schedule": "iterations planned",
}


def load(family: str = "halfcheetah") -> pd.DataFrame:
    """Return the exploratory runs, one row each, with their curve as a DataFrame.

    Raises:
        SilemError: The file is missing, or an entry lacks something.
    """
    path = paths.REPO / "data" / "search" / f"{family}.json"
    rows = []
    for entry in files.read_json(path):
        wanted = {"body", "method", "rows", *SETTINGS}
        if missing := wanted - entry.keys():
            raise SilemError(f"{path.name}: an entry lacks {', '.join(sorted(missing))}")
        curve = pd.DataFrame(entry["rows"], columns=_COLUMNS).dropna()
        rows.append({**{key: entry[key] for key in wanted - {"rows"}}, "curve": curve})
    return pd.DataFrame(rows)


def prototype() -> pd.DataFrame:
    """Return, as text, what a prototype was seen to do before any run was recorded."""
    entries = files.read_json(paths.REPO / "data" / "search" / "prototype.json")
    return pd.DataFrame(entries)


def table(frame: pd.DataFrame) -> pd.DataFrame:
    """Return, as text, what was set and what it led to, best return first within each body."""
    last = pd.DataFrame([curve.iloc[-1] for curve in frame["curve"]], index=frame.index)
    ordered = frame.join(last).sort_values(["body", "return_mean"], ascending=[True, False])
    rows = [
        {
            "body": run.body,
            "method": _label(run.method),
            **{label: _plain(getattr(run, name)) for name, label in SETTINGS.items()},
            "iterations made": style.number(run.iteration),
            "return": style.number(run.return_mean),
            "speed (m/s)": f"{run.speed_m_s:.2f}",
            "reward of D": style.number(run.disc_reward),
        }
        for run in ordered.itertuples()
    ]
    return pd.DataFrame(rows)


def _plain(value: float) -> str:
    return "–" if pd.isna(value) else f"{value:g}"


def _label(method: str) -> str:
    return style.method(method).label.partition(" (")[0]


def curves(frame: pd.DataFrame) -> Figure:
    """Draw the return of every exploratory run over iterations, a panel per body."""
    bodies = sorted(frame["body"].unique())
    with style.applied():
        figure, axes = style.new_figure(3.4, ncols=len(bodies), sharey=True, squeeze=False)
        for panel, body in zip(axes[0], bodies, strict=True):
            _panel(panel, frame[frame["body"] == body])
            panel.set(title=body, xlabel="iteration")
        axes[0, 0].set_ylabel("return of an episode")
        style.footer(figure, f"{len(frame)} exploratory runs, one seed each; not evidence")
    return figure


def _panel(axes: Axes, runs: pd.DataFrame) -> None:
    shades = {1: "-", 2: "--", 3: ":"}
    for method, group in runs.groupby("method"):
        look = style.method(str(method))
        ordered = sorted(group.to_dict("records"), key=lambda run: run["curve"].iloc[-1, 1])
        for rank, run in enumerate(reversed(ordered), start=1):
            rates = f"penalty {run['gradient_penalty']:g}, D {run['disc_learning_rate']:g}"
            axes.plot(
                run["curve"]["iteration"], run["curve"]["return_mean"], color=look.color,
                ls=shades.get(rank, ":"), lw=1.6 if rank == 1 else 1.0,
                label=f"{_label(str(method))}: {rates}" if rank == 1 else None,
            )  # fmt: skip
    axes.legend(loc="lower right", fontsize=7)


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
                row = {"body": body, "method": _label(method), "penalty": name}
                row["trials"] = str(len(runs)) if len(runs) else "no run"
                for label, (column, digits) in _COMPARED.items():
                    mean = runs[column].mean()
                    row[label] = "–" if pd.isna(mean) else tables.number(mean, digits)
                rows.append(row)
    return pd.DataFrame(rows)


_COMPARED = {
    "return": ("return_mean", 0),
    "reward of D": ("disc_reward", 0),
    "speed (m/s)": ("speed_m_s", 2),
}
