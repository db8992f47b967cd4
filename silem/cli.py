"""The command line ``silem``: thin commands over the functions that the notebooks call.

What a command needs beyond names and settings (PyTorch, the simulators, drawing) it loads itself,
so that ``silem status`` and ``silem --help`` answer at once.
"""

from __future__ import annotations

import argparse
import ast
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

import silem
from silem import bodies
from silem.bodies import own
from silem.study import runs, studies, verify
from silem.study.config import RunConfig
from silem.study.interrupt import sigterm_as_interrupt
from silem.study.record import RECORD, RunRecord
from silem.study.settings import BUDGETS, LARGEST, METHODS, Budget, HyperParameters
from silem.util import files, paths
from silem.util.errors import SilemError, choose, clipped

OK, FAILED, BAD_REQUEST, INTERRUPTED, CLOSED_PIPE = 0, 1, 2, 130, 141
"""Exit codes; the last two are a shell's for SIGINT and SIGPIPE."""

FILM_ENDINGS = (".mp4", ".webp")
LONGEST_FILM_S = 60.0  # all frames are in memory, at 28 MB a second

_EXAMPLES = """\
examples:
  silem run --body HC0 --method ppo --budget quick
  silem demonstrations --body HC0 --budget quick
  silem run --body HC2 --method silem --demonstrations HC0 --budget quick --seed 7
  silem run --body HC2 --method silem --set gradient_penalty=0 --set window=2
  silem campaign --study halfcheetah --budget book --trials 1 --workers 2
  silem status --budget book
  silem render RUN_ID --out hc2.mp4

A run that was stopped or killed goes on from its checkpoint when its command is given again.
The environment variable SILEM_DATA_DIR moves the data folder.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: What follows ``silem``; None means those of the process.

    Returns:
        The exit code: 0, 1 where the system refused, 2 on a bad request, 130 on Ctrl-C or SIGTERM,
        141 where nobody reads the output any more.
    """
    try:
        with sigterm_as_interrupt():
            try:
                options = parser().parse_args(arguments)
                for module in options.modules:
                    own.load(module)
                options.command(options)
            finally:
                sys.stdout.flush()  # while a closed pipe can still be answered for
    except SilemError as error:
        return _end(BAD_REQUEST, str(error))
    except KeyboardInterrupt as interrupt:
        return _end(INTERRUPTED, str(interrupt) or "stopped")
    except BrokenPipeError:
        _close_output()
        return CLOSED_PIPE
    except OSError as error:
        _close_output()
        named = f"{error.filename}: " if error.filename else ""
        return _end(FAILED, f"{named}{error.strerror or error}")
    return OK


def _end(code: int, message: str) -> int:
    """Say in one line how the command ended."""
    if code == INTERRUPTED and sys.stderr.isatty():
        print(file=sys.stderr)  # the line of the progress bar and ^C ends here
    print(f"silem: {' '.join(message.split())}", file=sys.stderr)
    return code


def _close_output() -> None:
    # Python flushes once more when it exits, and would complain then.
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise SilemError(f"{message} (see `{self.prog} --help`)")


def parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    whole = _Parser(
        prog="silem",
        description="Imitation learning across bodies: runs, campaigns and their records.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    whole.add_argument("--version", action="version", version=f"silem {silem.__version__}")
    commands = whole.add_subparsers(required=True, metavar="COMMAND")

    def add(
        name: str, execute: Callable[[argparse.Namespace], None], text: str, *, long: bool
    ) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=text, description=text)
        command.add_argument(
            "--import", dest="modules", action="append", default=[], metavar="MODULE",
            help="load a Python module that registers bodies of your own",
        )  # fmt: skip
        if long:
            command.add_argument("--quiet", action="store_true", help="no progress bar")
        command.set_defaults(command=execute)
        return command

    def add_budget(command: argparse.ArgumentParser, default: str | None) -> None:
        shown = default or "tiny"
        command.add_argument(
            "--budget", default=default, help=f"{', '.join(BUDGETS)} (default: {shown})"
        )
        command.add_argument(
            "--iterations", type=_whole(1), metavar="N", help="the budget with N iterations instead"
        )

    def add_cell(command: argparse.ArgumentParser) -> None:
        command.add_argument(
            "--body", "--env", metavar="NAME",
            help="the learner's body (see `bodies`), or the id of any Gymnasium environment",
        )  # fmt: skip
        command.add_argument("--method", help=", ".join(METHODS))
        command.add_argument(
            "--demonstrations", metavar="NAME", help="the expert's body, a clip, or an .npz file"
        )
        add_budget(command, None)
        command.add_argument("--seed", type=_whole(0, 2**31 - 1), help="default: 0")
        command.add_argument("--study", help="default: the body's family")
        command.add_argument(
            "--set", action="append", metavar="NAME=VALUE", help="a hyper-parameter"
        )
        command.add_argument(
            "--config", type=Path, help="a JSON configuration instead of all these"
        )

    command = add("run", _run, "make one run, or go on with it", long=True)
    add_cell(command)
    command.add_argument("--force", action="store_true", help="start anew, even if finished")
    command.add_argument(
        "--wait", action="store_true", help="wait for another process at work on this run"
    )

    command = add("campaign", _campaign, "make all runs of a study that are missing", long=True)
    command.add_argument("--study", default="halfcheetah", help="default: %(default)s")
    add_budget(command, "book")
    command.add_argument(
        "--trials", type=_whole(1), help="per cell; default: as many as budget and study have"
    )
    command.add_argument("--workers", type=_whole(1, 1024), default=2, help="default: %(default)s")
    command.add_argument("--body", nargs="+", help="only these learners' bodies")
    command.add_argument("--method", nargs="+", help="only these methods")

    command = add("status", _status, "what of a study is finished, running, missing", long=False)
    command.add_argument("--study", default="halfcheetah", help="default: %(default)s")
    add_budget(command, "book")

    command = add("show", _show, "every value of a run, and where it comes from", long=False)
    command.add_argument("run_id", metavar="RUN_ID", nargs="?", help="or what `run` takes:")
    add_cell(command)

    command = add("evaluate", _evaluate, "evaluate a finished run's policy anew", long=True)
    command.add_argument("run_id", metavar="RUN_ID")
    command.add_argument("--episodes", type=_whole(1), default=10, help="default: %(default)s")

    command = add("demonstrations", _demonstrations, "record an expert's demonstrations", long=True)
    command.add_argument("--body", help="record its best expert, at --budget")
    command.add_argument("--budget", default="book", help="default: %(default)s")
    command.add_argument(
        "--trial", type=_whole(0, 2**31 - 1), help="that trial's expert instead of the best"
    )
    command.add_argument("--run", metavar="RUN_ID", help="record this run instead")
    command.add_argument("--trajectories", type=_whole(1), default=20, help="default: %(default)s")
    command.add_argument("--force", action="store_true", help="replace another expert's")

    command = add("render", _render, "film a finished run's policy", long=True)
    command.add_argument("run_id", metavar="RUN_ID")
    command.add_argument(
        "--out", type=_film, required=True, help=f"the file to write ({', '.join(FILM_ENDINGS)})"
    )
    command.add_argument(
        "--seconds", type=_seconds, default=6.0,
        help=f"up to {LONGEST_FILM_S:.0f}; default: %(default)s",
    )  # fmt: skip
    command.add_argument("--seed", type=_whole(0, 2**31 - 1), default=0)

    command = add("verify", _verify, "check records, and evaluate policies anew", long=False)
    command.add_argument("name", metavar="RUN_ID|STUDY", nargs="?", help="default: all published")
    command.add_argument(
        "--episodes", type=_whole(0), default=verify.N_EPISODES,
        help="of each policy (default: %(default)s)",
    )  # fmt: skip

    add("bodies", _bodies, "list the bodies", long=False)

    about = "make the human's demonstrations, and retarget them, from CMU's or your clips"
    command = add("mocap", _mocap, about, long=True)
    command.add_argument("--asf", type=Path, help="the skeleton of a clip of your own")
    command.add_argument("--amc", type=Path, help="the clip")
    command.add_argument("--rate-hz", type=float, help="its frames per second, at CMU mostly 120")
    command.add_argument("--name", help="what --demonstrations will find it by")
    command.add_argument("--floor-slope", type=float, default=0.0, help="rise in m per m forward")
    return whole


# ---------------------------------------------------------------- what options say


def _whole(lowest: int, highest: int = LARGEST) -> Callable[[str], int]:
    """Return the type of an option that takes a whole number within bounds."""

    def convert(text: str) -> int:
        digits = text.lstrip("0") or text[-1:]
        whole = text.isascii() and text.isdecimal() and len(digits) <= len(str(highest))
        if not (whole and lowest <= int(digits) <= highest):
            raise argparse.ArgumentTypeError(
                f"{_short(text)} is no whole number from {lowest} to {highest}"
            )
        return int(digits)

    return convert


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value <= LONGEST_FILM_S:
        raise argparse.ArgumentTypeError(
            f"{_short(text)} is no number of seconds above 0, up to {LONGEST_FILM_S:.0f}"
        )
    return value


def _film(text: str) -> Path:
    path = Path(text)
    if path.suffix not in FILM_ENDINGS:
        raise argparse.ArgumentTypeError(
            f"{_short(text)} ends in none of {', '.join(FILM_ENDINGS)}"
        )
    if path.is_dir():
        raise argparse.ArgumentTypeError(f"{_short(text)} is a folder")
    return path


def _short(text: str) -> str:
    return repr(clipped(text, 60))


def budget_of(options: argparse.Namespace) -> Budget:
    """Return the budget that the options ask for."""
    budget = BUDGETS[choose("budget", options.budget or "tiny", BUDGETS)]
    return budget if options.iterations is None else budget.with_iterations(options.iterations)


def config_of(options: argparse.Namespace) -> RunConfig:
    """Return the configuration that the options of ``run`` ask for."""
    named = ("body", "method", "demonstrations", "budget", "iterations", "seed", "study", "set")
    if options.config:
        if given := [f"--{name}" for name in named if getattr(options, name) is not None]:
            raise SilemError(f"--config says all that {', '.join(given)} would say; give either")
        return RunConfig.from_dict(files.read_json(options.config))
    if not (options.body and options.method):
        raise SilemError("--body and --method are needed, or --config")
    method = choose("method", options.method, METHODS)
    allowed = [*HyperParameters.names_used_by(method), *bodies.get(options.body).parameters]
    overrides = {}
    for text in options.set or ():
        name, equals, value = text.partition("=")
        if not equals:
            raise SilemError(f"--set takes NAME=VALUE, not {_short(text)}")
        choose(f"setting of {method} on {options.body}", name, allowed)
        overrides[name] = _value(name, value)
    return RunConfig.create(
        options.body,
        options.method,
        options.demonstrations,
        budget_of(options),
        options.seed or 0,
        study=options.study,
        **overrides,
    )


def _value(name: str, text: str) -> Any:
    """Return the number, list of numbers or word that an option sets a hyper-parameter to."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        if text.isidentifier():
            return text
        raise SilemError(
            f"--set {name}: {_short(text)} is no number, list of numbers or word"
        ) from None


def _finished(run_id: str) -> RunRecord:
    record = runs.find(run_id)
    if record is None:
        raise SilemError(f"there is no finished run {_short(run_id)} in {paths.data_dir()}")
    return record


# ---------------------------------------------------------------- commands


def _run(options: argparse.Namespace) -> None:
    record = runs.run(config_of(options), not options.quiet, options.force, options.wait)
    _print_evaluation(record.run_id, record.evaluation)
    print(record.folder / RECORD)


def _print_evaluation(run_id: str, result: dict[str, Any]) -> None:
    scored = result["disc_reward_mean"]
    print(
        f"{run_id}: return {result['return_mean']:.0f} +- {result['return_std']:.0f} over"
        f" {result['n_episodes']} episodes, {result['speed_m_s']:.2f} m/s,"
        f" upright {result['upright']:.0%}"
        + ("" if scored is None else f", discriminator reward {scored:.0f}")
    )


def _campaign(options: argparse.Namespace) -> None:
    from silem.study.campaign import campaign

    configs = studies.study_configs(
        options.study, budget_of(options), options.trials, body=options.body, method=options.method
    )
    for record in campaign(configs, options.workers, progress=not options.quiet):
        _print_evaluation(record.run_id, record.evaluation)


def _status(options: argparse.Namespace) -> None:
    print(studies.status_table(options.study, budget_of(options)))


def _evaluate(options: argparse.Namespace) -> None:
    record = _finished(options.run_id)
    from silem.study.evaluate import evaluate
    from silem.study.policies import load_policy
    from silem.study.training import task_options

    config = record.run_config()
    policy, task, progress = load_policy(record), task_options(config), not options.quiet
    result = evaluate(policy, config.learner, options.episodes, progress=progress, **task)
    _print_evaluation(record.run_id, result.to_dict())


def _show(options: argparse.Namespace) -> None:
    if options.run_id:
        print(_finished(options.run_id).run_config().describe())
    else:
        print(config_of(options).describe())


def _verify(options: argparse.Namespace) -> None:
    verdicts = []
    for verdict in verify.verify_all(options.name, options.episodes):
        print(verdict, flush=True)
        verdicts.append(verdict)
    refuted = [verdict.name for verdict in verdicts if verdict.outcome == verify.NOT]
    if refuted:
        raise SilemError(f"{len(refuted)} of {len(verdicts)} are not what they say")


def _demonstrations(options: argparse.Namespace) -> None:
    from silem.study.demonstrate import demonstrate, demonstrator, describe, trial_name

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
    record = _finished(options.run_id)
    try:
        from silem.report import film
    except ModuleNotFoundError as error:
        raise SilemError(f"films need {error.name}: pip install 'silem[video]'") from error
    from silem.study.policies import load_policy

    policy = load_policy(record)
    learner = record.run_config().learner
    clip = film.rollout(learner, policy, duration_s=options.seconds, seed=options.seed)
    film.write(options.out, clip)
    print(options.out)


def _mocap(options: argparse.Namespace) -> None:
    from silem.motion import demonstrator, retargeting

    progress = not options.quiet
    own_clip = (options.name, options.asf, options.amc, options.rate_hz)
    if own_clip == (None,) * 4:
        written, clip = demonstrator.publish_clips(progress=progress), "08_01"
    elif None in own_clip:
        raise SilemError("mocap needs --asf, --amc, --rate-hz and --name for a clip of your own")
    else:
        written = [demonstrator.publish_own(*own_clip, floor_slope=options.floor_slope)]
        clip = options.name
    for path in (*written, *retargeting.publish_retargeted(clip, progress=progress)):
        print(path)


def _bodies(options: argparse.Namespace) -> None:
    for name in bodies.names():
        print(f"{name:9} {bodies.get(name).description}")
