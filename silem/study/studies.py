"""Studies: which runs the figures are made of."""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

from silem import bodies, paper
from silem.study import runs
from silem.study.config import SEARCH, TRIAL_SEEDS, RunConfig
from silem.study.settings import BUDGETS, Budget, HyperParameters, budget_named
from silem.util import seeding
from silem.util.errors import SilemError, choose

Settings = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class Cell:
    """One entry of a study's figures: a method on a body, from some expert, over all trials."""

    study: str
    method: str
    body: str
    demonstrations: str | None = None
    overrides: Settings = ()  # hyper-parameters other than the supplement's best combination
    n_iterations: int | None = None  # other than the budget's

    def config(self, budget: str | Budget, seed: int) -> RunConfig:
        """Return one trial's configuration."""
        budget = budget_named(budget)
        if self.n_iterations is not None and budget.is_evidence:
            budget = BUDGETS[budget.base_name].with_iterations(self.n_iterations)
        return RunConfig.create(
            self.body, self.method, self.demonstrations, budget, seed,
            study=self.study, **dict(self.overrides),
        )  # fmt: skip


@dataclass(frozen=True)
class Study:
    """Cells that are read together."""

    cells: tuple[Cell, ...]  # experts first
    seeds: tuple[int, ...]  # the trials' root seeds, fixed before any run was made
    about: str


STUDIES: dict[str, Study] = {}
SEARCH_SEEDS = (100, 101, 102, 103, 104)
"""Root seeds of searches for settings: none of them is a trial's."""


def _define(
    name: str, about: str, *groups: tuple[Any, ...], seeds: tuple[int, ...] = TRIAL_SEEDS
) -> None:
    """Enter a study, of groups of cells: methods, bodies, and what follows those in `Cell`.

    A group holds every one of its methods on every one of its bodies; one may stand by itself.
    """
    cells = (
        Cell(name, method, body, *rest)
        for methods, bodies, *rest in groups
        for method in ([methods] if isinstance(methods, str) else methods)
        for body in ([bodies] if isinstance(bodies, str) else bodies)
    )
    STUDIES[name] = Study(tuple(cells), seeds, about)


def _own(bodies: Sequence[str]) -> list[tuple[str, str, str]]:
    """Return the groups of imitators of each body's own expert."""
    return [("silem-minus-own", body, body) for body in bodies]


_ANTS = tuple(f"Ant{i}" for i in range(7))
_CHEETAHS, _HUMANOIDS = ("HC0", "HC1", "HC2"), ("Humanoid", "HumanoidR", "Atlas")
BOTH = ("silem", "silem-minus")
"""SILEM and its ablation."""
# The paper gives PPO 8000 iterations on humanoids, with a learning rate of 1e-4 and a clip range of
# 0.1. The book's budget is a fraction of that, so it takes the larger steps of the paper's other
# bodies, for every method alike.
_LARGER_STEPS = tuple((name, paper.common()[name]) for name in ("learning_rate", "clip_range"))
_NO_PENALTY = (("gradient_penalty", 0.0),)
_ENTROPY = ("disc_entropy_coef", HyperParameters().disc_entropy_coef)  # of D; SILEM's own

_define(
    "halfcheetah",
    "Figure 2b and Table 1",
    ("ppo", _CHEETAHS),
    (BOTH, _CHEETAHS, "HC0"),
    *_own(_CHEETAHS),
    ("silem-mlp", "HC0", "HC0"),
    ("random", _CHEETAHS),
)
_define("ant", "Figure 2d", ("ppo", _ANTS), (BOTH, _ANTS, "Ant0"), *_own(_ANTS), ("random", _ANTS))
_define(
    "ant-absorbing",
    "the shortest and the longest Ant, with what follows an early end judged too",
    (BOTH, ("Ant0", "Ant6"), "Ant0", (("absorbing_states", True),)),
    seeds=TRIAL_SEEDS[:3],
)
_define(
    "humanoids",
    "Figures 3b, 4a and 4b",
    (("ppo", *BOTH, "peng20", "tpil"), _HUMANOIDS, None, _LARGER_STEPS),
    ("random", _HUMANOIDS),
)
_define(
    "humanoids-no-gradient-penalty",
    "humanoids with the paper's loss for D, which has no gradient penalty",
    *((BOTH, body, None, _LARGER_STEPS + _NO_PENALTY) for body in _HUMANOIDS),
    seeds=TRIAL_SEEDS[:3],  # fewer decide nothing
)
_NO_L2 = (("transform_l2_scale", 0.0), ("transform_l2_bias", 0.0))
for _name, _about, _changed in (
    ("demonstration-starts",
     "episodes that start from the demonstration's states, which the paper argues against",
     (("starts", "demonstration"),)),
    ("plain-l2", "the plain norm of A in T's L2 term", (("transform_l2_form", "plain"),)),
    ("no-l2", "SILEM without the L2 term on T", _NO_L2),
):  # fmt: skip
    _group = ("silem", "Humanoid", None, _LARGER_STEPS + _changed)
    _define(_name, _about, _group, seeds=TRIAL_SEEDS[:1])

# Where a rival falls on a humanoid: is it the budget, its settings, or the method? A cell of the
# first and of the third study is made if that rival's first trial of "humanoids" falls on that body
# (`silem.report.pages.walking.verdicts` says which). SILEM's own settings came from eight runs on
# Humanoid, none beyond 320 iterations (data/search/humanoids.json), so each rival has as many, its
# own among them. The highest return is chosen, and entered in `_CHOSEN`; within 2 % of it, the
# setting that is in use.
_RIVALS = ("silem-minus", "tpil", "peng20")
SEARCH_ITERATIONS = 320
_define(
    "rivals-longer",
    "the humanoids' rivals at twice the iterations, to be made where one falls",
    *((_RIVALS, body, None, _LARGER_STEPS, 4000) for body in _HUMANOIDS),
    seeds=TRIAL_SEEDS[:1],
)
_OF_D: tuple[Settings, ...] = (
    (), *((("gradient_penalty", weight),) for weight in (0.0, 0.01, 1.0)),
    *((("disc_learning_rate", rate),) for rate in (3e-4, 3e-3)),
)  # fmt: skip
_DEEPER = ("encoder_layers", 2)
_OF_RIVALS = {
    "silem-minus": (*_OF_D, (("n_disc_updates", 2),), (("starts", "demonstration"),)),
    # with one layer the reversal achieves nothing at any C_g (benchmarks/reversal.py)
    "tpil": (*_OF_D, (_DEEPER,), (_DEEPER, ("gradient_reversal_coef", 1.6))),
    "peng20": (*_OF_D, (("n_disc_updates", 2),), (("starts", "demonstration"),)),
}
_define(
    "rivals-search",
    "the rivals' open settings on Humanoid, as many runs as SILEM's had",
    *(
        (method, "Humanoid", None, _LARGER_STEPS + changed, SEARCH_ITERATIONS)
        for method, tried in _OF_RIVALS.items()
        for changed in tried
    ),
    seeds=SEARCH_SEEDS[:1],
)
_CHOSEN: dict[str, Settings] = {}  # by rival, once its eight runs are done
_define(
    "rivals-settings",
    "rivals that fall, with what the search chose",
    *(
        (method, body, None, _LARGER_STEPS + changed)
        for body, (method, changed) in product(_HUMANOIDS, _CHOSEN.items())
    ),
    seeds=TRIAL_SEEDS[:1],
)
_define(
    "no-gradient-penalty",
    "HalfCheetah with the paper's loss for D, which has no gradient penalty",
    (BOTH, _CHEETAHS, "HC0", _NO_PENALTY),
    seeds=TRIAL_SEEDS[:3],
)
_define(
    "demonstrators",
    "each of HC0's five experts as the demonstrator",
    *((BOTH, body, f"HC0_s{i}") for body, i in product(("HC1", "HC2"), TRIAL_SEEDS)),
    seeds=TRIAL_SEEDS[:1],
)
_define(
    "fidelity",
    "experts at the paper's own number of iterations, and with what differs from ppo1",
    ("ppo", ("HC1", "HC2"), None, (), paper.common()["n_iterations"]),
    ("ppo", "HC0", None, (("clip_actions", False),)),
    ("ppo", "HC0", None, (("anneal_clip", True),)),
    seeds=TRIAL_SEEDS[:1],
)

# Beside the claims of "halfcheetah": the supplement's best combinations of the two methods differ
# in more than T, and T's rate was searched for the affine map, which starts as the identity.
_USED = HyperParameters.used_by("silem-minus")
_define(
    "same-settings",
    "SILEM-minus with the combination of SILEM's own cell",
    *(
        ("silem-minus", body, "HC0", (*((n, v) for n, v in best.items() if n in _USED), _ENTROPY))
        for body in ("HC1", "HC2")
        for best, _ in [paper.best_combination(body, "silem", "HC0")]
    ),
)
_define(
    "mlp-rates",
    "Table 1's MLP with larger rates of T",
    *(("silem-mlp", "HC0", "HC0", (("transform_learning_rate", r),)) for r in (1e-4, 1e-3)),
    seeds=TRIAL_SEEDS[:3],
)

# ---------------------------------------------------------------- beyond the paper

# What a study plans here is what the paper's own studies lack: the pages read both. Bodies that a
# name describes take HC0's settings, so that nothing but the length differs along a ladder. There
# the new ones have experts of their own, and others TPIL alone.
TORSOS = tuple(f"HC-{1 + i / 4:g}" for i in range(1, 9))
"""HalfCheetahs with torsos of 1.25 to 3 m; that of 1 m is HC0."""
SLOPES_DEG = (2.5, 5.0, 10.0, 15.0)

# On slopes T's rate is what lets an offset of a runner's pitch go as far as the steepest angle; so
# SILEM runs on the flat with it too, while SILEM-minus has its runs there already.
_REACHING = (("transform_learning_rate", 1e-4),)
_UPHILL = [(f"{body}-slope-{deg:g}", body) for body in ("HC0", "Ant0") for deg in SLOPES_DEG]
for _name, _about, _new, _original, _others in (
    ("ladder", "HalfCheetah's torso from 1 to 3 m by 0.25 m: where does each method break?",
     TORSOS, "HC0", "HC0"),
    ("ladder-ant", "Ant's links beyond the paper's, to 0.6",
     ("Ant-0.55", "Ant-0.6"), "Ant0", _ANTS),
):  # fmt: skip
    _define(
        _name,
        _about,
        ("ppo", _new),
        *_own(_new),
        *(((*BOTH, "tpil"), body, _original) for body in _new),
        ("tpil", _others, _original),
        seeds=TRIAL_SEEDS[:2],
    )
_define(
    "slope",
    "the conjecture: demonstrations on flat ground, learners that run uphill",
    *(("silem", *pair, _REACHING) for pair in (("HC0", "HC0"), ("Ant0", "Ant0"), *_UPHILL)),
    *(("silem-minus", *pair) for pair in _UPHILL),
    seeds=TRIAL_SEEDS[:3],
)
_define(
    "slope-humanoid",
    "the conjecture, as the paper words it: a human walks on flat ground, a humanoid uphill",
    *((BOTH, f"Humanoid-slope-{deg:g}", None, _LARGER_STEPS) for deg in SLOPES_DEG),
    seeds=TRIAL_SEEDS[:1],
)
_define(
    "ensembles",
    "K affine transforms behind a gate, where the MLP fooled D, and where one map is least enough",
    *(
        ("silem", body, original, (("transform_components", count),))
        for body, original in (("HC0", "HC0"), ("HC2", "HC0"), ("Ant6", "Ant0"))
        for count in (2, 4, 8)
    ),
    seeds=TRIAL_SEEDS[:3],
)
_define(
    "arm-lengths",
    "one policy for a humanoid whose right arm has another length in each environment",
    ("silem", "Humanoid-arm-0.5-1.5", None, _LARGER_STEPS),
    seeds=TRIAL_SEEDS[:2],
)

# The search of the settings that the paper leaves open, in stages: each stage starts from what the
# one before chose, and is added here, with what it starts from, before its runs are made. Both
# methods get the same number of runs. The rule for choosing: highest mean over HC1 and HC2 of the
# return over the mean return of the body's five experts; within 2 % of the best, the value that is
# nearer to the paper's, else to the default (page "How the open settings were found").
_RATE_1 = ("transform_learning_rate", 1e-5)  # what stage 1 chose for T
# ... and for SILEM-minus: 0.1 is the best; 0.3 is as good, but the paper has no penalty, that is 0.
# Stage 2 chose the same penalty for SILEM, without L2, and left SILEM-minus as it was.
_PENALTY = ("gradient_penalty", 0.1)
_SEARCHED: tuple[tuple[str, Settings], ...] = (
    # 1. T's rate, and what SILEM-minus has in its place: D's penalty and rate
    *(("silem", (("transform_learning_rate", rate),)) for rate in (1e-5, 3e-5, 1e-4, 3e-4, 1e-3)),
    *(("silem-minus", (("gradient_penalty", weight),)) for weight in (0.1, 0.3, 1.0)),
    *(("silem-minus", (("disc_learning_rate", rate),)) for rate in (3e-4, 3e-3)),
    # 2. the paper's L2 on A and b, and less of D's penalty; SILEM-minus: D's rates under the chosen
    # penalty, and less of that
    *(
        ("silem", (_RATE_1, ("transform_l2_scale", weight), ("transform_l2_bias", weight)))
        for weight in (1.0, 10.0)
    ),
    ("silem", (_RATE_1, _PENALTY)),
    *(("silem-minus", (_PENALTY, ("disc_learning_rate", rate))) for rate in (3e-4, 3e-3)),
    ("silem-minus", (("gradient_penalty", 0.03),)),
    # 3. the entropy bonus of D; SILEM kept its own: 1e-2 is as good, and the one in use is nearer;
    # for SILEM-minus none is the best
    *(("silem", (_RATE_1, _PENALTY, ("disc_entropy_coef", weight))) for weight in (0.0, 1e-2)),
    *(("silem-minus", (_PENALTY, ("disc_entropy_coef", weight))) for weight in (0.0, 1e-2)),
)
SEARCHED_FROM: dict[str, dict[str, Any]] = {
    "silem": {"transform_learning_rate": 1e-4, "gradient_penalty": 1.0},
    "silem-minus": {"gradient_penalty": 1.0, "disc_entropy_coef": 1e-3},
}
"""What was in use when the search began, by method; what it chose is in use since."""
_define(
    "open-settings",
    "what the paper leaves open, on HC1 and HC2",
    *(
        (method, ("HC1", "HC2"), "HC0", tuple((SEARCHED_FROM[method] | dict(overrides)).items()))
        for method, overrides in _SEARCHED
    ),
    seeds=SEARCH_SEEDS[:1],
)


def folder_of(study: str) -> str:
    """Return the name of the folder of a study's or search's runs."""
    return SEARCH + study.replace("/", "-") if "/" in study else study


def study_of(name: str) -> Study:
    """Return a study by name; STUDY/BODY/METHOD is the supplement's search of that cell.

    A search runs every point of the grid from which the supplement's best combination of the cell
    came: that combination first, then the others in an order that was shuffled once, so that the
    first so many are a fair sample, and more of them go on with it.

    Raises SilemError: there is no such study, no such cell, or the supplement has no grid for it.
    """
    study, *searched = name.split("/")
    found = STUDIES[choose("study", study, STUDIES)]
    if not searched:
        return found
    known = {}
    for cell in found.cells:
        best, table = paper.best_combination(cell.body, cell.method, cell.demonstrations or "")
        if table and table.grid:
            known[f"{cell.body}/{cell.method}"] = cell, best, table.grid
    cell, best, searched_grid = known[choose(f"search in {study}", "/".join(searched), known)]
    used, printed = HyperParameters.used_by(cell.method), paper.grid_values(searched_grid)
    grid = {paper.symbols()[symbol].parameter: values for symbol, values in printed.items()}
    grid = {name: values for name, values in grid.items() if name in used}
    points = [dict(zip(grid, values, strict=True)) for values in product(*grid.values())]
    order = seeding.generator(0, "search").permutation(len(points))
    points = sorted((points[i] for i in order), key=lambda point: point != best)
    given, label = dict(cell.overrides), folder_of(name)
    cells = (
        dataclasses.replace(cell, study=label, overrides=tuple((given | point).items()))
        for point in points
    )
    return Study(tuple(cells), SEARCH_SEEDS, f"the supplement's grid {searched_grid} on {name}")


def experts(body: str, budget: str | Budget, trial: int | None = None) -> list[RunConfig]:
    """Return a body's experts, PPO with the true reward: every trial's configuration, or one's.

    Those of its family's study; of a body that its name describes, of the first that plans them.
    """
    every = (cell for known in STUDIES.values() for cell in known.cells)
    plans = [cell.study for cell in every if (cell.method, cell.body) == ("ppo", body)]
    study = plans[0] if plans and body not in bodies.names() else None
    trials = STUDIES[study].seeds if study else TRIAL_SEEDS
    seeds = trials[: budget_named(budget).n_trials] if trial is None else (trial,)
    return [RunConfig.create(body, "ppo", None, budget, seed, study) for seed in seeds]


def cells(study: str) -> list[Cell]:
    """Return a study's cells, experts first; raises as `study_of`."""
    return list(study_of(study).cells)


def narrowed(
    study: str,
    budget: str | Budget,
    n_trials: int | None = None,
    sample: int | None = None,
    **only: Sequence[str] | None,
) -> Study:
    """Return what is asked for of a study or search; `n_trials` None means as many as it has.

    That is as many as the budget and the study have. Of a search `sample` keeps the first so many
    cells, ``method=[...]`` and ``body=[...]`` those cells alone. Raises SilemError: an unknown
    study or budget, or more trials than there are fixed seeds.
    """
    whole, n = study_of(study), budget_named(budget).n_trials if n_trials is None else n_trials
    if n_trials is not None and not 1 <= n <= len(whole.seeds):
        raise SilemError(f"trials of {study} must be 1 to {len(whole.seeds)}, not {n_trials}")
    kept = whole.cells[:sample]
    for name, wanted in only.items():
        for value in wanted or ():
            choose(name, value, dict.fromkeys(getattr(cell, name) for cell in whole.cells))
        kept = tuple(cell for cell in kept if not wanted or getattr(cell, name) in wanted)
    return dataclasses.replace(whole, cells=kept, seeds=whole.seeds[:n])


def study_configs(study: str, budget: str | Budget, *which: Any, **only: Any) -> list[RunConfig]:
    """Return the runs of a study, `narrowed`: the first trial of every cell before any second."""
    part = narrowed(study, budget, *which, **only)
    return [cell.config(budget, seed) for seed in part.seeds for cell in part.cells]


class Ranked(NamedTuple):
    """One configuration of a search."""

    settings: dict[str, Any]  # what the grid varies
    score: float  # mean over the trials of the return
    returns: tuple[float, ...]  # of the trials
    is_papers: bool  # whether it is the supplement's best combination
    fresh: tuple[float, ...]  # returns of trials on the seeds that the search has not used


def ranking(study: str, budget: str | Budget, *which: int | None) -> list[Ranked]:
    """Rank the configurations of a search of which all trials are finished, the best first.

    The score is the supplement's: the mean over the trials of what the trained policy returns.
    `which` are numbers of trials and cells, as in `narrowed`.
    """
    part, found = narrowed(study, budget, *which), []
    n = len(part.seeds)
    for cell in part.cells:
        ids = [cell.config(budget, seed).run_id for seed in SEARCH_SEEDS]
        used, fresh = (
            tuple(float(r.evaluation["return_mean"]) for run_id in some if (r := runs.find(run_id)))
            for some in (ids[:n], ids[n:])
        )
        if len(used) == n:
            best = cell is part.cells[0]
            found.append(Ranked(dict(cell.overrides), sum(used) / n, used, best, fresh))
    return sorted(found, key=lambda entry: -entry.score)


def fresh_configs(study: str, budget: str | Budget, *which: int | None) -> list[RunConfig]:
    """Return a search's winner, and the supplement's best, on the seeds that it has not used.

    The winner's own trials flatter it, for they have chosen it. `which` is as for `ranking`. Raises
    SilemError: the search is not finished, or has used all seeds.
    """
    part, ranked = narrowed(study, budget, *which), ranking(study, budget, *which)
    tried, n = part.cells, len(part.seeds)
    if len(ranked) < len(tried):
        told = f"{len(ranked)} of {len(tried)} configurations have all their trials"
        raise SilemError(f"the winner of {study} is not known yet: {told}")
    if n == len(SEARCH_SEEDS):
        raise SilemError(f"{study} has no fresh seeds: its {n} trials have used all")
    chosen = [c for c in tried if c is tried[0] or dict(c.overrides) == ranked[0].settings]
    return [cell.config(budget, seed) for seed in SEARCH_SEEDS[n:] for cell in chosen]
