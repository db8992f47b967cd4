"""What stands under a figure or table: its runs, budget and commits, and how to rerun each run."""

from __future__ import annotations

from html import escape
from typing import Any

import pandas as pd
from IPython.display import HTML

from silem.report import results, web
from silem.study.settings import BUDGETS


def trace(frame: pd.DataFrame) -> HTML:
    """Return the tracing line of the runs that a figure shows, with folded lists of them.

    Returns:
        One line, then the runs with the command that reruns each; the planned runs that are not
        made yet with the command that makes each; and the runs that were set aside.
    """
    study, budget = results.context(frame)
    line = results.describe(frame) + (f"; {commits(frame)}" if len(frame) else "")
    where = f"records in data/results/{study}" if BUDGETS[budget].is_evidence else "local runs"
    missing = frame.attrs["missing"]
    set_aside = [{"run_id": run_id} for run_id in frame.attrs["set_aside"]]
    folded = {
        f"the runs, and how to rerun each ({where})": frame.to_dict("records"),
        f"planned runs that are not made yet ({len(missing)})": missing,
        f"runs of other settings or seeds, not shown ({len(set_aside)})": set_aside,
    }
    lists = "".join(
        f"<details><summary>{escape(summary)}</summary><ul>{_items(shown)}</ul></details>"
        for summary, shown in folded.items()
        if shown
    )
    line = f'<p class="silem-trace-line">{escape(line)}</p>{web.links(frame) if len(frame) else ""}'
    page = f'<div class="silem-trace">{line}{lists}</div>'
    return HTML(page)  # type: ignore[no-untyped-call]


def commits(frame: pd.DataFrame) -> str:
    """Name the commits that a table's runs were made with, and say where code had been changed."""
    changed = frame["dirty"].eq(True).groupby(frame["commit"], sort=False).any()
    names = [f"{name[:7]}{' with uncommitted changes' * dirty}" for name, dirty in changed.items()]
    return f"commit{'s' if len(names) > 1 else ''} {', '.join(names)}"


def _items(shown: list[dict[str, Any]]) -> str:
    """Return list items of code: a run's name, and below it its command where there is one."""
    texts = [[run[name] for name in ("run_id", "command") if name in run] for run in shown]
    codes = [[f"<code>{escape(text)}</code>" for text in pair] for pair in texts]
    return "".join(f"<li>{'<br>'.join(pair)}</li>" for pair in codes)
