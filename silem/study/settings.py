"""What a run is made of: methods, hyper-parameters and budgets, and where each value comes from.

The paper's tables come first (`silem.paper`), then what it leaves open: per family of bodies in
`FAMILIES`, for all in the defaults of `HyperParameters`. `resolve` puts them together for one cell;
runs, `silem.settings`, ``silem show`` and the book's tables all read that.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple

from silem import bodies, paper
from silem.motion.demonstrations import expert_of, file_of, retargeted
from silem.util.errors import COUNT, FACTOR, NUMBER, RATE, WEIGHT, SilemError, check_name, choose

HUMAN = "cmu_08_01"
"""The demonstration of every humanoid: subject 8's first clip of the CMU motion capture library."""


class Setting(NamedTuple):
    """One value and where it comes from."""

    value: Any
    source: str


@dataclass(frozen=True)
class Method:
    """One way to make a policy."""

    about: str
    algorithm: str = ""  # of `silem.algorithms`
    transform: str | None = None
    source: str = ""  # learns from the "original" body's expert or human, its "own", "retargeted"
    chosen: Mapping[str, Setting] = field(default_factory=dict)  # by the search, for it alone


_FOUND = "open: the search on HC1 and HC2"
_NO_BONUS = {"disc_entropy_coef": Setting(0.0, _FOUND)}

METHODS = {
    "ppo": Method("an expert: PPO with the true reward", "PPO"),
    "random": Method("the untrained Gaussian policy, whose raw actions the task charges"),
    "silem": Method("SILEM", "SILEM", "affine", "original"),
    "silem-minus": Method("SILEM without the transform", "GAIfO", None, "original", _NO_BONUS),
    "silem-minus-own": Method(
        "SILEM-minus from the own body's expert", "GAIfO", None, "own", _NO_BONUS
    ),
    "silem-mlp": Method("SILEM with an MLP as transform (Table 1)", "SILEM", "mlp", "original"),
    "tpil": Method("third-person imitation learning", "TPIL", None, "original"),
    "peng20": Method("SILEM-minus from retargeted demonstrations", "GAIfO", None, "retargeted"),
}
"""Every method by name."""

IMITATORS = tuple(name for name, method in METHODS.items() if method.source)
_LEARNERS = tuple(name for name, method in METHODS.items() if method.algorithm)
_TRANSFORMED = tuple(name for name, method in METHODS.items() if method.transform)


def _used_by(methods: tuple[str, ...], default: Any, source: str = "", **rules: Any) -> Any:
    """Declare who uses a hyper-parameter, its default and where that is from ("": open).

    Rules: ``choices``; ``kind`` of number, where it is neither a count nor a rate; ``optional``, at
    its default it is no part of a run's identity.
    """
    return field(default=default, metadata={"methods": methods, "source": source, **rules})


_PPO = paper.common("halfcheetah")  # the supplement's common settings for the PyBullet bodies
_BEST, _ = paper.best_combination("HC0", "silem", "HC0")
_COMMON, _TEXT = "supplement, common settings for PPO", "supplement, text"
_ROW, _MEREL = "supplement, SILEM's best combination for HC0", "merel-mocap-gail"


@dataclass(frozen=True)
class HyperParameters:
    """Every hyper-parameter of learning; a method uses some of them (see `used_by`).

    Raises SilemError: a value of another type, or out of range.
    """

    # The learning rate falls linearly to 0.
    learning_rate: float = _used_by(_LEARNERS, _PPO["learning_rate"], _COMMON)
    clip_range: float = _used_by(_LEARNERS, _PPO["clip_range"], _COMMON)
    gamma: float = _used_by(_LEARNERS, _PPO["gamma"], _COMMON, kind=FACTOR)
    gae_lambda: float = _used_by(_LEARNERS, _PPO["gae_lambda"], _COMMON, kind=FACTOR)
    n_epochs: int = _used_by(_LEARNERS, _PPO["n_epochs"], _COMMON)  # N_P
    minibatch_size: int = _used_by(_LEARNERS, _PPO["minibatch_size"], _COMMON)  # N_Pmb
    adam_eps: float = _used_by(_LEARNERS, 1e-5, "OpenAI baselines, as the supplement says")
    policy_hidden: tuple[int, ...] = _used_by(
        _LEARNERS, tuple(paper.number("policy_hidden")), _TEXT
    )
    # logarithm of the policy's standard deviation at the start
    log_std_init: float = _used_by(_LEARNERS, 0.0, optional=True, kind=NUMBER)
    # how the rollout treats PPO's own choices, see "Deviations"
    anneal_clip: bool = _used_by(_LEARNERS, False, optional=True)
    clip_actions: bool = _used_by(_LEARNERS, True, optional=True)
    disc_hidden: tuple[int, ...] = _used_by(IMITATORS, tuple(paper.number("disc_hidden")), _TEXT)
    window: int = _used_by(IMITATORS, paper.number("window"), _TEXT)  # states per window
    n_trajectories: int = _used_by(IMITATORS, _BEST["n_trajectories"], _ROW)  # n
    n_disc_updates: int = _used_by(IMITATORS, _BEST["n_disc_updates"], _ROW)  # N_D
    n_transform_updates: int = _used_by(_TRANSFORMED, _BEST["n_transform_updates"], _ROW)  # N_G
    transform_lr_decay: float = _used_by(  # d
        _TRANSFORMED, _BEST["transform_lr_decay"], _ROW, kind=FACTOR
    )
    disc_learning_rate: float = _used_by(IMITATORS, 1e-3, kind=WEIGHT)
    transform_learning_rate: float = _used_by(_TRANSFORMED, 1e-5, _FOUND, kind=WEIGHT)
    disc_entropy_coef: float = _used_by(IMITATORS, 1e-3, _MEREL, kind=WEIGHT)
    gradient_penalty: float = _used_by(IMITATORS, 0.1, _FOUND, kind=WEIGHT)  # 0 switches it off
    transform_components: int = _used_by(("silem",), 1, optional=True)  # K, of an ensemble if > 1
    # Of the humanoids alone; 0 where they do not apply.
    transform_l2_scale: float = _used_by(("silem",), 0.0, optional=True, kind=WEIGHT)  # w_d
    transform_l2_bias: float = _used_by(("silem",), 0.0, optional=True, kind=WEIGHT)  # w_b
    transform_l2_form: str = _used_by(
        ("silem",), "deviation", optional=True, choices=("deviation", "plain")
    )
    gradient_reversal_coef: float = _used_by(("tpil",), 1.0, kind=WEIGHT)  # C_g
    encoder_layers: int = _used_by(("tpil",), 1, optional=True)
    # What episodes of a humanoid start from: the standing pose with small noise, or states of the
    # demonstration retargeted to the learner's body, which the paper argues against needing.
    starts: str = _used_by(
        _LEARNERS, "standing", optional=True, choices=("standing", "demonstration")
    )
    # whether D also judges what follows an episode that ended by itself
    absorbing_states: bool = _used_by(IMITATORS, False, optional=True)
    # Of the random policy: standard deviation of its raw actions, as an untrained policy's is.
    action_std: float = _used_by(("random",), 1.0)

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            object.__setattr__(self, item.name, _checked(item, getattr(self, item.name)))

    @classmethod
    @cache
    def used_by(cls, method: str) -> dict[str, dataclasses.Field[Any]]:
        """Return the fields that a method uses, by name, in the class's order."""
        fields = dataclasses.fields(cls)
        return {item.name: item for item in fields if method in item.metadata["methods"]}


def _checked(item: dataclasses.Field[Any], value: Any) -> Any:
    """Return a hyper-parameter's value in its field's type, or raise SilemError."""
    name, rule = item.name, item.metadata
    default: Any = item.default
    if choices := rule.get("choices"):
        return choose(name, value, choices)
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise SilemError(f"{name} must be True or False, not {value!r}")
        return value
    sizes = isinstance(default, tuple)
    if sizes and not (isinstance(value, list | tuple) and value):
        raise SilemError(f"{name} must be a list of layer sizes, not {value!r}")
    kind = rule.get("kind", RATE if isinstance(default, float) else COUNT)
    for number in value if sizes else (value,):
        kind.check(f"each size in {name}" if sizes else name, number)
    return type(default)(value)


@dataclass(frozen=True)
class Budget:
    """How much a run may spend. Changes counts, nothing else."""

    name: str
    n_envs: int
    steps_per_iteration: int  # all environments together
    n_iterations: int
    n_trials: int
    n_eval_episodes: int
    checkpoint_every: int  # iterations; episodes start anew at every checkpoint

    def __post_init__(self) -> None:
        check_name("budget", self.name)
        for name, count in vars(self).items():
            if name != "name":
                COUNT.check(f"budget {name}", count)
        if self.steps_per_iteration % self.n_envs:
            told = f"budget {self.name!r}: {self.steps_per_iteration} steps per iteration"
            raise SilemError(f"{told} do not divide among {self.n_envs} environments")

    @property
    def n_steps(self) -> int:
        """Environment steps of the whole training."""
        return self.n_iterations * self.steps_per_iteration

    @property
    def is_evidence(self) -> bool:
        """Whether finished runs are published to the committed results."""
        return self.base_name in ("book", "paper")

    @property
    def base_name(self) -> str:
        """Name of the budget that this one is, or that it has other iterations than."""
        return self.name.partition("-")[0]

    def with_iterations(self, n_iterations: int) -> "Budget":
        """Return this budget with another number of iterations, and a name that says so."""
        return dataclasses.replace(
            self, name=f"{self.name}-{n_iterations}", n_iterations=n_iterations
        )


_STEPS, _TRIALS = _PPO["steps_per_iteration"], paper.number("n_trials")
_PAPER_EPISODES = paper.number("n_eval_episodes")
BUDGETS = {
    budget.name: budget
    for budget in (
        # seconds: tests, and the notebooks' defaults
        Budget("tiny", 2, 256, 4, 1, 2, 2),
        # minutes: to see it learn
        Budget("quick", 8, _STEPS, 60, 1, 10, 20),
        # the committed evidence: at 800 iterations the last experts of HC1 have settled
        Budget("book", 8, _STEPS, 800, _TRIALS, 100, 25),
        Budget("paper", 8, _STEPS, _PPO["n_iterations"], _TRIALS, _PAPER_EPISODES, 25),
    )
}


@dataclass(frozen=True)
class FamilySettings:
    """What the study takes for a family of bodies."""

    original: str  # whose demonstrations its bodies learn from: a body's expert's or a clip
    stand_in: str  # whose best combinations a body takes that the paper does not know
    # what the paper leaves open and the family needs, or prints for it alone
    chosen: Mapping[str, Setting] = field(default_factory=dict)
    budgets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # what counts otherwise


_MUJOCO = paper.common("humanoid")
_GRID, _FEW = paper.grid_values("tab4_h"), "T makes one or two steps an iteration here"
_SHAKES = "torques that shake with deviation 1 throw a humanoid over"
_SMOOTH = "with 1, D is so smooth that standing earns a third of the reward"
_BATCH = {"n_envs": 16, "steps_per_iteration": _MUJOCO["steps_per_iteration"]}
# At 600 iterations Ant0's expert still rose; the paper trains the Ants' experts for 1000.
_ANTS = {"n_iterations": paper.number("ant_expert_iterations")}
FAMILIES = {
    "halfcheetah": FamilySettings("HC0", "HC0"),
    "ant": FamilySettings("Ant0", "HC0", budgets={"book": _ANTS}),
    "humanoid": FamilySettings(
        HUMAN,
        "Humanoid",
        {
            "policy_hidden": Setting(tuple(paper.number("humanoid_policy_hidden")), _TEXT),
            "disc_hidden": Setting(tuple(paper.number("humanoid_disc_hidden")), _TEXT),
            "n_trajectories": Setting(1, "one clip"),
            "log_std_init": Setting(-1.6, f"open: {_SHAKES}"),
            "gradient_penalty": Setting(0.1, f"open: {_SMOOTH}"),
            "disc_entropy_coef": Setting(1e-3, _MEREL),
            "transform_learning_rate": Setting(1e-3, f"open: {_FEW}"),
            "n_transform_updates": Setting(_GRID["N_G"][0], "supplement, the grid's one value"),
            "transform_lr_decay": Setting(1.0, "supplement: Atlas's grid has no decay"),
        },
        {
            "quick": _BATCH,
            "book": _BATCH | {"n_iterations": 2000},
            "paper": _BATCH | {"n_iterations": _MUJOCO["n_iterations"]},
        },
    ),
}
"""By family of bodies; others take HalfCheetah's."""


def budget_named(budget: str | Budget, family: str = "") -> Budget:
    """Return one of `BUDGETS` by its name, with the counts it has on a family of bodies.

    One of them that is given itself, or with other iterations, gets them too; others stay as given.
    """
    found = BUDGETS[choose("budget", budget, BUDGETS)] if isinstance(budget, str) else budget
    return namesake(found, family) if found == namesake(found) else found


def namesake(budget: Budget, family: str = "") -> Budget:
    """Return the one of `BUDGETS`, for a family, whose name a budget bears; itself if none's.

    Its iterations are the budget's, where the name says that they are others.
    """
    if (base := BUDGETS.get(budget.base_name)) is None:
        return budget
    base = dataclasses.replace(base, **_family(family).budgets.get(base.name, {}))
    return base if base.name == budget.name else base.with_iterations(budget.n_iterations)


def _family(name: str) -> FamilySettings:
    return FAMILIES.get(name, FAMILIES["halfcheetah"])


def demonstrations(body: str, method: str, wanted: str | None) -> str:
    """Return the name of a cell's demonstrations: those wanted, or the paper's.

    That is the family's original body's or the human's clip, the learner's own for
    ``silem-minus-own``, the clip retargeted to the learner for ``peng20``. Raises SilemError if
    the method does not learn from those wanted.
    """
    source, family = METHODS[method].source, bodies.get(body).family
    original = _family(family).original
    if not source and wanted:
        raise SilemError(f"method {method!r} uses no demonstrations")
    if source == "own" and wanted not in (None, body):
        raise SilemError(f"{method} of {body} imitates {body}, not {wanted}")
    if source in ("", "own"):
        return body if source else ""
    if source == "retargeted":
        if wanted is None and original in bodies.names():
            raise SilemError(f"method {method!r} is not for {body}: no clip is retargeted to it")
        chosen = wanted or retargeted(original, body)
        if chosen != retargeted(chosen, body):
            raise SilemError(f"{method} imitates a clip retargeted to {body}, not {chosen!r}")
        return chosen
    if wanted and original in bodies.names() and not file_of(wanted).exists():
        # to be recorded: a body's demonstrator, or one trial's expert ("HC0_s3")
        expert = expert_of(wanted)[0]
        if not bodies.exists(expert):
            choose("demonstrations", expert, bodies.names())
    if not wanted and family not in FAMILIES:
        raise SilemError(f"{method} on {body} needs demonstrations: a name (see `silem run -h`)")
    return wanted or original


def resolve(body: str, method: str, source: str = "") -> dict[str, Setting]:
    """Return every hyper-parameter of a method on a body, and the body's, each with its source.

    The later overrules the earlier: the defaults, what is chosen for the method, what is chosen for
    the family, the paper's common table of the family, the paper's best combination of the cell.
    `source` names demonstrations.
    """
    moved = bodies.get(body)
    family = moved.family
    found = {
        name: Setting(item.default, item.metadata["source"] or "open: this project's default")
        for name, item in HyperParameters.used_by(method).items()
    }
    found |= {name: Setting(value, "the body's own") for name, value in moved.parameters.items()}
    better = {**METHODS[method].chosen, **_family(family).chosen}
    if family in FAMILIES:
        better |= {name: Setting(value, _COMMON) for name, value in _common(family).items()}
    # Experts too take SILEM's combination, as far as they use it, where a clip demonstrates: of
    # the humanoids' PPO the common table leaves the epochs out.
    clip = _family(family).original not in bodies.names()
    if METHODS[method].source or (method == "ppo" and clip):
        better |= _best(body, method, source, _family(family).stand_in)
    return found | {name: setting for name, setting in better.items() if name in found}


_common = cache(paper.common)


@cache
def _best(body: str, method: str, source: str, stand_in: str) -> dict[str, Setting]:
    """Return the supplement's best combination of a cell, else SILEM's, else the stand-in's."""
    for wanted, known in ((m, b) for m in (method, "silem") for b in (body, stand_in)):
        values, table = paper.best_combination(known, wanted, source if known == body else "")
        if table:
            label = f"supplement, {table.label}, {known}"
            return {name: Setting(value, label) for name, value in values.items()}
    return {}
