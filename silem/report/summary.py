"""Sphinx extension: what the book cost, what became of the claims, and where its data is from.

Everything on the pages "What this book cost" and "For reviewers" that can be counted is counted
here, from the committed records and the demonstrations' manifest, when the book is built:

- ``{cost}``, ``{cost-per-run}``, ``{processors}`` and ``{verdicts}`` are tables;
- ``{results-figure}`` is one of `FIGURES`, of a study, with what stands under a figure of results;
- ``{data-cards}`` has one card for each file of demonstrations;
- ``{counted}`hours` `` is one of `counts`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from docutils import nodes
from docutils.statemachine import StringList
from matplotlib.figure import Figure
from scipy import stats
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from silem import bodies, paper
from silem.motion.demonstrations import MANIFEST
from silem.report import claims, curves, results, scores, statistics, style
from silem.report.sphinxext import TABLES, Table, TableDirective, role
from silem.report.style import DASH, number
from silem.report.web import records
from silem.study.config import RunConfig
from silem.study.runs import RECORD, git
from silem.study.settings import METHODS
from silem.study.studies import STUDIES, study_configs
from silem.util import files, paths
from silem.util.errors import choose

_COLUMNS = ("run_id", "study", "family", "cell", "method", "steps", "hours", "processor_hours",
            "speed", "processor", "date")  # fmt: skip
_HOURS = ("Hours by the clock", "Hours of a processor (runs that counted)")


# ---------------------------------------------------------------- what runs cost


@cache
def costs() -> pd.DataFrame:
    """Return what each published run took; steps in millions, times in hours."""
    dates = _published()
    rows: dict[str, list[Any]] = {name: [] for name in _COLUMNS}
    for record in records():
        config, machine = record.run_config, record.provenance.get("machine", {})
        counted = record.processor_time_s
        taken = _plan(config) | {
            "hours": record.wall_time_s / 3600,
            "processor_hours": np.nan if counted is None else counted / 3600,
            "speed": record.training["steps_per_s"],
            "processor": machine.get("processor", "not recorded"),
            "date": dates.get(record.run_id, ""),
        }
        for name, values in rows.items():
            values.append(taken[name])
    return pd.DataFrame(rows)


def _plan(config: RunConfig) -> dict[str, Any]:
    """Return what is known of a run before it is made."""
    budget, trains = config.budget, config.method != "random"
    return {
        "run_id": config.run_id,
        "study": config.study,
        "family": bodies.get(config.body).family,
        "cell": dataclasses.replace(config, seed=0).run_id,
        "method": config.method,
        "steps": budget.n_iterations * budget.steps_per_iteration / 1e6 if trains else 0.0,
    }


def planned() -> pd.DataFrame:
    """Return every run that a study plans, with its hours: NaN where it is not made."""
    plans = [_plan(plan) for study in STUDIES for plan in study_configs(study, "book")]
    made = costs().set_index("run_id")["hours"]
    frame = pd.DataFrame(plans)
    return frame.assign(hours=frame["run_id"].map(made))


def hours_left(frame: pd.DataFrame) -> float:
    """Estimate the hours that planned runs still take, from what a step of the like has taken."""
    trained = costs()[costs()["steps"] > 0]
    if trained.empty:
        return np.nan
    known = trained.groupby(["family", "method"])[["hours", "steps"]].sum()
    per_step = (known["hours"] / known["steps"]).to_dict()
    left = frame[frame["hours"].isna()]
    keys = zip(left["family"], left["method"], strict=True)
    like = known["hours"].sum() / known["steps"].sum()  # of all, where no run is of that kind
    return float(sum(s * per_step.get(k, like) for s, k in zip(left["steps"], keys, strict=True)))


def cost() -> Table:
    """Return, for each study: runs, trials of a cell, steps, hours and dates."""
    found, plans, rows = costs(), planned(), []
    for study in dict.fromkeys([*STUDIES, *found["study"]]):  # searches after the studies
        made, wanted = (frame[frame["study"] == study] for frame in (found, plans))
        missing = int(wanted["hours"].isna().sum())
        rows.append(
            (
                f"`{study}`", f"{len(made)}", f"{missing}", _span(made.groupby("cell").size()),
                number(made["steps"].sum(), 1), *_hours(made), number(hours_left(wanted), 1),
                _span(made["date"][made["date"] != ""]),
            )
        )  # fmt: skip
    rows.append(
        ("**all**", f"{len(found)}", f"{int(plans['hours'].isna().sum())}", "",
         number(found["steps"].sum(), 1), *_hours(found), number(hours_left(plans), 1), "")
    )  # fmt: skip
    head = ("Study", "Runs", "Missing", "Trials of a cell", "Million steps", *_HOURS, "Hours left",
            "Published")  # fmt: skip
    caption = (
        "What each study has cost. A run is one process with one thread; its hours are training and"
        " evaluation. Hours left are an estimate: the missing runs' steps by what a step of the"
        " same method and family has taken, or of all runs where none is of that kind."
    )
    return Table("cost", caption, head, rows)


def cost_per_run() -> Table:
    """Return what one run of each method takes: steps, hours, steps a second."""
    rows = []
    trained = costs()[costs()["method"] != "random"]
    for (family, method, steps), runs in trained.groupby(["family", "method", "steps"]):
        label, speed = style.method(str(method), "").label, runs["speed"].astype(float).mean()
        rows.append((str(family), label, number(float(steps), 1), f"{len(runs)}",
                     number(runs["hours"].mean(), 2), number(speed)))  # fmt: skip
    head = ("Family", "Method", "Million steps", "Runs", "Hours, mean", "Steps a second, mean")
    return Table("cost-per-run", "What one run takes by the clock, on one thread.", head, rows)


def processors() -> Table:
    """Return which processors made the runs."""
    rows = [
        (str(name), f"{len(runs)}", *_hours(runs)) for name, runs in costs().groupby("processor")
    ]
    caption = "Which processors made the runs, as far as their records say."
    return Table("processors", caption, ("Processor", "Runs", *_HOURS), rows)


def _hours(runs: pd.DataFrame) -> tuple[str, str]:
    counted = runs["processor_hours"].dropna()
    of = f"{number(counted.sum(), 1)} ({len(counted)})" if len(counted) else DASH
    return number(runs["hours"].sum(), 1), of


def _span(values: pd.Series) -> str:
    if values.empty:
        return DASH
    low, high = values.min(), values.max()
    return f"{low}" if low == high else f"{low} to {high}"


def _published() -> dict[str, str]:
    """Return the day on which each run's record was committed; nothing where there is no git."""
    log = git("log", "--diff-filter=A", "--format=%cs", "--name-only", "--", "data/results") or ""
    dates, day = {}, ""
    for line in filter(None, log.splitlines()):
        if line.endswith(RECORD):
            dates[line.split("/")[-2]] = day
        elif "/" not in line:
            day = line.replace("-", "\N{NON-BREAKING HYPHEN}")
    return dates


# ---------------------------------------------------------------- what became of the claims


@cache
def judged() -> pd.DataFrame:
    """Return every claim with what this book's runs say, of all studies that are judged."""
    frames = {study: results.load_records(study, "book") for study in claims.CLAIMS}
    return pd.concat(
        [
            claims.evaluate(frame).assign(study=study, planned=results.n_trials(frame))
            for study, frame in frames.items()
        ],
        ignore_index=True,
    )


def verdicts() -> Table:
    """Return the claims in short, a row for each that is made of several bodies."""
    grouped: dict[str, list[str]] = {}
    waiting: dict[str, list[str]] = {}
    for row in judged().itertuples():
        claim, finding = row.claim, row.findings[0]
        texts = grouped.setdefault(claim.title, [])
        if np.isnan(finding.ours):
            waiting.setdefault(claim.title, []).append(claim.body)
            continue
        digits = claim.measures[0].digits
        ours = f"{finding.measure.name} {number(finding.ours, digits)}"
        if np.isfinite(finding.interval).all():
            ours += " [{} to {}]".format(*(number(bound, digits) for bound in finding.interval))
        if claim.printed is not None:
            ours += f", the paper's {number(claim.printed, digits)}"
        trials = "; ".join(f"{name} {count}" for name, count in finding.trials.items())
        if not np.isnan(finding.detectable):
            power = number(finding.detectable, digits)
            trials += f"; {row.planned} would find a difference of {power}"
        texts.append(f"**{claim.body} {row.verdict}:** {ours} ({trials})")
    for title, names in waiting.items():
        grouped[title].append(f"**undecided, no value yet:** {', '.join(names)}")
    rows = [(title, "<br>".join(texts)) for title, texts in grouped.items()]
    caption = (
        "The paper's claims by the rules of the scorecard: for each body the verdict, the value"
        " with its 95 % interval where there are trials enough, and in brackets its trials."
    )
    return Table("verdicts", caption, ("Claim", "Here"), rows)


def counts() -> dict[str, str]:
    """Return what sentences count: runs, hours, verdicts."""
    found, plans, verdict = costs(), planned(), judged()["verdict"].value_counts()
    return {
        "runs": f"{len(found)}",
        "missing": f"{int(plans['hours'].isna().sum())}",
        "steps": number(found["steps"].sum()),
        "hours": number(found["hours"].sum(), 1),
        "hours_left": number(hours_left(plans)),
        "claims": f"{len(judged())}",
        "hold": f"{verdict.get(claims.HOLDS, 0)}",
        "fail": f"{verdict.get(claims.FAILS, 0)}",
        "undecided": f"{verdict.get(claims.UNDECIDED, 0)}",
        "few": f"{judged()['reason'].str.startswith('too few trials').sum()}",
        "power": number(100 * statistics.POWER),
        "largest": number(found["hours"].max(), 1),
    }


# ---------------------------------------------------------------- figures


@style.applied()
def improvement(frame: pd.DataFrame) -> Figure:
    """Draw for each body how probably a trial of SILEM returns more than one of another method.

    It is the share of pairs of trials, with Newcombe's interval. A mark is full where the interval
    leaves out one half and both methods have the trials that a claim needs, else hollow: undecided.
    """
    rivals = [m for m in style.METHODS if m not in ("silem", "ppo", "random")]
    rows = [(rival, body) for rival in rivals for body in results.body_names(frame)
            if results.is_planned(frame, rival, body)]  # fmt: skip
    figure, axes = style.new_figure(0.9 + 0.27 * len(rows))
    labels = []
    for y, (rival, body) in enumerate(rows):
        look = style.method(rival, results.original_body(frame))
        cells = [results.scores(frame, method, body, "return_mean") for method in ("silem", rival)]
        labels.append(f"{look.label}, {body}")
        low, high = statistics.wins_interval(*cells)
        counts = [len(cell) for cell in cells]
        if min(counts):
            decided = min(counts) >= claims.MIN_TRIALS and not low <= 0.5 <= high
            faint = {} if decided else {"mfc": "white", "mew": 1.6}
            axes.plot([low, high], [y, y], color=look.color, lw=2, alpha=1 if decided else 0.45)
            axes.plot([statistics.wins(*cells)], [y], look.marker, color=look.color, ms=7, **faint)
        text = "no run" if not min(counts) else f"{counts[0]} and {counts[1]} trials"
        axes.text(1.03, y, text, va="center", fontsize=8, color=style.MUTED)
    axes.axvline(0.5, color=style.MUTED, lw=1, ls=style.DASHED)
    axes.set_yticks(range(len(rows)), labels)
    axes.set(xlim=(-0.02, 1.02), ylim=(len(rows) - 0.5, -0.5))
    axes.set_xlabel("probability that a trial of SILEM returns more than one of the method named")
    axes.grid(axis="x")
    axes.grid(visible=False, axis="y")
    note = (
        "bars: Newcombe's 95 % score interval of the share of pairs of trials; hollow: undecided,"
        f" it spans one half or a method has fewer than {claims.MIN_TRIALS} trials"
    )
    return scores.finish(figure, frame, note=note)


@style.applied()
def profiles(frame: pd.DataFrame) -> Figure:
    """Draw each method's performance profile: the share of its runs that score more than tau.

    A run's score is its return over the mean of the body's experts, on humanoids, which have none,
    over the highest return. All bodies' runs count alike; from `scores.INTERVAL_TRIALS` runs on a
    band is Clopper and Pearson's 95 % interval at each tau.
    """
    walks = bodies.get(results.body_names(frame)[0]).family == "humanoid"
    unit = paper.number("humanoid_max_return") if walks else frame["expert_return"]
    scored = frame.assign(score=frame["return_mean"].astype(float) / unit)
    low, top = (np.nan_to_num(end) for end in (scored["score"].min(), scored["score"].max()))
    low, top = min(0.0, low), max(1.05, top + 0.05)
    figure, axes = style.new_figure(3.2)
    taus, handles = np.linspace(low, top, 500), []
    for name in (name for name in style.METHODS if (frame["method"] == name).any()):
        look = style.method(name, results.original_body(frame))
        values = scored.loc[scored["method"] == name, "score"].dropna().to_numpy()
        handles.append(style.handle(look.color, f"{look.label}, {len(values)} runs", lw=2.2))
        if not len(values):
            continue
        above = (values[:, None] > taus).sum(axis=0)
        lone = len(values) < scores.INTERVAL_TRIALS
        line: dict[str, Any] = {"lw": 1.2, "ls": style.DASHED} if lone else {"lw": 2}
        axes.step(taus, above / len(values), color=look.color, **line)
        if not lone:
            tests = [stats.binomtest(k, len(values)) for k in range(len(values) + 1)]
            band = np.array([test.proportion_ci(statistics.LEVEL) for test in tests])[above]
            axes.fill_between(taus, *band.T, color=look.color, alpha=0.14, lw=0, step="pre")
    axes.set(ylim=(-0.02, 1.04), ylabel="share of runs above τ", xlim=(low, top))
    over = "the highest possible" if walks else "the mean of the body's experts"
    axes.set_xlabel(f"τ: return of an episode over {over}")
    if not handles:
        style.say(axes, "no run")
    note = (
        f"dashed: fewer than {scores.INTERVAL_TRIALS} runs, without a band; bands: Clopper"
        " and Pearson's 95 % interval at each τ, as if all bodies' runs were of one kind"
    )
    return scores.finish(figure, frame, handles, note)


FIGURES: dict[str, Callable[[pd.DataFrame], Figure]] = {
    "learning_curves": curves.learning_curves,
    "improvement": improvement,
    "profiles": profiles,
}


class ResultsFigure(SphinxDirective):
    """A figure by its name and its study's; its content is the caption."""

    required_arguments = 2
    has_content = True

    def run(self) -> list[nodes.Node]:
        """Draw the figure; return it, and what stands under it."""
        name, study = self.arguments
        whole, trained = results.load_records(study, "book"), [*METHODS]
        trained.remove("random")
        shown = results.select(whole, trained)
        shown.attrs["figure"] = name
        caption, file = " ".join(self.content), f"figures/{name}-{study}.svg"
        path = Path(self.env.srcdir) / "book" / file
        files.write_text(path, style.svg(FIGURES[name](shown)))
        lines = [f":::{{figure}} {file}", f":name: {name}-{study}", f":alt: {caption}", "", caption]
        cells = [nodes.container(classes=["cell"]) for _ in range(2)]
        text = StringList([*lines, ":::"], source="")
        self.state.nested_parse(text, self.content_offset, cells[0])
        cells[1] += nodes.raw("", results.trace(shown).data, format="html")
        return list(cells)


# ---------------------------------------------------------------- where the data is from


def cards() -> list[tuple[str, list[tuple[str, str]]]]:
    """Return for each file of demonstrations its name, and what a data card says of it."""
    made = []
    for name, about in files.read_json(paths.demonstrations_dir() / MANIFEST).items():
        if run := about["expert_run_id"]:
            origin = f"{about['n_trajectories']} episodes of the expert of run `{run}`"
            licence = "this project's own, MIT"
        else:
            origin = f"clip {about['clip']} of the [CMU database]({about['source']}), a man walking"
            licence = f"{about['licence']} ({about['acknowledgement']})"
        if parent := about.get("retargeted_from"):
            origin += f", `{parent}` retargeted with {about['solver']}"
        summary = about.get("summary", {})
        speed = about.get("speed_m_s", summary.get("speed_m_s"))
        fields = [("Body", about["body"]), ("Origin", origin)]
        if "n_states" in about:
            fields.append(("Size", f"{about['n_states']} states, {about['rate_hz']:g} a second"))
        if speed:
            fields.append(("Speed", f"{number(speed, 2)} m/s"))
        fields += [
            ("Holds", f"{about['n_features']} features of each state, no actions, no rewards"),
            ("Changed", ", ".join(about.get("repairs", [])) or "no repairs"),
            ("Licence", licence),
            ("SHA-256", f"`{about['sha256'][:16]}…`"),
        ]
        if about.get("n_failed") is not None:
            fields.insert(-2, ("Failed episodes", f"{about['n_failed']}, kept"))
        made.append((f"{name}.npz", fields))
    return made


class DataCards(SphinxDirective):
    """The data cards, as a grid."""

    def run(self) -> list[nodes.Node]:
        """Return the grid, parsed from MyST's Markdown."""
        lines = ["::::{grid} 1 1 2 2", ":gutter: 2", ""]
        for name, fields in cards():
            lines += [f":::{{grid-item-card}} `{name}`", ":class-card: silem-card"]
            lines += ["", *(f"- **{label}** {text}" for label, text in fields), ":::"]
        parent = nodes.container()
        self.state.nested_parse(
            StringList([*lines, "::::"], source=""), self.content_offset, parent
        )
        return list(parent.children)


def _counted(name: str) -> tuple[str, str]:
    return counts()[choose("count", name, counts())], "counted from the committed records"


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the tables, the cards and the role with Sphinx."""
    ours = {
        "cost": cost,
        "cost-per-run": cost_per_run,
        "processors": processors,
        "verdicts": verdicts,
    }
    for name, table in ours.items():
        TABLES[name] = table
        app.add_directive(name, TableDirective)
    app.add_directive("data-cards", DataCards)
    app.add_directive("results-figure", ResultsFigure)
    app.add_role("counted", role(_counted))
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
