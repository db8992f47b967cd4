"""What stands under a figure or table: its runs, budget and commits, and how to rerun each run."""

from __future__ import annotations

import html
from collections.abc import Iterable

import pandas as pd
from IPython.display import HTML

from silem.report import results


def trace(frame: pd.DataFrame) -> HTML:
    """Return the tracing line of a figure, with folded lists of its runs.

    Args:
        frame: The runs that the figure shows, e.g. ``figures.runs_of("experts", frame)``.

    Returns:
        One line, then the runs with the command that reruns each; the planned runs that are not
        made yet with the command that makes each; and the runs that were set aside.
    """
    study, budget = results.context(frame)
    parts = [f'<p class="silem-trace-line">{html.escape(line(frame))}</p>']
    if len(frame):
        items = [(row.run_id, row.command) for row in frame.itertuples()]
        where = f"records in data/results/{study}" if results.is_evidence(budget) else "local runs"
        parts.append(_details(f"the runs, and how to rerun each ({where})", items))
    if missing := frame.attrs["missing"]:
        items = [(run["run_id"], run["command"]) for run in missing]
        parts.append(_details(f"planned runs that are not made yet ({len(items)})", items))
    if set_aside := frame.attrs["set_aside"]:
        items = [(run_id, "") for run_id in set_aside]
        parts.append(_details(f"runs of other settings or seeds, not shown ({len(items)})", items))
    return HTML(f'<div class="silem-trace">{"".join(parts)}</div>')  # type: ignore[no-untyped-call]


def line(frame: pd.DataFrame) -> str:
    """Say in one line which runs a figure shows: how many, which budget, which commits."""
    return f"{results.describe(frame)}; {commits(frame)}" if len(frame) else results.describe(frame)


def commits(frame: pd.DataFrame) -> str:
    """Name the commits that a table's runs were made with, and say where code had been changed."""
    names = []
    for commit, rows in frame.groupby("commit", sort=False):
        changed = " with uncommitted changes" if rows["dirty"].eq(True).any() else ""
        names.append(f"{str(commit)[:7]}{changed}")
    return f"commit{'s' if len(names) > 1 else ''} {', '.join(names)}"


def _details(summary: str, items: Iterable[tuple[str, str]]) -> str:
    """Return a folded list of runs: name, command."""
    entries = "".join(
        f"<li><code>{html.escape(name)}</code>"
        + (f"<br><code>{html.escape(command)}</code>" if command else "")
        + "</li>"
        for name, command in items
    )
    return f"<details><summary>{html.escape(summary)}</summary><ul>{entries}</ul></details>"
