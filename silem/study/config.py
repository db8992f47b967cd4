"""What a run is: a frozen configuration with one strict door, `RunConfig.create`.

A configuration holds exactly the hyper-parameters that its method uses, so that the identity of an
expert's run does not depend on how discriminators are trained.
"""

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from silem import bodies
from silem.bodies import Body
from silem.study import settings
from silem.study.settings import METHODS, Budget, HyperParameters, Setting, budget_named
from silem.util.errors import SilemError, check_name, choose, reason

TRIAL_SEEDS = (0, 1, 2, 3, 4)  #: the trials' root seeds, fixed before any run was made
SEARCH = "search-"  #: how the folder of a search's runs begins
MAX_RUN_ID = 240  #: characters of a run's id, which is a folder's name: file systems take 255


@dataclass(frozen=True)
class RunConfig:
    """One run: everything that its result depends on, and nothing else."""

    study: str
    body: str  # the learner's
    method: str
    demonstrations: str  # the expert's body or a clip of motion; "" where the method needs none
    budget: Budget
    hyper: HyperParameters
    seed: int
    parameters: Mapping[str, float] = dataclasses.field(default_factory=dict)  # of the body

    @classmethod
    def create(
        cls,
        body: str,
        method: str,
        demonstrations: str | None = None,
        budget: str | Budget = "tiny",
        seed: int = 0,
        study: str | None = None,
        **overrides: Any,
    ) -> "RunConfig":
        """Make a checked configuration; the one door to `RunConfig`.

        Args:
            body: The learner's body.
            method: One of `METHODS`.
            demonstrations: The expert's body or a clip of motion; None means the paper's.
            budget: One of `BUDGETS`, or a `Budget` of your own.
            seed: The root seed of every random stream of the run.
            study: The folder the run belongs to; None means the body's family.
            **overrides: Hyper-parameters, and parameters of the body, that replace the
                supplement's best combination for this cell.

        Raises SilemError: anything unknown, out of range, or of no use to the method.
        """
        learner = bodies.get(body)
        choose("method", method, METHODS)
        demonstrations = settings.demonstrations(body, method, demonstrations)
        budget = budget_named(budget, learner.family)
        if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**31:
            raise SilemError(f"seed must be a whole number from 0 to 2**31 - 1, not {seed!r}")
        study = learner.family if study is None else study
        for kind, name in (("study", study), ("body", body), ("demonstrations", demonstrations)):
            if name or kind != "demonstrations":
                check_name(kind, name)
        demonstrations = demonstrations.removesuffix(".npz")
        resolved = settings.resolve(body, method, demonstrations)
        for name in overrides:
            choose(f"hyper-parameter of {method}", name, resolved)
        values = {name: setting.value for name, setting in resolved.items()} | overrides
        parameters = {name: values.pop(name) for name in learner.parameters}
        learner.variant(**parameters)  # which refuses what it does not allow
        hyper = HyperParameters(**values)
        steps, minibatch = budget.steps_per_iteration, hyper.minibatch_size
        if method != "random" and steps % minibatch:
            raise SilemError(f"minibatch_size {minibatch} does not divide {steps} steps")
        return cls(study, body, method, demonstrations, budget, hyper, seed, parameters)

    @property
    def transform(self) -> str | None:
        """The state transformer's kind, or None where the method has none."""
        return METHODS[self.method].transform

    @property
    def learner(self) -> Body:
        """The learner's body, with this run's parameters."""
        return bodies.get(self.body).variant(**self.parameters)

    def settings(self) -> dict[str, Setting]:
        """Return every hyper-parameter in use with where it comes from."""
        resolved = settings.resolve(self.body, self.method, self.demonstrations)
        values = vars(self.hyper) | dict(self.parameters)
        return {
            name: setting if setting.value == values[name] else Setting(values[name], "this run")
            for name, setting in resolved.items()
        }

    def describe(self) -> str:
        """Return every value that makes this run, a line each, with where it comes from."""
        counts = dataclasses.asdict(self.budget)
        budget = f"budget {counts.pop('name')}"
        body, method = bodies.get(self.body).description, METHODS[self.method].about
        rows = [
            ("study", self.study, ""), ("body", self.body, body), ("method", self.method, method),
            ("demonstrations", self.demonstrations or "none", ""), ("seed", self.seed, ""),
            *((name, count, budget) for name, count in counts.items()),
            *((name, *setting) for name, setting in self.settings().items()),
        ]  # fmt: skip
        lines = [f"  {name:24}{value!s:16}{source}".rstrip() for name, value, source in rows]
        return "\n".join([self.run_id, *lines])

    @cached_property
    def run_id(self) -> str:
        """A readable name that ends in a hash of the configuration alone."""
        content = self.to_dict()
        del content["budget"]["n_trials"]  # how many others are run changes nothing in this one
        digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:8]
        source = f"_from_{self.demonstrations}" if self.demonstrations else ""
        return f"{self.method}_{self.body}{source}_{self.budget.name}_s{self.seed}_{digest}"

    @property
    def is_published(self) -> bool:
        """Whether its record goes to the committed results: evidence, and what searches rank."""
        searches = self.study.startswith(SEARCH) and self.budget.base_name == "quick"
        return self.budget.is_evidence or searches

    @property
    def command(self) -> str:
        """The command line that makes this run, or goes on with it."""
        budget, _, iterations = self.budget.name.partition("-")
        options = {
            "import": (bodies.identity(self.body) or {}).get("module", ""),
            "body": self.body, "method": self.method,
            "demonstrations": self.demonstrations, "budget": budget, "iterations": iterations,
            "seed": str(self.seed),
            "study": self.study if self.study != bodies.get(self.body).family else "",
        }  # fmt: skip
        words = ["silem run", *(f"--{option} {said}" for option, said in options.items() if said)]
        for name, (value, source) in self.settings().items():
            if source == "this run":
                text = "".join(f"{size}," for size in value) if isinstance(value, tuple) else value
                words.append(f"--set {name}={text}")
        return " ".join(words)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON types: hyper-parameters in use, identity of one's own body.

        An optional one is in use where it is not at its default, or the cell has another value.
        """
        used, body = HyperParameters.used_by(self.method), bodies.identity(self.body)
        unset = {name: item.default for name, item in used.items() if "optional" in item.metadata}
        hyper = {
            name: list(value) if isinstance(value, tuple) else value
            for name, (value, source) in self.settings().items()
            if source == "this run" or name not in unset or value != unset[name]
        }
        return {
            "study": self.study,
            "body": self.body,
            "method": self.method,
            "demonstrations": self.demonstrations,
            "budget": dataclasses.asdict(self.budget),
            "hyper": hyper,
            "seed": self.seed,
        } | ({"own_body": body} if body else {})

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "RunConfig":
        """Rebuild a configuration from `to_dict`, through the same checks.

        Raises SilemError: As `create`, or the body is another one now.
        """
        keys = [field.name for field in dataclasses.fields(cls) if field.name != "parameters"]
        try:
            for key in content:
                choose("configuration key", key, [*keys, "own_body"])
            body, then = content["body"], content.get("own_body")
            if bodies.identity(str(body)) != then:
                module = then["module"] if then else ""
                advice = f"; --import {module} loads that" if module else ""
                raise SilemError(f"{body} is not the body that this run is of{advice}")
            return cls.create(
                body, content["method"], content["demonstrations"] or None,
                Budget(**content["budget"]), content["seed"], content["study"], **content["hyper"],
            )  # fmt: skip
        except (AttributeError, KeyError, TypeError) as error:
            raise SilemError(f"no valid run configuration: {reason(error)}") from error
