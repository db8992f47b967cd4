"""The command line's larger commands: their options, and what is made of them."""

from __future__ import annotations

import argparse
import ast
from collections.abc import Callable
from pathlib import Path
from typing import Any

from silem.study.config import RunConfig
from silem.study.settings import BUDGETS, METHODS, Budget
from silem.util import files
from silem.util.errors import SilemError, choose

Execute = Callable[[argparse.Namespace], None]


def add_quiet(command: argparse.ArgumentParser) -> None:
    """Add the option that every long command has."""
    command.add_argument("--quiet", action="store_true", help="no progress bar")


def add_budget(command: argparse.ArgumentParser, default: str) -> None:
    """Add the options that name a budget."""
    command.add_argument(
        "--budget", default=default, help=f"{', '.join(BUDGETS)} (default: %(default)s)"
    )
    command.add_argument(
        "--iterations", type=int, metavar="N", help="the budget with N iterations instead"
    )


def add_run(commands: Any, execute: Execute) -> None:
    """Add the command that makes one run."""
    command = commands.add_parser("run", help="make one run, or go on with it")
    command.add_argument("--body", help="the learner's body (see `bodies`)")
    command.add_argument("--method", help=", ".join(METHODS))
    command.add_argument("--demonstrations", metavar="NAME", help="the expert's body, or a clip")
    add_budget(command, "tiny")
    command.add_argument("--seed", type=int, default=0)
    command.add_argument("--study", help="default: the body's family")
    command.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="a hyper-parameter"
    )
    command.add_argument("--config", type=Path, help="a JSON configuration instead of all these")
    command.add_argument("--force", action="store_true", help="start anew, even if finished")
    command.add_argument(
        "--wait", action="store_true", help="wait for another process at work on this run"
    )
    add_quiet(command)
    command.set_defaults(command=execute)


def add_campaign(commands: Any, execute: Execute) -> None:
    """Add the command that makes a study."""
    command = commands.add_parser("campaign", help="make all runs of a study that are missing")
    command.add_argument("--study", default="halfcheetah", help="default: %(default)s")
    add_budget(command, "book")
    command.add_argument("--trials", type=int, help="per cell; default: the budget's number")
    command.add_argument("--workers", type=int, default=2, help="default: %(default)s")
    command.add_argument("--body", nargs="+", help="only these learners' bodies")
    command.add_argument("--method", nargs="+", help="only these methods")
    add_quiet(command)
    command.set_defaults(command=execute)


def add_status(commands: Any, execute: Execute) -> None:
    """Add the command that shows a study."""
    command = commands.add_parser("status", help="what of a study is finished, running, missing")
    command.add_argument("--study", default="halfcheetah", help="default: %(default)s")
    add_budget(command, "book")
    command.set_defaults(command=execute)


def budget_of(options: argparse.Namespace) -> Budget:
    """Return the budget that the options ask for."""
    budget = BUDGETS[choose("budget", options.budget, BUDGETS)]
    return budget.with_iterations(options.iterations) if options.iterations else budget


def config_of(options: argparse.Namespace) -> RunConfig:
    """Return the configuration that the options of ``run`` ask for."""
    if options.config:
        return RunConfig.from_dict(files.read_json(options.config))
    if not (options.body and options.method):
        raise SilemError("run needs --body and --method (or --config)")
    return RunConfig.create(
        options.body,
        options.method,
        options.demonstrations,
        budget_of(options),
        options.seed,
        study=options.study,
        **dict(_setting(text) for text in options.set),
    )


def _setting(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not equals:
        raise SilemError(f"--set takes NAME=VALUE, not {text!r}")
    try:
        return name, ast.literal_eval(value)
    except (ValueError, SyntaxError):
        if value.isidentifier():
            return name, value
        raise SilemError(f"--set {name}: {value!r} is no number, list of numbers or word") from None
