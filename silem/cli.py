"""The command line ``silem``: thin commands over the functions that the notebooks call.

What a command needs beyond names and settings (PyTorch, the simulators, drawing) it loads itself,
so that ``silem status`` and ``silem --help`` answer at once.
"""

import argparse
import ast
import dataclasses
import math
import os
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import mean
from typing import Any, NoReturn

import silem
from silem import bodies
from silem.study import runs, studies, verify
from silem.study.config import RunConfig
from silem.study.runs import POLICY, RECORD, RunRecord
from silem.study.settings import BUDGETS, METHODS, Budget, HyperParameters, budget_named
from silem.util import files
from silem.util.errors import LARGEST, SilemError, choose, clipped

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
  silem work halfcheetah --budget book --trials 1 --workers 2
  silem status --budget book
  silem render RUN_ID --out hc2.mp4

A run that was stopped or killed goes on from its checkpoint when its command is given again.
The environment variable SILEM_DATA_DIR moves the data folder.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, what follows ``silem`` or None for the process's, and return its code.

    That is 0, 1 where the system refused, 2 on a bad request, 130 where it was stopped, 141 where
    nobody reads the output any more.
    """
    try:
        with runs.stoppable():
            try:
                options = parser().parse_args(arguments)
                if options.with_input:
                    runs.stop_with_input()
                for module in options.modules:
                    bodies.load(module)
                options.command(options)
            finally:
                if sys.stdout:  # None where it is closed
                    sys.stdout.flush()  # while a closed pipe can still be answered for
    except SilemError as error:
        return _end(BAD_REQUEST, str(error))
    except KeyboardInterrupt as interrupt:
        return _end(INTERRUPTED, str(interrupt) or "stopped")
    except OSError as error:
        # Python flushes once more when it exits, and would complain then.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return CLOSED_PIPE
        named = f"{error.filename}: " if error.filename else ""
        return _end(FAILED, f"{named}{error.strerror or error}")
    return OK


def _end(code: int, message: str) -> int:
    """Say in one line how the command ended."""
    if code == INTERRUPTED and sys.stderr.isatty():
        print(file=sys.stderr)  # the line of the progress bar and ^C ends here
    print(f"silem: {' '.join(message.split())}", file=sys.stderr)
    return code


# ---------------------------------------------------------------- what can be said


def _checked(convert: Callable[[str], Any], otherwise: str) -> Callable[[str], Any]:
    """Return the type of an option: what `convert` makes of a text, None where it takes it not."""

    def typed(text: str) -> Any:
        if (value := convert(text)) is None:
            raise argparse.ArgumentTypeError(f"{_short(text)} {otherwise}")
        return value

    return typed


def _whole(lowest: int, highest: int = LARGEST) -> Callable[[str], Any]:
    """Return the type of an option that takes a whole number within bounds."""

    def convert(text: str) -> int | None:
        digits = re.fullmatch("0*([0-9]{1,10})", text)
        return int(digits[1]) if digits and lowest <= int(digits[1]) <= highest else None

    return _checked(convert, f"is no whole number from {lowest} to {highest}")


def _seconds(text: str) -> float | None:
    value = float(text) if re.fullmatch(r"[0-9]+\.?[0-9]*|\.[0-9]+", text) else 0.0
    return value if 0 < value <= LONGEST_FILM_S else None


def _film(text: str) -> Path | None:
    return path if (path := Path(text)).suffix in FILM_ENDINGS and not path.is_dir() else None


def _short(text: str) -> str:
    return repr(clipped(text, 60))


Option = tuple[tuple[str, ...], dict[str, Any]]
_COMMANDS: list[tuple[Callable[[argparse.Namespace], None], tuple[Option, ...]]] = []


def _option(*names: str, **how: Any) -> Option:
    """Return the arguments of one call of `argparse`'s `add_argument`."""
    return names, how


def _takes(*options: Option) -> Callable[..., Any]:
    """Make a function the command of its name, described as it is, which takes these options."""

    def add(execute: Callable[[argparse.Namespace], None]) -> Callable[..., None]:
        _COMMANDS.append((execute, options))
        return execute

    return add


_TRIAL, _COUNT, _USUAL = _whole(0, 2**31 - 1), _whole(1), "default: %(default)s"
_ENDINGS = ", ".join(FILM_ENDINGS)
_FILM = _checked(_film, f"is a folder, or ends in none of {_ENDINGS}")
_SECONDS = _checked(_seconds, f"is no number of seconds above 0, up to {LONGEST_FILM_S:.0f}")
_EVERYWHERE = (
    _option("--import", dest="modules", action="append", default=[], metavar="MODULE",
            help="load a Python module that registers bodies of your own"),
    _option("--quiet", action="store_true", help="no progress bar"),
    _option("--with-input", action="store_true", help="stop when the standard input ends"),
)  # fmt: skip
_ITERATIONS = _option(
    "--iterations", type=_COUNT, metavar="N", help="the budget with N iterations instead"
)
_CELL = (
    _option("--body", "--env", metavar="NAME",
            help="the learner's body (see `bodies`), or the id of any Gymnasium environment"),
    _option("--method", help=", ".join(METHODS)),
    _option("--demonstrations", metavar="NAME", 
            help="an expert's body, a clip, or a file in $SILEM_DATA_DIR/demonstrations"),
    _option("--budget", help=f"{', '.join(BUDGETS)} (default: tiny)"),
    _ITERATIONS,
    _option("--seed", type=_TRIAL, help="default: 0"),
    _option("--study", help="default: the body's family"),
    _option("--set", action="append", metavar="NAME=VALUE", help="a hyper-parameter"),
)  # fmt: skip
_STUDY = {"metavar": "STUDY", "help": "a study, or a search STUDY/BODY/METHOD"}
_STUDIES = _option("studies", nargs="+", **_STUDY)
_RUNS = (
    _option("--budget", default="book", help=f"{', '.join(BUDGETS)} (default: book)"),
    _ITERATIONS,
    _option("--trials", type=_COUNT, help="per cell; default: as many as budget and study have"),
    _option("--sample", type=_COUNT, metavar="N", help="only the first N settings of a search"),
)
_ONLY = tuple(
    _option(f"--{what}", nargs="+", help=f"only cells of these (each a {what})")
    for what in ("body", "method")
)
_RETRY = _option("--retry", action="store_true", help="also what has failed before")
_LOOP = (
    _option("--workers", type=_whole(1, 1024), metavar="K",
            help="so many processes, with one bar; default: this one alone"),
    _option("--minutes", type=_whole(1, 10**6), metavar="N", help="stop at a checkpoint by then"),
    _RETRY,
)  # fmt: skip
_RUN_ID = _option("run_id", metavar="RUN_ID")


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise SilemError(f"{message} (see `{self.prog} --help`)")


def parser() -> argparse.ArgumentParser:
    """Return the parser of the whole command line."""
    whole = _Parser(
        prog="silem",
        description="Imitation learning across bodies: runs, studies and their records.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    whole.add_argument("--version", action="version", version=f"silem {silem.__version__}")
    added = whole.add_subparsers(required=True, metavar="COMMAND")
    for execute, options in _COMMANDS:
        text = (execute.__doc__ or "").rstrip(".")
        text = text[:1].lower() + text[1:]
        command = added.add_parser(execute.__name__.strip("_"), help=text, description=text)
        command.set_defaults(command=execute)
        for names, how in (*_EVERYWHERE, *options):
            command.add_argument(*names, **how)
    return whole


def budget_of(options: argparse.Namespace) -> Budget:
    """Return the budget that the options ask for."""
    budget = budget_named("tiny" if options.budget is None else options.budget)
    return budget if options.iterations is None else budget.with_iterations(options.iterations)


def config_of(options: argparse.Namespace) -> RunConfig:
    """Return the configuration that the options of ``run`` ask for."""
    if options.demonstrations == "":
        raise SilemError("--demonstrations needs a name: an expert's body, a clip or a file")
    if not (options.body and options.method):
        raise SilemError("--body and --method are needed")
    body, method = options.body, choose("method", options.method, METHODS)
    allowed = [*HyperParameters.used_by(method), *bodies.get(body).parameters]
    overrides = {}
    for text in options.set or ():
        name, equals, value = text.partition("=")
        if not equals:
            raise SilemError(f"--set takes NAME=VALUE, not {_short(text)}")
        choose(f"setting of {method} on {body}", name, allowed)
        overrides[name] = _value(name, value)
    cell, budget = (body, method, options.demonstrations), budget_of(options)
    return RunConfig.create(*cell, budget, options.seed or 0, options.study, **overrides)


def _value(name: str, text: str) -> Any:
    """Return the number, list of numbers or word that an option sets a hyper-parameter to."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        if text.isidentifier():
            return text
    raise SilemError(f"--set {name}: {_short(text)} is no number, list of numbers or word")


def _configs(options: argparse.Namespace) -> list[RunConfig]:
    """Return the runs of all studies asked for, one study after the other."""
    only: dict[str, Any] = {name: getattr(options, name, None) for name in ("body", "method")}
    asked = (budget_of(options), options.trials, options.sample)
    if getattr(options, "winner", False):
        return studies.fresh_configs(options.studies[0], *asked)
    return [c for study in options.studies for c in studies.study_configs(study, *asked, **only)]


def _forgive(options: argparse.Namespace, configs: Sequence[RunConfig]) -> None:
    for config in configs if options.retry else ():
        runs.forgive(config)


def _words(options: argparse.Namespace) -> list[str]:
    """Return the command line of a loop that does what these options ask for."""
    winner = ["--winner"] if getattr(options, "winner", False) else []
    words = ["search" if winner else "work", *options.studies, *winner]
    for name in ("budget", "iterations", "trials", "sample", "body", "method"):
        if (said := getattr(options, name, None)) is not None:
            words += [f"--{name}", *map(str, said if isinstance(said, list) else [said])]
    return words + [word for module in options.modules for word in ("--import", module)]


def _print_evaluation(run_id: str, result: dict[str, Any]) -> None:
    text = f"{run_id}: return {result['return_mean']:.0f} +- {result['return_std']:.0f} over"
    text += f" {result['n_episodes']} episodes"
    if result["speed_m_s"] is not None:  # which not every environment says
        text += f", {result['speed_m_s']:.2f} m/s, upright {result['upright']:.0%}"
    if result["disc_reward_mean"] is not None:
        text += f", discriminator reward {result['disc_reward_mean']:.0f}"
    print(text)


# ---------------------------------------------------------------- commands


@_takes(*_CELL, _option("--force", action="store_true", help="start anew, even if finished"))
def _run(options: argparse.Namespace) -> None:
    """Make one run, or go on with it."""
    record = runs.run(config_of(options), not options.quiet, options.force)
    _print_evaluation(record.run_id, record.evaluation)
    print(record.folder / RECORD)


@_takes(_STUDIES, *_RUNS, *_ONLY, *_LOOP)
def _work(options: argparse.Namespace) -> None:
    """Make what is missing of studies, run after run."""
    from silem.study import work

    def made(record: RunRecord) -> None:
        _print_evaluation(record.run_id, record.evaluation)

    configs, progress = _configs(options), not options.quiet
    _forgive(options, configs)
    if options.workers:
        work.crew(_words(options), configs, options.workers, options.minutes or math.inf, progress)
    else:
        work.work(configs, options.minutes or math.inf, progress, made)


@_takes(_option("--study", nargs=1, dest="studies", default=["halfcheetah"], **_STUDY),
        *_RUNS, *_ONLY, *_LOOP)  # fmt: skip
def _campaign(options: argparse.Namespace) -> None:
    """Make what is missing of one study, by two workers by default."""
    options.workers = options.workers or 2
    _work(options)


@_takes(
    _option("studies", nargs=1, metavar="STUDY/BODY/METHOD", help="the cell"), *_RUNS, *_LOOP,
    _option("--winner", action="store_true",
            help="when it is finished: its best, and the supplement's, on unused seeds"),
)  # fmt: skip
def _search(options: argparse.Namespace) -> None:
    """Run a grid of the supplement, and rank its configurations."""
    cell = options.studies[0]
    if "/" not in cell:
        raise SilemError(f"a search is STUDY/BODY/METHOD, not {_short(cell)}")
    _work(options)
    found = studies.ranking(cell, budget_of(options), options.trials, options.sample)
    for place, entry in enumerate(found, 1):
        said = " ".join(f"{name}={value}" for name, value in entry.settings.items())
        mark = "  (the supplement's best)" if entry.is_papers else ""
        fresh = f"  (on fresh seeds: {mean(entry.fresh):.0f})" if entry.fresh else ""
        print(f"{place:4} {entry.score:8.0f}  {said}{mark}{fresh}")


@_takes(
    _STUDIES, *_RUNS, *_ONLY,
    _option("--on", required=True, metavar="ENGINE", help="slurm, htcondor or dask"),
    _option("--jobs", type=_whole(1, 10**5), metavar="N", help="work loops at a time; default: 4"),
    _option("--options", type=Path, metavar="FILE", help="a TOML file that tells the engine more"),
    _option("--print", action="store_true", help="show what would be submitted"), _RETRY,
)  # fmt: skip
def _submit(options: argparse.Namespace) -> None:
    """Hand work loops over to a cluster."""
    from silem.study import submit, work

    said = submit.Options.load(options.options)
    if options.jobs:
        said = dataclasses.replace(said, jobs=options.jobs)
    words, configs = _words(options), _configs(options)
    if options.print:
        print(submit.submission(options.on, words, said), end="")
        return
    work.check(configs)
    _forgive(options, configs)
    print(submit.submit(options.on, words, said))


@_takes(_option("studies", nargs="*", default=["halfcheetah"], **_STUDY), *_RUNS)
def _status(options: argparse.Namespace) -> None:
    """What of studies is finished, running, failed, missing, and how long the rest takes."""
    from silem.study import work

    for study in options.studies:
        print(work.status(study, budget_of(options), options.trials, options.sample))


@_takes(_option("run_id", metavar="RUN_ID", nargs="?", help="or what `run` takes:"), *_CELL)
def _show(options: argparse.Namespace) -> None:
    """Every value of a run, and where it comes from."""
    said = [names[0] for names, _ in _CELL if getattr(options, names[0][2:]) is not None]
    if options.run_id and said:
        raise SilemError(f"show takes a RUN_ID, or what `run` takes, not both: {', '.join(said)}")
    config = runs.get(options.run_id).run_config if options.run_id else config_of(options)
    print(config.describe())


@_takes(_RUN_ID, _option("--episodes", type=_COUNT, default=10, help=_USUAL))
def _evaluate(options: argparse.Namespace) -> None:
    """Evaluate a finished run's policy anew."""
    record = runs.get(options.run_id)
    from silem.study.evaluate import evaluate, load_policy
    from silem.study.training import task_options

    config = record.run_config
    policy, task, progress = load_policy(record), task_options(config), not options.quiet
    result = evaluate(policy, config.learner, options.episodes, progress=progress, **task)
    _print_evaluation(record.run_id, result._asdict())


@_takes(
    _option("--body", help="record its best expert, at --budget"),
    _option("--budget", default="book", help=_USUAL),
    _option("--trial", type=_TRIAL, help="that trial's expert instead of the best"),
    _option("--run", metavar="RUN_ID", help="record this run instead"),
    _option("--name", help="what --demonstrations will find them by; default: the body's"),
    _option("--trajectories", type=_COUNT, default=20, help=_USUAL),
    _option("--force", action="store_true", help="replace another expert's"),
)
def _demonstrations(options: argparse.Namespace) -> None:
    """Record an expert's demonstrations."""
    if bool(options.run) == bool(options.body):
        raise SilemError("demonstrations needs either --body or --run")
    name = options.name
    if options.run:
        record = runs.get(options.run)
    else:
        record = runs.demonstrator(studies.experts(options.body, options.budget, options.trial))
        if options.trial is not None:
            name = name or f"{options.body}_s{options.trial}"
    from silem.study import evaluate

    how = {"name": name, "force": options.force, "progress": not options.quiet}
    path = evaluate.demonstrate(record, options.trajectories, **how)
    print(f"{path}: {evaluate.describe(path.stem)}")


@_takes(
    _RUN_ID,
    _option("--out", required=True, type=_FILM, help=f"the file to write ({_ENDINGS})"),
    _option("--seconds", type=_SECONDS, default=6.0, help=f"up to {LONGEST_FILM_S:.0f}; {_USUAL}"),
    _option("--seed", type=_TRIAL, default=0),
)
def _render(options: argparse.Namespace) -> None:
    """Film a finished run's policy."""
    record = runs.get(options.run_id)
    try:
        from silem.report import film
    except ModuleNotFoundError as error:
        raise SilemError(f"films need {error.name}: pip install 'silem[video]'") from error
    from silem.study.evaluate import load_policy

    learner, policy = record.run_config.learner, load_policy(record)
    shown = {"duration_s": options.seconds, "seed": options.seed, "progress": not options.quiet}
    film.write(options.out, film.rollout(learner, policy, **shown))
    print(options.out)


@_takes(
    _RUN_ID, _option("--out", type=Path, required=True, help="the file to write (.safetensors)")
)
def _export(options: argparse.Namespace) -> None:
    """Write a finished run's policy as numbers alone, for `silem.load_policy`."""
    policy = runs.get(options.run_id).file(POLICY)
    if options.out.suffix != policy.suffix:
        raise SilemError(f"a policy is exported as {policy.suffix}, not {_short(str(options.out))}")
    files.write_bytes(options.out, policy.read_bytes())
    print(options.out)


@_takes(
    _option("name", metavar="RUN_ID|STUDY", nargs="?", help="default: all published"),
    _option("--episodes", type=_whole(0), default=verify.N_EPISODES,
            help=f"of each policy; {_USUAL}"),
)  # fmt: skip
def _verify(options: argparse.Namespace) -> None:
    """Check records, and evaluate policies anew."""
    verdicts = []
    for verdict in verify.verify_all(options.name, options.episodes):
        print(verdict, flush=True)
        verdicts.append(verdict)
    refuted = sum(verdict.outcome == verify.NOT for verdict in verdicts)
    if refuted:
        raise SilemError(f"{refuted} of {len(verdicts)} are not what they say")


@_takes()
def _bodies(options: argparse.Namespace) -> None:
    """List the bodies."""
    for name in bodies.names():
        print(f"{name:9} {bodies.get(name).description}")


@_takes(
    _option("--asf", type=Path, help="the skeleton of a clip of your own"),
    _option("--amc", type=Path, help="the clip"),
    _option("--rate-hz", type=float, help="its frames per second, at CMU mostly 120"),
    _option("--name", help="what --demonstrations will find it by"),
    _option("--floor-slope", type=float, default=0.0, help="rise in m per m forward"),
)
def _mocap(options: argparse.Namespace) -> None:
    """Make the human's demonstrations, and retarget them, from CMU's or your clips."""
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
