"""Tables for the book: pandas Stylers of the paper's tables and of the runs' records."""

import hashlib
import html
import itertools
import re
from typing import Any

import pandas as pd
from numpy.typing import ArrayLike
from pandas.io.formats.style import Styler

from silem import paper
from silem.report import results, statistics, style
from silem.report.style import number
from silem.util import files, paths


def styled(table: pd.DataFrame, caption: str = "") -> Styler:
    """Return texts in this project's look; columns named by two words get two rows of headings."""
    if isinstance(table.columns[0], tuple):
        table = table.set_axis(pd.MultiIndex.from_tuples(table.columns), axis="columns")
    # The id that ties a table to its own styles comes from its content, so that it never changes
    # by itself and two tables on one page do not style each other.
    digest = hashlib.sha256((table.to_csv() + caption).encode()).hexdigest()
    look = table.style.hide(axis="index").set_uuid(digest[:10])
    look = look.set_table_attributes('class="silem-table"')
    numeric = [name for name in table.columns if table[name].map(_is_numeric).all()]
    look = look.set_properties(subset=numeric, **{"text-align": "right", "white-space": "nowrap"})
    others = [name for name in table.columns if name not in numeric]
    look = look.set_properties(subset=others, **{"text-align": "left"})
    return look.set_caption(caption) if caption else look


def small(text: str) -> str:
    """Return small print for the line below a cell's text; "" for none."""
    return f"<br><small>{text}</small>" if text else ""


def _is_numeric(value: Any) -> bool:
    text = re.sub(r"<[^>]*>", " ", str(value))
    return bool(re.match(r"^[\d–−+]", text)) and not re.search(r"[A-Za-z]{3}", text)


def _mean(values: ArrayLike, digits: int = 0, unit: str = "", *, spread: bool = False) -> str:
    """Write the mean of what is known; with `spread` minimum and maximum of several below it."""
    known = pd.Series(values, dtype=float).dropna()
    text = number(known.mean(), digits) + (unit if len(known) else "")
    low, high = number(known.min(), digits), number(known.max(), digits)
    return text + small(f"{low} to {high}" if spread and len(known) > 1 else "")


def table_1(frame: pd.DataFrame) -> Styler:
    """Return Table 1, ours beside the paper's: f an MLP or an affine transform, on HC0."""
    rows = []
    for method, printed in zip(("silem-mlp", "silem"), paper.table("tab1").rows, strict=True):
        runs = results.cell(frame, method, "HC0")
        row: dict[Any, Any] = {("", "f"): printed["f"]}
        columns = {"discriminator": "disc_reward", "ground-truth": "return_mean"}
        for name, column in columns.items():
            paper_mean = printed[f"{name.replace('-', '_')}_reward"]
            row[f"{name} reward", "paper"] = number(paper_mean)
            row[f"{name} reward", "ours"] = _mean(runs[column], spread=True)
        rows.append(row | {("", "trials"): len(runs)})
    return styled(pd.DataFrame(rows))


def ensembles(frame: pd.DataFrame) -> Styler:
    """Return Table 1 for K affine maps behind a gate and for the MLP: a row per body and f."""
    counts = [results.find(run).run_config().hyper.transform_components for run in frame["run_id"]]
    frame, rows = frame.assign(count=counts), []
    for body in ("HC0", "HC2", "Ant6"):
        kinds = [("silem", count) for count in (1, 2, 4, 8)] + [("silem-mlp", 1)] * (body == "HC0")
        for method, count in kinds:
            runs = results.cell(frame[frame["count"].eq(count)], method, body)
            row = {"body": body, "f": "MLP" if "mlp" in method else f"affine, K = {count}"}
            row |= {"trials": style.trials(len(runs))}
            maps = [results.load_transform(run)["scale"] for run in runs["run_id"] if count > 1]
            apart = [100 * maps.std(axis=0).mean() / abs(maps - 1).mean() for maps in maps]
            row["maps apart"] = _mean(apart, unit=" %")
            for name, column in (("reward of D", "disc_reward"), ("return", "return_mean")):
                row[name] = _mean(runs[column], spread=True)
            rows.append(row | {"speed (m/s)": _mean(runs["speed_m_s"], 2)})
    return styled(pd.DataFrame(rows), "Table 1, continued: means, and lowest to highest of trials")


def random_policies() -> Styler:
    """Return what each reading of a random policy returns (`benchmarks.random_policy`)."""
    rows = {"the paper's": number(paper.number("random_return"))}
    for entry in files.read_json(paths.REPO / "data" / "random_policy.json"):
        returns = pd.Series(entry["returns"])
        text = f"{number(returns.mean())} ± {number(returns.sem())}"
        rows[html.escape(entry["reading"])] = text
    return styled(pd.DataFrame(rows.items(), columns=["a random policy", "return"]))


def coverages() -> Styler:
    """Return how often a 95 % interval of a few trials holds the true mean, by simulation."""
    rows = []
    for count in (2, 3, 5):
        row = {"trials": str(count)}
        for name, kind in (("Student's", "student"), ("bootstrap", "bootstrap")):
            for failures, scores in ((False, "normal scores"), (True, "one in five fails")):
                share = statistics.coverage(count, kind, failures=failures)
                row[f"{name}, {scores}"] = f"{number(100 * share)} %"
        rows.append(row)
    return styled(pd.DataFrame(rows), "True coverage of a 95 % interval of the mean")


def cell_table(frame: pd.DataFrame) -> Styler:
    """Return one row per cell of a study: trials, returns, scores, gait and time.

    The second score is against the body's best expert, who demonstrates, not against their mean.
    """
    rows, original = [], results.original_body(frame)
    lasts = results.can_fall(frame) and original  # Ants' episodes end, others do not or say a share
    upright = results.upright_label(frame).removeprefix("share of ")
    cells = itertools.product(results.body_names(frame), style.METHODS)
    for body, method in ((b, m) for b, m in cells if results.is_planned(frame, m, b)):
        runs, label = results.cell(frame, method, body), style.method(method, original).label
        row = {"body": body, "method": label, "trials": len(runs)}
        row["return"] = _mean(runs["return_mean"], spread=True)
        if lasts:
            row["steps"] = _mean(runs["steps"], spread=True)
        row["score"] = _mean(runs["normalised"], 2, spread=True)
        row["score, best expert"] = _mean(results.against_best(frame, method, body), 2)
        row["speed (m/s)"] = _mean(runs["speed_m_s"], 2)
        if not lasts:
            row[upright] = _mean(100 * runs["upright"], 0, " %")
        row["discriminator reward"] = _mean(runs["disc_reward"])
        row["wall time (min)"] = _mean(runs["wall_time_s"] / 60, 1)
        rows.append(row)
    return styled(pd.DataFrame(rows))
