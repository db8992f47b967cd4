"""The scorecard: the paper's claims, each with the rule that decides it, and what our runs say.

The rules were fixed before the cells that they judge were complete, the Ants' before any run.
A claim measures one or two quantities, each a mean over trials against bounds. Its interval is a
95 % t interval (Student's for one cell, Welch's for two). A quantity passes where the whole
interval lies within its bounds and fails where all of it lies outside; a claim "holds" or "does not
hold" where its quantities decide it, and is "undecided" otherwise, with the reason. No interval
holds the variance of the demonstrator: all imitators of a study learn from the same one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from pandas.io.formats.style import Styler

from silem import bodies, paper
from silem.bodies.body import MAX_STEPS
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.report import results, statistics
from silem.report.statistics import NO_INTERVAL, Interval
from silem.report.style import number
from silem.report.tables import small, styled
from silem.study.settings import BUDGETS
from silem.study.studies import cells
from silem.util.errors import choose

MIN_TRIALS, MARGIN, WALKING = 3, 0.1, 0.5
RULES = {
    "trials": f"Every cell of a claim needs {MIN_TRIALS} trials of the planned iterations.",
    "margin": f"Two levels agree within {100 * MARGIN:.0f} % of their scale: for returns of the"
    " span from the paper's random policy to its expert (humanoids: of the highest return), for"
    " rewards of D of the largest, for scores and shares of 1, for speeds of the demonstrator's.",
    "score": "The mean return over trials by the mean return of the body's own experts; its"
    " interval holds the spread of both. Beside it stands the score against the best of them.",
    "expert level": f"Return and speed both reach {1 - MARGIN:g} of the experts' (score and speed"
    " ratio). An expert stands"
    f" where its speed is below {MARGIN:g} of that of the demonstrator's body; a score of 1 is then"
    " standing, and the claim cannot be tested by it.",
    "stable gait": f"The body survives {1 - MARGIN:g} of an episode's steps and moves at"
    f" {WALKING:g} of the demonstrator's speed or more, so that standing still is no gait. That is"
    " the human's; for the Ants the mean of Ant0's experts.",
    "power": f"The difference found in {100 * statistics.POWER:.0f} % of all studies with as many"
    " trials as are planned, if the spread is the one seen.",
}  # fmt: skip
"""What the rules of the claims have in common, in words."""

HOLDS, FAILS, UNDECIDED = "holds", "does not hold", "undecided"
_COLORS = {HOLDS: "#DDF3E4", FAILS: "#FBE3E0", UNDECIDED: "#F1F1F1"}

Cell = tuple[str, str]
"""A method and a body."""

_NAMES = {
    "silem": "SILEM", "silem-minus": "SILEM⁻", "silem-minus-own": "SILEM⁻ own",
    "silem-mlp": "MLP", "tpil": "TPIL", "peng20": "Peng20", "ppo": "expert", "random": "random",
}  # fmt: skip
_QUANTITIES = {
    "return_mean": ("return", 0), "returns": ("return", 0), "disc_reward": ("reward of D", 0),
    "speed_m_s": ("speed (m/s)", 2), "upright": ("share of steps survived", 2),
    "steps": ("steps of an episode", 0),
}  # fmt: skip


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
        return 2 if self.per else _QUANTITIES.get(self.column, ("", 2))[1]

    @property
    def name(self) -> str:
        """What is measured, in words."""
        name = _QUANTITIES.get(self.column, (f"mean of {self.column}", 2))[0]
        if self.per:
            return "score" if name == "return" else f"{name.partition(' ')[0]} ratio"
        return f"difference in {name}" if self.less else name

    @property
    def rule(self) -> str:
        """What the bounds ask for, in words."""
        low, high = (f"{bound:,.{self.digits}f}" for bound in (self.lower, self.upper))
        if np.isfinite([self.lower, self.upper]).all():
            return f"{self.name} from {low} to {high}".replace("-", "−")
        words = f"above {low}" if np.isfinite(self.lower) else f"below {high}"
        return f"{self.name} {words}".replace("-", "−")

    def find(self, frame: pd.DataFrame) -> Finding:
        """Read the quantity off a table of runs."""
        samples = [results.values(frame, *cell, self.column) for cell in self.cells]
        counts = {self._label(c): len(v) for c, v in zip(self.cells, samples, strict=True)}
        ours, *other = (float(v.mean()) if len(v) else np.nan for v in samples)
        unit, bound, best, wins = 1.0, 0.0, np.nan, np.nan
        if self.less:
            ours, wins = ours - other[0], statistics.wins(*samples)
        if self.per:
            # The interval of mean - bound * mean expert, over the expert's mean: it holds the
            # spread of both.
            unit = other[0] if other[0] > 0 else np.nan
            bound = self.lower if np.isfinite(self.lower) else self.upper
            ours, best = ours / unit, float(ours / samples[1].max(initial=unit))
            samples[1] = bound * samples[1]
        low, high = NO_INTERVAL
        if min(counts.values()) >= MIN_TRIALS:
            low, high = statistics.interval(*samples)
        interval = bound + low / unit, bound + high / unit
        planned, power = results.n_trials(frame), np.nan
        if planned > 1 and self.column != "returns":
            power = statistics.detectable(*samples, n_trials=planned) / unit
        return Finding(self, ours, interval, counts, power, wins, best)

    def _label(self, cell: Cell) -> str:
        if self.column == "returns":
            return "episodes"
        several = len({body for _, body in self.cells}) > 1
        return f"{_NAMES[cell[0]]} {cell[1]}" if several else _NAMES[cell[0]]


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

    @property
    def verdict(self) -> tuple[str, str]:
        """The verdict by the module's rule, and why it is undecided if it is."""
        low, high = self.interval
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
    moves: tuple[Cell, Cell] | None = None  # tested where the first moves, by the second's speed

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
            words = ", ".join(f"{_NAMES[method]} on {body}" for method, body in absent)
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
        assert self.moves
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


_RETURN = MARGIN * (paper.number("expert_return") - paper.number("random_return"))
_REWARD = MARGIN * max(paper.number("disc_reward_range"))
_HALF_CHEETAHS, _ANTS = ("HC0", "HC1", "HC2"), tuple(f"Ant{i}" for i in range(7))
_GAITS = "Section 5, 'Can the sequential affine transform ...'"


def _exceeds(first: Cell, second: Cell, above: float = 0.0, column: str = "return_mean") -> Measure:
    return Measure(first, column, less=second, lower=above)


def _runners(names: Sequence[str], figure: str) -> tuple[Claim, ...]:
    """What Figures 2b and 2d show alike: a family's bodies, of which the first demonstrates."""

    def reaches(who: str, method: str, body: str) -> Claim:
        both = [
            Measure((method, body), column, per=("ppo", body), lower=1 - MARGIN)
            for column in ("return_mean", "speed_m_s")
        ]
        moves = ("ppo", body), ("ppo", names[0])
        return Claim(f"{who} reaches expert level", body, figure, tuple(both), moves=moves)

    own, minus = "silem-minus-own", "silem-minus"
    return (
        *(reaches("SILEM", "silem", body) for body in names),
        *(Claim("Without the transform imitation degrades, against the body's own expert", body,
                figure, (_exceeds((own, body), (minus, body)),)) for body in names[1:]),
        *(Claim("SILEM beats SILEM⁻", body, figure,
                (_exceeds(("silem", body), (minus, body)),)) for body in names[1:]),
        *(reaches("SILEM⁻ from the own expert", own, body) for body in names),
    )  # fmt: skip


def _half_cheetahs() -> tuple[Claim, ...]:
    """Figure 2b, Table 1 and the numbers around it."""
    text = "Section 5, 'Why does the sequential affine transform ...'"
    mlp, affine = paper.table("tab1").rows

    def agrees(who: str, where: str, method: str, column: str, printed: float) -> Claim:
        half = _REWARD if column == "disc_reward" else _RETURN
        measure = Measure((method, "HC0"), column, lower=printed - half, upper=printed + half)
        name = "discriminator reward" if column == "disc_reward" else "return"
        return Claim(f"{who}'s {name} is the paper's", "HC0", where, (measure,), printed=printed)

    rows = [("SILEM", "silem", affine), ("The MLP", "silem-mlp", mlp)]
    gap = mlp["discriminator_reward"] - affine["discriminator_reward"]
    lead = affine["ground_truth_reward"] - mlp["ground_truth_reward"]
    silem, network = ("silem", "HC0"), ("silem-mlp", "HC0")
    return (
        agrees("The random policy", text, "random", "returns", paper.number("random_return")),
        agrees("The expert", text, "ppo", "return_mean", paper.number("expert_return")),
        *(agrees(who, "Table 1", method, "return_mean", printed["ground_truth_reward"])
          for who, method, printed in rows),
        *(agrees(who, "Table 1", method, "disc_reward", printed["discriminator_reward"])
          for who, method, printed in rows),
        Claim("The MLP fools D as well as the affine transform", "HC0", "Table 1",
              (_exceeds(network, silem, -_REWARD, "disc_reward"),), printed=gap),
        Claim("The affine transform leads to the better policy than the MLP", "HC0", "Table 1",
              (_exceeds(silem, network, _RETURN),), printed=lead),
        *_runners(_HALF_CHEETAHS, "Figure 2b"),
    )  # fmt: skip


def _ants() -> tuple[Claim, ...]:
    """Figure 2d, and the gaits of the section on it; fixed before any Ant was trained.

    The paper says that SILEM finds stable gaits for all bodies and SILEM⁻ does not: one that it
    fails on is enough, and the rule names the one that differs most.
    """
    survives, mover, last = (1 - MARGIN) * MAX_STEPS, ("ppo", _ANTS[0]), _ANTS[-1]
    return (
        *_runners(_ANTS, "Figure 2d"),
        *(Claim("SILEM's gait is stable", body, _GAITS,
                (Measure(("silem", body), "speed_m_s", per=mover, lower=WALKING),
                 Measure(("silem", body), "steps", lower=survives))) for body in _ANTS),
        Claim("SILEM⁻ finds no stable gait", last, _GAITS,
              (Measure(("silem-minus", last), "speed_m_s", per=mover, upper=WALKING),
               Measure(("silem-minus", last), "steps", upper=survives)), either=True),
    )  # fmt: skip


def _humanoids() -> tuple[Claim, ...]:
    """Figures 3b, 4a and 4b.

    T acts on the learner's features: a left elbow that stays straighter than the demonstrator's is
    brought back to it by a lower offset. (Angles grow as an arm straightens.)
    """
    rivals = "Section 5, 'Comparison with TPIL and Peng20'"
    survives, gap = 1 - MARGIN, MARGIN * paper.number("humanoid_max_return")
    walks, fast = WALKING * DEMONSTRATOR_SPEED_M_S, (1 - MARGIN) * DEMONSTRATOR_SPEED_M_S
    everyone, others = ("Atlas", "Humanoid", "HumanoidR"), ("Humanoid", "HumanoidR")
    bounds = {"silem-minus": 0.0, "tpil": gap, "peng20": gap}
    arms = ("silem", "HumanoidR")
    return (
        *(Claim("SILEM's gait is stable", body, _GAITS,
                (Measure(("silem", body), "upright", lower=survives),
                 Measure(("silem", body), "speed_m_s", lower=walks))) for body in everyone),
        *(Claim("SILEM matches the human's speed", body, "Figure 3, caption",
                (Measure(("silem", body), "speed_m_s", lower=fast),)) for body in everyone),
        *(Claim("SILEM⁻ finds no stable gait", body, _GAITS,
                (Measure(("silem-minus", body), "upright", upper=survives),
                 Measure(("silem-minus", body), "speed_m_s", upper=walks)), either=True)
          for body in everyone),
        *(Claim(f"SILEM {'far outperforms' if bound else 'beats'} {_NAMES[rival]}", body,
                "Figure 3b", (_exceeds(("silem", body), (rival, body), bound),))
          for rival, bound in bounds.items() for body in everyone),
        *(Claim(f"{_NAMES[method]} does much better on Atlas than", body, rivals,
                (_exceeds((method, "Atlas"), (method, body), gap),))
          for method in ("peng20", "tpil", "silem-minus") for body in others),
        Claim("The short left arm's hand position is scaled up", "HumanoidR", "Figure 4a",
              (Measure(arms, "A left_hand", lower=1.0),)),
        Claim("The long right arm's hand position is scaled down", "HumanoidR", "Figure 4a",
              (Measure(arms, "A right_hand", upper=1.0),)),
        Claim("The left arm keeps the more obtuse angle", "HumanoidR", "Figure 4b",
              (Measure(arms, "b left_elbow - right_elbow", upper=0.0),)),
    )  # fmt: skip


def _slopes() -> tuple[Claim, ...]:
    """The paper's conjecture: by scaling and shifting, SILEM copes with a slope.

    A body that stands on the slope as its demonstrator on the floor has its nose up by the slope's
    angle. An offset of that angle on its pitch, positive as the nose goes down, makes up for that.
    """
    where, told = "Conclusion: 'We hypothesize ...'", []
    for body in dict.fromkeys(cell.body for cell in cells("slope")):
        angle = math.radians(bodies.get(body).slope_deg)
        offset = Measure(("silem", body), "b pitch", lower=0.5 * angle, upper=1.5 * angle)
        told += [
            Claim(
                "SILEM beats SILEM⁻",
                body,
                where,
                (_exceeds(("silem", body), ("silem-minus", body)),),
            ),
            Claim("T's offset of pitch is the angle, within half of it", body, where, (offset,)),
        ]
    return tuple(told)


CLAIMS = {
    "halfcheetah": _half_cheetahs(),
    "ant": _ants(),
    "humanoids": _humanoids(),
    "slope": _slopes(),
}
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
    tables = {"this book's loss": frame, "the paper's loss": results.paper_loss(frame)}
    judged = {name: (f, evaluate(f, study)) for name, f in tables.items() if f is not None}
    rows = []
    for index, claim in enumerate(of(study)):
        row: dict[Any, str] = {
            ("", "claim"): claim.text + small(f"{claim.where}; holds if: {claim.rule}"),
            ("", "paper"): number(claim.printed, claim.measures[0].digits),
        }
        for name, (runs, found) in judged.items():
            entry, planned = found.iloc[index], results.n_trials(runs)
            row[name, "value"] = "<br>".join(
                _value(finding, planned, alone=len(entry.findings) == 1, trials=i == 0)
                for i, finding in enumerate(entry.findings)
            )
            row[name, "verdict"] = f"<b>{entry.verdict}</b>" + small(entry.reason)
        rows.append(row)
    page = styled(pd.DataFrame(rows))
    return page.map(_color, subset=[column for column in page.columns if column[1] == "verdict"])


def counts(frame: pd.DataFrame) -> dict[str, int]:
    """Count the verdicts: how many claims hold, do not hold, or are undecided."""
    found = evaluate(frame)["verdict"].value_counts()
    return {name: int(found.get(name, 0)) for name in (HOLDS, FAILS, UNDECIDED)}


def rules() -> Styler:
    """Return what the claims' rules have in common, in words."""
    return styled(pd.DataFrame(RULES.items(), columns=["rule", "what it says"]))


def _value(finding: Finding, planned: int, *, alone: bool, trials: bool) -> str:
    """Write a value with everything that bears on it; its name before it unless it is alone."""
    measure = finding.measure
    write = partial(number, digits=measure.digits)
    text = write(finding.ours) if alone else f"{measure.name} {write(finding.ours)}"
    lines = [f"{name} {count}" for name, count in finding.trials.items()] if trials else []
    if np.isfinite(finding.interval).all():
        text += f" [{' to '.join(map(write, finding.interval))}]"
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
