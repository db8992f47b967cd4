"""What a run is: a frozen configuration with one strict door, `RunConfig.create`.

A configuration holds exactly the hyper-parameters that its method uses, so that the identity of an
expert's run does not depend on how discriminators are trained.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from silem import bodies
from silem.bodies import Body, own
from silem.study import settings
from silem.study.settings import BUDGETS, METHODS, Budget, HyperParameters, Setting, of_family
from silem.util.errors import SilemError, check_name, choose, reason

TRIAL_SEEDS = (0, 1, 2, 3, 4)
"""The trials' root seeds, fixed before any run was made."""

MAX_RUN_ID = 240
"""Characters of a run's id, which is a folder's name: file systems take 255."""


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
    ) -> RunConfig:
        """Make a checked configuration; the one door to `RunConfig`.

        Args:
            body: The learner's body.
            method: One of `METHODS`.
            demonstrations: The expert's body or a clip of motion. None means the family's
                original body (humanoids: the human's clip), or the learner's own for
                ``silem-minus-own``, or the clip retargeted to the learner for ``peng20``.
            budget: One of `BUDGETS`, or a `Budget` of your own.
            seed: The root seed of every random stream of the run.
            study: The folder the run belongs to; None means the body's family.
            **overrides: Hyper-parameters, and parameters of the body, that replace the
                supplement's best combination for this cell.

        Raises:
            SilemError: Anything unknown, of the wrong type, out of range, or of no use to the
                method.
        """
        bodies.get(body)  # which refuses what there is not
        choose("method", method, METHODS)
        family = bodies.get(body).family
        demonstrations = settings.demonstrations(body, method, demonstrations)
        if isinstance(budget, str):
            budget = BUDGETS[choose("budget", budget, BUDGETS)]
        budget = of_family(budget, family)
        if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**31:
            raise SilemError(f"seed must be a whole number from 0 to 2**31 - 1, not {seed!r}")
        study = family if study is None else study
        for kind, name in (("study", study), ("body", body), ("demonstrations", demonstrations)):
            if name or kind != "demonstrations":
                check_name(kind, name)
        allowed = [*HyperParameters.names_used_by(method), *bodies.get(body).parameters]
        for name in overrides:
            choose(f"hyper-parameter of {method}", name, allowed)
        resolved = settings.resolve(body, method, demonstrations)
        values = {name: setting.value for name, setting in resolved.items()}
        values |= overrides
        parameters = {name: values.pop(name) for name in bodies.get(body).parameters}
        bodies.get(body).variant(**parameters)  # which refuses what it does not allow
        hyper = HyperParameters(**values)
        steps, minibatch = budget.steps_per_iteration, hyper.minibatch_size
        if method != "random" and steps % minibatch:
            raise SilemError(f"minibatch_size {minibatch} does not divide {steps} steps")
        return cls(study, body, method, demonstrations, budget, hyper, seed, parameters)

    @property
    def transform(self) -> str | None:
        """The state transformer's kind, or None where the method has none."""
        return METHODS[self.method].transform

    def settings(self) -> dict[str, Setting]:
        """Return every hyper-parameter in use with where it comes from."""
        resolved = settings.resolve(self.body, self.method, self.demonstrations)
        values = dataclasses.asdict(self.hyper) | dict(self.parameters)
        return {
            name: setting if setting.value == values[name] else Setting(values[name], "this run")
            for name, setting in resolved.items()
        }

    def describe(self) -> str:
        """Return every value that makes this run, a line each, with where it comes from."""
        budget = dataclasses.asdict(self.budget)
        rows = [
            ("study", self.study, ""),
            ("body", self.body, bodies.get(self.body).description),
            ("method", self.method, METHODS[self.method].about),
            ("demonstrations", self.demonstrations or "none", ""),
            ("seed", self.seed, ""),
            *(
                (name, n, f"budget {budget['name']}")
                for name, n in budget.items()
                if name != "name"
            ),
            *((name, *setting) for name, setting in self.settings().items()),
        ]
        lines = [f"  {name:24}{value!s:16}{source}".rstrip() for name, value, source in rows]
        return "\n".join([self.run_id, *lines])

    @property
    def learner(self) -> Body:
        """The learner's body, with this run's parameters."""
        return bodies.get(self.body).variant(**self.parameters)

    @property
    def run_id(self) -> str:
        """A readable name that ends in a hash of the configuration alone."""
        content = self.to_dict()
        del content["budget"]["n_trials"]  # how many others are run changes nothing in this one
        text = json.dumps(content, sort_keys=True)
        source = f"_from_{self.demonstrations}" if self.demonstrations else ""
        digest = hashlib.sha256(text.encode()).hexdigest()[:8]
        return f"{self.method}_{self.body}{source}_{self.budget.name}_s{self.seed}_{digest}"

    @property
    def command(self) -> str:
        """The command line that makes this run, or goes on with it."""
        words = ["python -m silem run"]
        if module := own.module_of(self.body):
            words.append(f"--import {module}")
        words += [f"--body {self.body}", f"--method {self.method}"]
        if self.demonstrations:
            words.append(f"--demonstrations {self.demonstrations}")
        name, _, iterations = self.budget.name.partition("-")
        words.append(f"--budget {name}" + (f" --iterations {iterations}" if iterations else ""))
        words.append(f"--seed {self.seed}")
        if self.study != bodies.get(self.body).family:
            words.append(f"--study {self.study}")
        default = RunConfig.create(self.body, self.method, self.demonstrations or None)
        for name, (value, _) in self.settings().items():
            if value != default.settings()[name].value:
                text = "".join(f"{size}," for size in value) if isinstance(value, tuple) else value
                words.append(f"--set {name}={text}")
        return " ".join(words)

    def to_dict(self) -> dict[str, Any]:
        """Return the configuration as plain JSON types, with the used hyper-parameters only."""
        hyper = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in self.hyper.of_method(self.method).items()
        } | dict(self.parameters)
        return {
            "study": self.study,
            "body": self.body,
            "method": self.method,
            "demonstrations": self.demonstrations,
            "budget": dataclasses.asdict(self.budget),
            "hyper": hyper,
            "seed": self.seed,
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> RunConfig:
        """Rebuild a configuration from `to_dict`, through the same checks.

        Raises:
            SilemError: A key is missing or unknown, or a value is not allowed.
        """
        keys = [field.name for field in dataclasses.fields(cls) if field.name != "parameters"]
        try:
            for key in content:
                choose("configuration key", key, keys)
            budget = Budget(**content["budget"])
            return cls.create(
                content["body"],
                content["method"],
                content["demonstrations"] or None,
                budget,
                content["seed"],
                content["study"],
                **content["hyper"],
            )
        except (AttributeError, KeyError, TypeError) as error:
            raise SilemError(f"no valid run configuration: {reason(error)}") from error
