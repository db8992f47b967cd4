"""The scorecard: the paper's claims, each with the rule that decides it, and what our runs say.

The rules, in ``claims.toml``, were fixed before the cells that they judge were complete, the Ants'
before any run.
A claim measures one or two quantities, each a mean over trials against bounds. Its interval is a
95 % t interval (Student's for one cell, Welch's for two). A quantity passes where the whole
interval lies within its bounds and fails where all of it lies outside; a claim "holds" or "does not
hold" where its quantities decide it, and is "undecided" otherwise, with the reason. No interval
holds the variance of the demonstrator: all imitators of a study learn from the same one.
"""

import math
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pandas.io.formats.style import Styler

from silem import bodies, paper
from silem.bodies.body import MAX_STEPS
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.report import results, statistics, style
from silem.report.statistics import NO_INTERVAL, Interval
from silem.report.style import METHODS, QUANTITIES, Quantity, number
from silem.report.tables import small, styled
from silem.study.settings import BUDGETS
from silem.study.studies import cells
from silem.util.errors import choose

MIN_TRIALS, MARGIN, WALKING = 3, 0.1, 0.5
_DATA = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
RULES = {name: text.format(trials=MIN_TRIALS, margin=MARGIN, most=1 - MARGIN, walking=WALKING,
                           power=statistics.POWER).replace("%", " %")
         for name, text in _DATA.pop("rules").items()}  # fmt: skip
"""What the rules of the claims have in common, in words."""

HOLDS, FAILS, UNDECIDED = "holds", "does not hold", "undecided"
_COLORS = {HOLDS: "#DDF3E4", FAILS: "#FBE3E0", UNDECIDED: "#F1F1F1"}

_GAP = "SILEM beats SILEM⁻"

Cell = tuple[str, str]
"""A method and a body."""


@dataclass(frozen=True)
class Measure:
    """A quantity and the bounds between which it has to lie: a rule as data.

    It is the mean of a cell `of` the table, in a column of `results.values`, `less` another's, or
    `per` another's, which is then the unit.
    """

    of: Cell
    column: str
    less: Cell | None = None
    per: Cell | None = None
    lower: float = -np.inf
    upper: float = np.inf

    @property
    def cells(self) -> list[Cell]:
        """The cells that have to have trials, `of` first."""
        return [cell for cell in (self.of, self.less, self.per) if cell]

    @property
    def digits(self) -> int:
        """Digits after the point when written."""
        return 2 if self.per else self._quantity.digits

    @property
    def name(self) -> str:
        """What is measured, in words."""
        name = self._quantity.heading
        if self.per:
            return "score" if name == "return" else f"{name.partition(' ')[0]} ratio"
        return f"difference in {name}" if self.less else name

    @property
    def rule(self) -> str:
        """What the bounds ask for, in words."""
        low, high = (number(bound, self.digits) for bound in (self.lower, self.upper))
        if np.isfinite([self.lower, self.upper]).all():
            return f"{self.name} from {low} to {high}"
        return f"{self.name} " + (f"above {low}" if np.isfinite(self.lower) else f"below {high}")

    @property
    def _quantity(self) -> Quantity:
        return QUANTITIES.get(self.column, Quantity(f"mean of {self.column}"))

    def find(self, frame: pd.DataFrame) -> "Finding":
        """Read the quantity off a table of runs."""
        samples = [results.values(frame, *cell, self.column) for cell in self.cells]
        counts = {self._label(c): len(v) for c, v in zip(self.cells, samples, strict=True)}
        ours, *other = (float(v.mean()) if len(v) else np.nan for v in samples)
        unit, bound, best, wins = 1.0, 0.0, np.nan, np.nan
        if self.less:
            ours, wins = ours - other[0], statistics.wins(*samples)
        if self.per:
            # Tested is mean - bound * mean expert: it holds the spread of both.
            unit = other[0] if other[0] > 0 else np.nan
            bound = self.lower if np.isfinite(self.lower) else self.upper
            ours, best = ours / unit, float(ours / samples[1].max(initial=unit))
        compared = [samples[0], bound * samples[1]] if self.per else samples
        low, high = NO_INTERVAL
        if min(counts.values()) >= MIN_TRIALS:
            low, high = statistics.interval(*compared)
        tested = interval = bound + low / unit, bound + high / unit
        if self.per and np.isfinite(tested).all():
            interval = statistics.ratio_interval(*samples)
        planned, power = results.n_trials(frame), np.nan
        if planned > 1 and self.column != "returns":
            power = statistics.detectable(*compared, n_trials=planned) / unit
        return Finding(self, ours, interval, counts, power, wins, best, tested)

    def _label(self, cell: Cell) -> str:
        if self.column == "returns":
            return "episodes"
        several = len({body for _, body in self.cells}) > 1
        return METHODS[cell[0]].short + f" {cell[1]}" * several


@dataclass(frozen=True)
class Finding:
    """What the runs say about one quantity; what no run tells is NaN."""

    measure: Measure
    ours: float
    interval: Interval  # of 95 %, NaN where a cell has fewer than `MIN_TRIALS` trials
    trials: dict[str, int]  # of each cell that it rests on, by the cell's name
    detectable: float = float("nan")  # from the bound, what the planned trials would have found
    wins: float = float("nan")  # share of pairs of trials in which the first of two cells is higher
    of_best: float = float("nan")  # the score against the best expert
    tested: Interval | None = None  # against the bound, where that is not `interval`: of a ratio

    @property
    def enough(self) -> bool:
        """Whether every cell has its trials."""
        return min(self.trials.values()) >= MIN_TRIALS

    @property
    def verdict(self) -> tuple[str, str]:
        """The verdict by the module's rule, and why it is undecided if it is."""
        low, high = self.tested or self.interval
        lower, upper = self.measure.lower, self.measure.upper
        few = {name: count for name, count in self.trials.items() if count < MIN_TRIALS}
        if few:
            words = ", ".join(f"{name} {count}" for name, count in few.items())
            return UNDECIDED, f"too few trials: {words}; {MIN_TRIALS} needed"
        if np.isnan(self.ours):
            return UNDECIDED, "no expert level: the experts' mean return is not above zero"
        if lower <= low and high <= upper:
            return HOLDS, ""
        if high < lower or upper < low:
            return FAILS, ""
        return UNDECIDED, f"the interval of the {self.measure.name} spans the bound"


@dataclass(frozen=True)
class Claim:
    """One claim of the paper about one body, without which its title stands."""

    title: str
    body: str
    where: str  # the paper makes it
    measures: tuple[Measure, ...]
    either: bool = False  # it holds where one of the measures passes; else all have to
    printed: float | None = None  # the paper's number; None where it only shows a figure
    moves: tuple[Cell, ...] = ()  # tested where the first moves, by the second's speed

    @property
    def text(self) -> str:
        """The claim in words."""
        return f"{self.title} on {self.body}"

    @property
    def rule(self) -> str:
        """What "holds" means, in words."""
        return (" or " if self.either else " and ").join(m.rule for m in self.measures)

    def judge(self, frame: pd.DataFrame) -> tuple[list[Finding], str, str]:
        """Return what a table of runs says: findings, verdict, and why it is undecided if it is."""
        findings = [measure.find(frame) for measure in self.measures]
        found = [finding.verdict for finding in findings]
        verdicts = [verdict for verdict, _ in found]
        decisive, other = (HOLDS, FAILS) if self.either else (FAILS, HOLDS)
        _, budget = results.context(frame)
        if not BUDGETS[budget].is_evidence:
            return findings, UNDECIDED, f"runs at budget {budget} are no evidence"
        cells = dict.fromkeys(cell for measure in self.measures for cell in measure.cells)
        if absent := [c for c in cells if not results.is_planned(frame, *c)]:
            words = ", ".join(f"{METHODS[method].short} on {body}" for method, body in absent)
            return findings, UNDECIDED, f"not planned: {words}"
        if all(reason.startswith("too few") for _, reason in found):
            return findings, UNDECIDED, found[0][1]
        if self.moves and (standing := self._standing(frame)):
            return findings, UNDECIDED, standing
        if decisive in verdicts:
            return findings, decisive, ""
        if set(verdicts) == {other}:
            return findings, other, ""
        return findings, UNDECIDED, "; ".join(dict.fromkeys(why for _, why in found if why))

    def _standing(self, frame: pd.DataFrame) -> str:
        """Say that the expert stands, if it does."""
        expert, mover = (results.values(frame, *cell, "speed_m_s") for cell in self.moves)
        if len(mover) and expert.mean() >= MARGIN * mover.mean():
            return ""
        if not len(mover):
            return "no expert level: no expert of the demonstrator's body"
        ours = results.values(frame, *self.measures[0].of, "speed_m_s").mean()
        return (
            f"no expert level: PPO's experts stand ({expert.mean():.2f} m/s), so the score cannot"
            f" test it; the imitators' speed: {ours:.2f} m/s".replace("-", "−")
        )


_LEVELS = {
    "most": 1 - MARGIN,
    "half": WALKING,
    "survives": (1 - MARGIN) * MAX_STEPS,
    "return": MARGIN * (paper.number("expert_return") - paper.number("random_return")),
    "reward": MARGIN * max(paper.number("disc_reward_range")),
    "gap": MARGIN * paper.number("humanoid_max_return"),
    "walking": WALKING * DEMONSTRATOR_SPEED_M_S,
    "fast": (1 - MARGIN) * DEMONSTRATOR_SPEED_M_S,
}
"""What bounds are named after; beside them stands a body's slope, "angle"."""


def _claims(study: str) -> tuple[Claim, ...]:
    """Read a study's claims, body by body."""
    names = list(dict.fromkeys(cell.body for cell in cells(study)))
    return tuple(
        _claim(body, **{name: value for name, value in entry.items() if name != "bodies"})
        for entry in _DATA[study]
        for body in entry.get("bodies", names)
    )


def _claim(
    body: str,
    title: str,
    where: str,
    measures: Sequence[dict[str, Any]],
    printed: Sequence[str] = (),
    moves: Sequence[str] = (),
    either: bool = False,
) -> Claim:
    """Read a claim about one body; a word that is none of the file's is an error."""

    def cell(text: str) -> Cell:
        method, _, other = text.partition("@")
        return method, other or body

    def bound(given: Any) -> float:
        factor, level = given if isinstance(given, list) else (1.0, given)
        if isinstance(level, str):
            level = math.radians(bodies.get(body).slope_deg) if level == "angle" else _LEVELS[level]
        return float(factor * level)

    def measure(
        of: str, column: str, near: str = "", lower: Any = -math.inf, upper: Any = math.inf,
        **others: str,
    ) -> Measure:  # fmt: skip
        if near:
            lower, upper = numbers[0] - _LEVELS[near], numbers[0] + _LEVELS[near]
        compared: Any = {name: cell(other) for name, other in others.items()}
        return Measure(cell(of), column, lower=bound(lower), upper=bound(upper), **compared)

    numbers = [_printed(name) for name in printed]
    told = numbers[0] - sum(numbers[1:]) if numbers else None
    found = tuple(measure(**entry) for entry in measures)
    return Claim(title, body, where, found, either, told, tuple(map(cell, moves)))


def _printed(name: str) -> float:
    """Return a number of the paper, or an entry of its Table 1, "MLP.ground_truth_reward"."""
    row, _, column = name.partition(".")
    rows = {row["f"]: row for row in paper.table("tab1").rows}
    return float(rows[row][column] if column else paper.number(row))


CLAIMS = {study: _claims(study) for study in _DATA}
"""Every claim that is judged so far, by the study whose runs judge it."""


def of(study: str) -> tuple[Claim, ...]:
    """Return the claims that a study's runs judge, in the book's order; SilemError if none can."""
    return CLAIMS[choose("study with claims", study, CLAIMS)]


# ---------------------------------------------------------------- the page


def evaluate(frame: pd.DataFrame, study: str = "") -> pd.DataFrame:
    """Judge the claims about a study, by default the table's own: a row each, with its verdict."""
    judged = of(study or results.context(frame)[0])
    rows = [(claim, claim.text, *claim.judge(frame)) for claim in judged]
    return pd.DataFrame(rows, columns=["claim", "text", "findings", "verdict", "reason"])


def table(frame: pd.DataFrame) -> Styler:
    """Return the scorecard for a page: the claim with its rule, the paper's number, ours, verdict.

    Where a study plans the same cells with the paper's loss for D, without our gradient penalty,
    its verdicts stand beside ours. Below a value with its 95 % interval: the trials, the score
    against the best expert, the share of pairs of trials in which the first of two cells is
    higher, and the distance from the bound that the planned trials would have found.
    """
    study, _ = results.context(frame)
    judged = {name: (runs, evaluate(runs, study)) for name, runs in _losses(frame).items()}
    rows = []
    for index, claim in enumerate(of(study)):
        row: dict[Any, str] = {
            ("", "claim"): claim.text + small(f"{claim.where}; holds if: {claim.rule}"),
            ("", "paper"): number(claim.printed, claim.measures[0].digits),
        }
        for name, (runs, found) in judged.items():
            entry, planned = found.iloc[index], results.n_trials(runs)
            row[name, "value"] = "<br>".join(
                value(finding, planned, alone=len(entry.findings) == 1, trials=i == 0)
                for i, finding in enumerate(entry.findings)
            )
            row[name, "verdict"] = f"<b>{entry.verdict}</b>" + small(entry.reason)
        rows.append(row)
    page = styled(pd.DataFrame(rows))
    return page.map(_color, subset=[column for column in page.columns if column[1] == "verdict"])


def gap(frame: pd.DataFrame) -> pd.DataFrame:
    """Return, as text, under which loss of D SILEM's gap over its ablation appears, by `RULES`."""
    rows = []
    for claim in (c for c in of(results.context(frame)[0]) if c.title == _GAP):
        row, appears, known = {"body": claim.body}, [], True
        for name, runs in _losses(frame).items():
            (finding,), verdict, _ = claim.judge(runs)
            told = value(finding, results.n_trials(runs), alone=True, trials=True)
            row[f"SILEM less SILEM⁻, {name}"] = told
            appears += [name] * (verdict == HOLDS)
            known &= finding.enough
        where = " and ".join(appears) or "neither"
        rows.append(row | {"the gap appears under": where if known else "open: too few trials"})
    return pd.DataFrame(rows)


def _losses(frame: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return a study's runs and, where there are any, those with the paper's loss for D."""
    tables = {"this book's loss": frame, "the paper's loss": results.paper_loss(frame)}
    return {name: runs for name, runs in tables.items() if runs is not None}


def counts(frame: pd.DataFrame) -> dict[str, int]:
    """Count the verdicts: how many claims hold, do not hold, or are undecided."""
    found = evaluate(frame)["verdict"].value_counts()
    return {name: int(found.get(name, 0)) for name in (HOLDS, FAILS, UNDECIDED)}


def rules() -> Styler:
    """Return what the claims' rules have in common, in words."""
    return styled(pd.DataFrame(RULES.items(), columns=["rule", "what it says"]))


def value(finding: Finding, planned: int, *, alone: bool, trials: bool) -> str:
    """Write a value with everything that bears on it; its name before it unless it is alone."""
    measure = finding.measure
    write = partial(number, digits=measure.digits)
    text = style.estimate(finding.ours, finding.interval, measure.digits)
    text = text if alone else f"{measure.name} {text}"
    lines = [f"{name} {count}" for name, count in finding.trials.items()] if trials else []
    if measure.name == "score" and not np.isnan(finding.of_best):
        lines.append(f"against the best expert {write(finding.of_best)}")
    if not np.isnan(finding.wins):
        lines.append(f"{number(100 * finding.wins)} % of pairs")
    if not np.isnan(finding.detectable):
        lines.append(f"{planned} trials find ±{write(finding.detectable)}")
    return text + small("; ".join(lines))


def _color(cell: str) -> str:
    verdict = cell.removeprefix("<b>").partition("</b>")[0]
    return f"background-color: {_COLORS[verdict]}; color: #222"
