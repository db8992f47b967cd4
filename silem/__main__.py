"""The command line: thin commands over the functions that the notebooks call."""

from __future__ import annotations

import argparse
import ast
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from silem import bodies, files, paths
from silem.config import BUDGETS, DEMONSTRATOR_SEED, METHODS, Budget, RunConfig
from silem.errors import SilemError, choose
from silem.study import campaign, runs, studies
from silem.study.demonstrate import demonstrate
from silem.study.evaluate import evaluate
from silem.study.policies import load_policy
from silem.study.record import RunRecord

_EXAMPLES = """\
examples:
  python -m silem run --body HC0 --method ppo --budget quick
  python -m silem demonstrations --body HC0 --budget quick
  python -m silem run --body HC2 --method silem --demonstrations HC0 --budget quick --seed 7
  python -m silem run --body HC2 --method silem --set gradient_penalty=0 --set window=2
  python -m silem campaign --study halfcheetah --budget book --trials 1 --workers 2
  python -m silem status --budget book
  python -m silem render RUN_ID --out hc2.mp4

A run that was stopped or killed goes on from its checkpoint when its command is given again.
The environment variable SILEM_DATA_DIR moves the data folder.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code: 0, 2 on a bad request, 130 on Ctrl-C."""
    options = parser().parse_args(arguments)
    try:
        options.command(options)
    except SilemError as error:
        print(f"silem: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as interrupt:
        print(f"\nsilem: {interrupt or 'stopped'}", file=sys.stderr)
        return 130
    return 0


def parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    whole = argparse.ArgumentParser(
        prog="python -m silem",
        description="Imitation learning across bodies: runs, campaigns and their records.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = whole.add_subparsers(required=True, metavar="COMMAND")
    _add_run(commands)
    _add_campaign(commands)
    _add_status(commands)

    command = commands.add_parser("evaluate", help="evaluate a finished run's policy anew")
    command.add_argument("run_id", metavar="RUN_ID")
    command.add_argument("--episodes", type=int, default=10, help="default: %(default)s")
    command.set_defaults(command=_evaluate)

    command = commands.add_parser("demonstrations", help="record an expert's demonstrations")
    command.add_argument("--body", help="record its expert's first trial, at --budget")
    command.add_argument("--budget", default="book", help="default: %(default)s")
    command.add_argument("--run", metavar="RUN_ID", help="record this run instead")
    command.add_argument("--trajectories", type=int, default=20, help="default: %(default)s")
    command.add_argument("--force", action="store_true", help="replace another expert's")
    _add_quiet(command)
    command.set_defaults(command=_demonstrations)

    command = commands.add_parser("render", help="film a finished run's policy")
    command.add_argument("run_id", metavar="RUN_ID")
    command.add_argument("--out", type=Path, required=True, help="the .mp4 file to write")
    command.add_argument("--seconds", type=float, default=6.0, help="default: %(default)s")
    command.add_argument("--seed", type=int, default=0)
    command.set_defaults(command=_render)

    command = commands.add_parser("bodies", help="list the bodies")
    command.set_defaults(command=_bodies)
    command = commands.add_parser(
        "mocap", help="make the human's demonstrations, and retarget them, from CMU's clips"
    )
    _add_quiet(command)
    command.set_defaults(command=_mocap)
    return whole


def _add_quiet(command: argparse.ArgumentParser) -> None:
    command.add_argument("--quiet", action="store_true", help="no progress bar")


def _add_budget(command: argparse.ArgumentParser, default: str) -> None:
    command.add_argument(
        "--budget", default=default, help=f"{', '.join(BUDGETS)} (default: %(default)s)"
    )
    command.add_argument(
        "--iterations", type=int, metavar="N", help="the budget with N iterations instead"
    )


def _add_run(commands: Any) -> None:
    command = commands.add_parser("run", help="make one run, or go on with it")
    command.add_argument("--body", help="the learner's body (see `bodies`)")
    command.add_argument("--method", help=", ".join(METHODS))
    command.add_argument("--demonstrations", metavar="BODY", help="the expert's body")
    _add_budget(command, "tiny")
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
    _add_quiet(command)
    command.set_defaults(command=_run)


def _add_campaign(commands: Any) -> None:
    command = commands.add_parser("campaign", help="make all runs of a study that are missing")
    command.add_argument("--study", default="halfcheetah", help="default: %(default)s")
    _add_budget(command, "book")
    command.add_argument("--trials", type=int, help="per cell; default: the budget's number")
    command.add_argument("--workers", type=int, default=2, help="default: %(default)s")
    command.add_argument("--body", nargs="+", help="only these learners' bodies")
    command.add_argument("--method", nargs="+", help="only these methods")
    _add_quiet(command)
    command.set_defaults(command=_campaign)


def _add_status(commands: Any) -> None:
    command = commands.add_parser("status", help="what of a study is finished, running, missing")
    command.add_argument("--study", default="halfcheetah", help="default: %(default)s")
    _add_budget(command, "book")
    command.set_defaults(command=_status)


def _budget(options: argparse.Namespace) -> Budget:
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
        _budget(options),
        options.seed,
        study=options.study,
        **dict(_setting(text) for text in options.set),
    )


def _run(options: argparse.Namespace) -> None:
    record = runs.run(config_of(options), not options.quiet, options.force, options.wait)
    _print_evaluation(record.run_id, record.evaluation)


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


def _print_evaluation(run_id: str, result: dict[str, Any]) -> None:
    scored = result["disc_reward_mean"]
    print(
        f"{run_id}: return {result['return_mean']:.0f} +- {result['return_std']:.0f} over"
        f" {result['n_episodes']} episodes, {result['speed_m_s']:.2f} m/s,"
        f" upright {result['upright']:.0%}"
        + ("" if scored is None else f", discriminator reward {scored:.0f}")
    )


def _campaign(options: argparse.Namespace) -> None:
    configs = studies.study_configs(
        options.study, _budget(options), options.trials, body=options.body, method=options.method
    )
    records = campaign.campaign(configs, options.workers, progress=not options.quiet)
    for record in records:
        _print_evaluation(record.run_id, record.evaluation)


def _status(options: argparse.Namespace) -> None:
    print(studies.status_table(options.study, _budget(options)))


def _finished(run_id: str) -> RunRecord:
    record = runs.find(run_id)
    if record is None:
        raise SilemError(f"there is no finished run {run_id!r} in {paths.data_dir()}")
    return record


def _evaluate(options: argparse.Namespace) -> None:
    record = _finished(options.run_id)
    learner = record.run_config().learner
    result = evaluate(load_policy(record), learner, options.episodes, progress=True)
    _print_evaluation(record.run_id, result.to_dict())


def _demonstrations(options: argparse.Namespace) -> None:
    if bool(options.run) == bool(options.body):
        raise SilemError("demonstrations needs either --body or --run")
    run_id = options.run
    if options.body:
        budget = BUDGETS[choose("budget", options.budget, BUDGETS)]
        expert = RunConfig.create(options.body, "ppo", None, budget, DEMONSTRATOR_SEED)
        run_id = expert.run_id
    path = demonstrate(
        _finished(run_id), options.trajectories, force=options.force, progress=not options.quiet
    )
    print(f"{path}: {options.trajectories} trajectories of {run_id}")


def _render(options: argparse.Namespace) -> None:
    from silem.report import rendering, video  # no other command needs drawing libraries

    record = _finished(options.run_id)
    policy = load_policy(record)
    learner = record.run_config().learner
    clip = rendering.rollout(learner, policy, duration_s=options.seconds, seed=options.seed)
    video.write(options.out, clip)
    print(options.out)


def _mocap(options: argparse.Namespace) -> None:
    from silem.skeleton.clips import publish_clips
    from silem.skeleton.retarget_report import publish_retargeted

    progress = not options.quiet
    for path in (*publish_clips(progress=progress), *publish_retargeted(progress=progress)):
        print(path)


def _bodies(options: argparse.Namespace) -> None:
    for name in bodies.names():
        print(f"{name:9} {bodies.get(name).description}")


if __name__ == "__main__":
    sys.exit(main())
