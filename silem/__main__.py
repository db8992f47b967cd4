"""The command line: thin commands over the functions that the notebooks call."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from silem import bodies
from silem.arguments import add_campaign, add_quiet, add_run, add_status, budget_of, config_of
from silem.study import campaign, runs, studies, verify
from silem.study.config import RunConfig
from silem.study.demonstrate import demonstrate, demonstrator, describe, trial_name
from silem.study.evaluate import evaluate
from silem.study.policies import load_policy
from silem.study.record import RunRecord
from silem.study.training import task_options
from silem.util import paths
from silem.util.errors import SilemError

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
    add_run(commands, _run)
    add_campaign(commands, _campaign)
    add_status(commands, _status)

    command = commands.add_parser("evaluate", help="evaluate a finished run's policy anew")
    command.add_argument("run_id", metavar="RUN_ID")
    command.add_argument("--episodes", type=int, default=10, help="default: %(default)s")
    command.set_defaults(command=_evaluate)

    command = commands.add_parser("demonstrations", help="record an expert's demonstrations")
    command.add_argument("--body", help="record its best expert, at --budget")
    command.add_argument("--budget", default="book", help="default: %(default)s")
    command.add_argument("--trial", type=int, help="that trial's expert instead of the best")
    command.add_argument("--run", metavar="RUN_ID", help="record this run instead")
    command.add_argument("--trajectories", type=int, default=20, help="default: %(default)s")
    command.add_argument("--force", action="store_true", help="replace another expert's")
    add_quiet(command)
    command.set_defaults(command=_demonstrations)

    command = commands.add_parser("render", help="film a finished run's policy")
    command.add_argument("run_id", metavar="RUN_ID")
    command.add_argument("--out", type=Path, required=True, help="the .mp4 or .webp file to write")
    command.add_argument("--seconds", type=float, default=6.0, help="default: %(default)s")
    command.add_argument("--seed", type=int, default=0)
    command.set_defaults(command=_render)

    command = commands.add_parser("verify", help="check records, and evaluate policies anew")
    command.add_argument("name", metavar="RUN_ID|STUDY", nargs="?", help="default: all published")
    command.add_argument(
        "--episodes",
        type=int,
        default=verify.N_EPISODES,
        help="of each policy (default: %(default)s)",
    )
    command.set_defaults(command=_verify)

    command = commands.add_parser("bodies", help="list the bodies")
    command.set_defaults(command=_bodies)
    command = commands.add_parser(
        "mocap",
        help="make the human's demonstrations, and retarget them, from CMU's or your clips",
    )
    command.add_argument("--asf", type=Path, help="the skeleton of a clip of your own")
    command.add_argument("--amc", type=Path, help="the clip")
    command.add_argument("--rate-hz", type=float, help="its frames per second, at CMU mostly 120")
    command.add_argument("--name", help="what --demonstrations will find it by")
    command.add_argument("--floor-slope", type=float, default=0.0, help="rise in m per m forward")
    add_quiet(command)
    command.set_defaults(command=_mocap)
    return whole


def _run(options: argparse.Namespace) -> None:
    record = runs.run(config_of(options), not options.quiet, options.force, options.wait)
    _print_evaluation(record.run_id, record.evaluation)


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
        options.study, budget_of(options), options.trials, body=options.body, method=options.method
    )
    records = campaign.campaign(configs, options.workers, progress=not options.quiet)
    for record in records:
        _print_evaluation(record.run_id, record.evaluation)


def _status(options: argparse.Namespace) -> None:
    print(studies.status_table(options.study, budget_of(options)))


def _finished(run_id: str) -> RunRecord:
    record = runs.find(run_id)
    if record is None:
        raise SilemError(f"there is no finished run {run_id!r} in {paths.data_dir()}")
    return record


def _evaluate(options: argparse.Namespace) -> None:
    record = _finished(options.run_id)
    config = record.run_config()
    task = task_options(config)
    result = evaluate(load_policy(record), config.learner, options.episodes, progress=True, **task)
    _print_evaluation(record.run_id, result.to_dict())


def _verify(options: argparse.Namespace) -> None:
    verdicts = []
    for verdict in verify.verify_all(options.name, options.episodes):
        print(verdict, flush=True)
        verdicts.append(verdict)
    refuted = [verdict.name for verdict in verdicts if verdict.outcome == verify.NOT]
    if refuted:
        raise SilemError(f"{len(refuted)} of {len(verdicts)} are not what they say")


def _demonstrations(options: argparse.Namespace) -> None:
    if bool(options.run) == bool(options.body):
        raise SilemError("demonstrations needs either --body or --run")
    name = None
    if options.run:
        record = _finished(options.run)
    elif options.trial is None:
        record = demonstrator(options.body, options.budget)
    else:
        expert = RunConfig.create(options.body, "ppo", None, options.budget, options.trial)
        record = _finished(expert.run_id)
        name = trial_name(record)
    path = demonstrate(
        record, options.trajectories, name=name, force=options.force, progress=not options.quiet
    )
    print(f"{path}: {describe(path.stem)}")


def _render(options: argparse.Namespace) -> None:
    from silem.report import film  # no other command needs drawing libraries

    record = _finished(options.run_id)
    policy = load_policy(record)
    learner = record.run_config().learner
    clip = film.rollout(learner, policy, duration_s=options.seconds, seed=options.seed)
    film.write(options.out, clip)
    print(options.out)


def _mocap(options: argparse.Namespace) -> None:
    from silem.motion import demonstrator, retargeting

    progress = not options.quiet
    own = (options.name, options.asf, options.amc, options.rate_hz)
    if own == (None,) * 4:
        written, clip = demonstrator.publish_clips(progress=progress), "08_01"
    elif None in own:
        raise SilemError("mocap needs --asf, --amc, --rate-hz and --name for a clip of your own")
    else:
        written, clip = [demonstrator.publish_own(*own, floor_slope=options.floor_slope)], own[0]
    for path in (*written, *retargeting.publish_retargeted(clip, progress=progress)):
        print(path)


def _bodies(options: argparse.Namespace) -> None:
    for name in bodies.names():
        print(f"{name:9} {bodies.get(name).description}")


if __name__ == "__main__":
    sys.exit(main())
