"""Tables for the book: pandas Stylers of the paper's tables and of the runs' records."""

import hashlib
import html
import itertools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from pandas.io.formats.style import Styler

from silem import paper
from silem.report import results, statistics, style
from silem.report.style import QUANTITIES, number
from silem.study.config import RunConfig
from silem.study.studies import cells, narrowed
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


_SETTINGS = {about.parameter: symbol for symbol, about in paper.symbols().items()} | {
    "disc_learning_rate": "rate of D",
    "transform_learning_rate": "rate of T",
    "gradient_penalty": "gradient penalty",
    "transform_l2_scale": "L2 on A",
    "transform_l2_bias": "L2 on b",
    "transform_l2_form": "L2",
    "disc_entropy_coef": "entropy bonus",
    "learning_rate": "rate of PPO",
    "clip_range": "clip range",
    "clip_actions": "clipping of actions",
    "anneal_clip": "falling clip range",
    "log_std_init": "first std",
    "encoder_layers": "layers of the encoder",
}


def setting(name: str, value: Any) -> tuple[str, str]:
    """Return what a setting is called, where it has no other name by the paper's symbol, and it."""
    if name == "log_std_init":
        value = float(f"{math.exp(value):.2g}")
    if isinstance(value, bool):
        value = "on" if value else "off"
    return _SETTINGS.get(name, name), value if isinstance(value, str) else number(value, None)


def searched(frame: pd.DataFrame, began: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Return what a search tried, a row for each run that it plans, in the plan's order.

    Columns are those of the run, NaN where it is not made, ``method``, ``body``, ``setting`` (in
    words what is unlike where the method's search `began`), ``first`` (nothing is) and ``in_use``
    (it is what the study has now).
    """
    rows, (study, budget) = [], results.context(frame)
    for cell, seed in itertools.product(cells(study), narrowed(study, budget).seeds):
        config, first = cell.config(budget, seed), began[cell.method]
        usual = RunConfig.create(cell.body, cell.method, cell.demonstrations).hyper
        changed = {name: value for name, value in cell.overrides if first.get(name) != value}
        words = ", ".join(" ".join(setting(*item)) for item in (changed or first).items())
        row = {"run_id": config.run_id, "method": cell.method, "body": cell.body}
        row["setting"] = words if changed else "as it began" + f": {words}" * bool(words)
        rows.append(row | {"first": not changed, "in_use": config.hyper == usual})
    return pd.DataFrame(rows).merge(frame.drop(columns=["method", "body"]), "left", "run_id")


def means(
    cells: Iterable[tuple[dict[str, str], pd.DataFrame]],
    columns: Sequence[str],
    spread: Sequence[str] = (),
) -> pd.DataFrame:
    """Return, as text, a row for each cell: what it is called, its trials, means of `QUANTITIES`.

    Below those in `spread` stand minimum and maximum of several trials.
    """
    rows = []
    for called, runs in cells:
        row = called | {"trials": str(runs["return_mean"].count())}
        for name in columns:
            (heading, digits), known = QUANTITIES[name], runs[name].dropna()
            below = style.span(known, digits) if name in spread and len(known) > 1 else ""
            row[heading] = number(known.mean(), digits) + small(below)
        rows.append(row)
    return pd.DataFrame(rows)


def same_settings(frame: pd.DataFrame, body: str) -> str:
    """Write SILEM's return less that of SILEM⁻ with SILEM's settings, with its interval."""
    same = results.load_records("same-settings", results.context(frame)[1])
    cells = results.cell(frame, "silem", body), results.cell(same, "silem-minus", body)
    ours, others = (cell["return_mean"] for cell in cells)
    return style.estimate(ours.mean() - others.mean(), statistics.interval(ours, others))


def beside(what: str, frames: Mapping[str, pd.DataFrame], methods: Sequence[str]) -> pd.DataFrame:
    """Return, as text, the cells of two tables beside each other, on the seeds that both plan.

    A row tells `what` it is by the table's name. The second's ends with the difference in return
    and its 95 % interval, Welch's.
    """
    (first, before), (second, after) = frames.items()
    plans = [results.context(frame) for frame in frames.values()]
    seeds = set.intersection(*(set(narrowed(*plan).seeds) for plan in plans))
    cells, gains = [], []
    for body, method, _ in results.planned(after, methods):
        called = {"body": body, "method": style.METHODS[method].short}
        old, new = (results.cell(f[f["seed"].isin(seeds)], method, body) for f in (before, after))
        cells += [(called | {what: first}, old), (called | {what: second}, new)]
        returns = new["return_mean"], old["return_mean"]
        gain = returns[0].mean() - returns[1].mean()
        gains += ["", style.estimate(gain, statistics.interval(*returns))]
    columns = ["return_mean", "steps", "disc_reward", "speed_m_s"]
    return means(cells, columns).assign(**{"difference in return": gains})


def table_1(frame: pd.DataFrame) -> Styler:
    """Return Table 1, ours beside the paper's: f an MLP or an affine transform, on HC0."""
    printed, columns = paper.table("tab1").rows, ["disc_reward", "return_mean"]
    methods = zip(printed, ("silem-mlp", "silem"), strict=True)
    cells = (({"f": row["f"]}, results.cell(frame, name, "HC0")) for row, name in methods)
    ours, theirs = means(cells, columns, columns), pd.DataFrame(printed).set_index("f")
    theirs = theirs.rename(columns=dict(zip(theirs, ours.columns[2:], strict=True))).map(number)
    parts = {"": ours.iloc[:, :2], "paper": theirs.reset_index(drop=True), "ours": ours.iloc[:, 2:]}
    return styled(pd.concat(parts, axis="columns"))


def ensembles(frame: pd.DataFrame) -> Styler:
    """Return Table 1 for K affine maps behind a gate and for the MLP: a row per body and f."""
    counts, apart = [], []
    for run in frame["run_id"]:
        counts.append(results.find(run).run_config.hyper.transform_components)
        maps = results.load_transform(run)["scale"] if counts[-1] > 1 else np.full((2, 1), np.nan)
        apart.append(100 * maps.std(axis=0).mean() / abs(maps - 1).mean())
    frame = frame.assign(count=counts, apart=apart)
    kinds = list(itertools.product(("HC0", "HC2", "Ant6"), ["silem"], (1, 2, 4, 8)))
    kinds.insert(4, ("HC0", "silem-mlp", 1))
    cells = (
        ({"body": body, "f": f"affine, K = {count}" if method == "silem" else "MLP"},
         results.cell(frame[frame["count"].eq(count)], method, body))
        for body, method, count in kinds
    )  # fmt: skip
    columns = ["apart", "disc_reward", "return_mean", "speed_m_s"]
    caption = "Table 1, continued: means, and lowest to highest of trials"
    return styled(means(cells, columns, columns[1:3]), caption)


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

    The second score is against the body's best expert, not against their mean.
    """
    original, level = results.original_body(frame), frame.where(frame["method"].eq("ppo"))
    level = frame["body"].map(level.groupby("body")["return_mean"].max())
    frame = frame.assign(
        best=frame["return_mean"] / level.where(level > 0).astype(float),
        wall_time_min=frame["wall_time_s"] / 60,
    )
    lasts = results.can_fall(frame) and original  # Ants' episodes end, others do not or say a share
    columns = ["return_mean", "steps" if lasts else "upright", "normalised", "best", "speed_m_s",
               "disc_reward", "wall_time_min"]  # fmt: skip
    cells = (
        ({"body": body, "method": style.method(method, original).label}, runs)
        for body, method, runs in results.planned(frame)
    )
    return styled(means(cells, columns, ["return_mean", "steps", "normalised"]))
