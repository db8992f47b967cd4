"""The command line ``silem``: thin commands over the functions that the notebooks call.

What a command needs beyond names and settings (PyTorch, the simulators, drawing) it loads itself,
so that ``silem status`` and ``silem --help`` answer at once.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import mean
from typing import Any, NoReturn

import silem
from silem import bodies
from silem.study import runs, studies, verify
from silem.study.config import RunConfig
from silem.study.record import POLICY, RECORD, RunRecord
from silem.study.settings import BUDGETS, LARGEST, METHODS, Budget, HyperParameters, budget_named
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
    commands = whole.add_subparsers(required=True, metavar="COMMAND")
    trial, count, usual = _whole(0, 2**31 - 1), _whole(1), "default: %(default)s"

    def command(execute: Callable[[argparse.Namespace], None]) -> Callable[..., Any]:
        """Add a command, named and described as its function is, and return what adds options."""
        text = (execute.__doc__ or "").rstrip(".")
        text = text[:1].lower() + text[1:]
        added = commands.add_parser(execute.__name__.strip("_"), help=text, description=text)
        added.set_defaults(command=execute)
        add = added.add_argument
        load = "load a Python module that registers bodies of your own"
        add("--import", dest="modules", action="append", default=[], metavar="MODULE", help=load)
        add("--quiet", action="store_true", help="no progress bar")
        add("--with-input", action="store_true", help="stop when the standard input ends")
        return add

    def add_budget(add: Callable[..., Any], default: str | None) -> None:
        names = f"{', '.join(BUDGETS)} (default: {default or 'tiny'})"
        add("--budget", default=default, help=names)
        add("--iterations", type=count, metavar="N", help="the budget with N iterations instead")

    def add_cell(add: Callable[..., Any]) -> None:
        moved = "the learner's body (see `bodies`), or the id of any Gymnasium environment"
        add("--body", "--env", metavar="NAME", help=moved)
        add("--method", help=", ".join(METHODS))
        add("--demonstrations", metavar="NAME", help="the expert's body, a clip, or an .npz file")
        add_budget(add, None)
        add("--seed", type=trial, help="default: 0")
        add("--study", help="default: the body's family")
        add("--set", action="append", metavar="NAME=VALUE", help="a hyper-parameter")

    def add_runs(add: Callable[..., Any], only: bool = True) -> None:
        add_budget(add, "book")
        add("--trials", type=count, help="per cell; default: as many as budget and study have")
        add("--sample", type=count, metavar="N", help="only the first N configurations of a search")
        for what in ("body", "method") if only else ():
            add(f"--{what}", nargs="+", help=f"only cells of these (each a {what})")

    def add_loop(add: Callable[..., Any], workers: int | None = None) -> None:
        many = "so many processes, with one bar; default: this one alone"
        add("--workers", type=_whole(1, 1024), default=workers, metavar="K", help=many)
        add("--minutes", type=_whole(1, 10**6), metavar="N", help="stop at a checkpoint by then")
        add("--retry", action="store_true", help="also what has failed before")

    add = command(_run)
    add_cell(add)
    add("--force", action="store_true", help="start anew, even if finished")

    several = {"metavar": "STUDY", "help": "a study, or a search STUDY/BODY/METHOD"}
    add = command(_work)
    add("studies", nargs="+", **several)
    add_runs(add)
    add_loop(add)

    add = command(_campaign)
    add("--study", nargs=1, dest="studies", default=["halfcheetah"], **several)
    add_runs(add)
    add_loop(add, workers=2)

    add = command(_search)
    add("studies", nargs=1, metavar="STUDY/BODY/METHOD", help="the cell")
    add_runs(add, only=False)
    add_loop(add)
    fresh = "when it is finished: its best, and the supplement's, on seeds that it has not used"
    add("--winner", action="store_true", help=fresh)

    add = command(_submit)
    add("studies", nargs="+", **several)
    add_runs(add)
    add("--on", required=True, metavar="ENGINE", help="slurm, htcondor or dask")
    add("--jobs", type=_whole(1, 10**5), metavar="N", help="work loops at a time; default: 4")
    add("--options", type=Path, metavar="FILE", help="a TOML file that tells the engine more")
    add("--print", action="store_true", help="show what would be submitted")

    add = command(_status)
    add("studies", nargs="*", default=["halfcheetah"], **several)
    add_runs(add, only=False)

    add = command(_show)
    add("run_id", metavar="RUN_ID", nargs="?", help="or what `run` takes:")
    add_cell(add)

    add = command(_evaluate)
    add("run_id", metavar="RUN_ID")
    add("--episodes", type=count, default=10, help=usual)

    add = command(_demonstrations)
    add("--body", help="record its best expert, at --budget")
    add("--budget", default="book", help=usual)
    add("--trial", type=trial, help="that trial's expert instead of the best")
    add("--run", metavar="RUN_ID", help="record this run instead")
    add("--trajectories", type=count, default=20, help=usual)
    add("--force", action="store_true", help="replace another expert's")

    add = command(_render)
    add("run_id", metavar="RUN_ID")
    add("--out", type=_film, required=True, help=f"the file to write ({', '.join(FILM_ENDINGS)})")
    longest = f"up to {LONGEST_FILM_S:.0f}; {usual}"
    add("--seconds", type=_seconds, default=6.0, help=longest)
    add("--seed", type=trial, default=0)

    add = command(_export)
    add("run_id", metavar="RUN_ID")
    add("--out", type=Path, required=True, help="the file to write (.safetensors)")

    add = command(_verify)
    add("name", metavar="RUN_ID|STUDY", nargs="?", help="default: all published")
    add("--episodes", type=_whole(0), default=verify.N_EPISODES, help=f"of each policy; {usual}")

    command(_bodies)

    add = command(_mocap)
    add("--asf", type=Path, help="the skeleton of a clip of your own")
    add("--amc", type=Path, help="the clip")
    add("--rate-hz", type=float, help="its frames per second, at CMU mostly 120")
    add("--name", help="what --demonstrations will find it by")
    add("--floor-slope", type=float, default=0.0, help="rise in m per m forward")
    return whole


def _whole(lowest: int, highest: int = LARGEST) -> Callable[[str], int]:
    """Return the type of an option that takes a whole number within bounds."""

    def convert(text: str) -> int:
        digits = text.lstrip("0") or text[-1:]
        whole = text.isascii() and text.isdecimal() and len(digits) <= len(str(highest))
        if not (whole and lowest <= int(digits) <= highest):
            why = f"is no whole number from {lowest} to {highest}"
            raise argparse.ArgumentTypeError(f"{_short(text)} {why}")
        return int(digits)

    return convert


def _seconds(text: str) -> float:
    value = float(text) if text.isascii() and text.replace(".", "", 1).isdecimal() else 0.0
    if not 0 < value <= LONGEST_FILM_S:
        why = f"is no number of seconds above 0, up to {LONGEST_FILM_S:.0f}"
        raise argparse.ArgumentTypeError(f"{_short(text)} {why}")
    return value


def _film(text: str) -> Path:
    path = Path(text)
    if path.suffix not in FILM_ENDINGS or path.is_dir():
        why = f"is a folder, or ends in none of {', '.join(FILM_ENDINGS)}"
        raise argparse.ArgumentTypeError(f"{_short(text)} {why}")
    return path


def _short(text: str) -> str:
    return repr(clipped(text, 60))


def budget_of(options: argparse.Namespace) -> Budget:
    """Return the budget that the options ask for."""
    budget = budget_named("tiny" if options.budget is None else options.budget)
    return budget if options.iterations is None else budget.with_iterations(options.iterations)


def config_of(options: argparse.Namespace) -> RunConfig:
    """Return the configuration that the options of ``run`` ask for."""
    if options.demonstrations == "":
        raise SilemError("--demonstrations needs a name, an expert's body, a clip or an .npz file")
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
    cell = (body, method, options.demonstrations)
    return RunConfig.create(
        *cell, budget_of(options), options.seed or 0, options.study, **overrides
    )


def _value(name: str, text: str) -> Any:
    """Return the number, list of numbers or word that an option sets a hyper-parameter to."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        if text.isidentifier():
            return text
    raise SilemError(f"--set {name}: {_short(text)} is no number, list of numbers or word")


def _finished(run_id: str) -> RunRecord:
    record = runs.find(run_id)
    if record is None:
        raise SilemError(f"there is no finished run {_short(run_id)} in {paths.data_dir()}")
    return record


# ---------------------------------------------------------------- commands


def _run(options: argparse.Namespace) -> None:
    """Make one run, or go on with it."""
    record = runs.run(config_of(options), not options.quiet, options.force)
    _print_evaluation(record.run_id, record.evaluation)
    print(record.folder / RECORD)


def _print_evaluation(run_id: str, result: dict[str, Any]) -> None:
    text = f"{run_id}: return {result['return_mean']:.0f} +- {result['return_std']:.0f} over"
    text += f" {result['n_episodes']} episodes"
    if result["speed_m_s"] is not None:  # which not every environment says
        text += f", {result['speed_m_s']:.2f} m/s, upright {result['upright']:.0%}"
    if result["disc_reward_mean"] is not None:
        text += f", discriminator reward {result['disc_reward_mean']:.0f}"
    print(text)


def _configs(options: argparse.Namespace) -> list[RunConfig]:
    """Return the runs of all studies asked for, one study after the other."""
    only = {name: getattr(options, name, None) for name in ("body", "method")}
    budget, trials, sample = budget_of(options), options.trials, options.sample
    if getattr(options, "winner", False):
        return studies.fresh_configs(options.studies[0], budget, trials, sample)
    return [
        config
        for study in options.studies
        for config in studies.study_configs(study, budget, trials, sample, **only)
    ]


def _words(options: argparse.Namespace) -> list[str]:
    """Return the command line of a loop that does what these options ask for."""
    winner = ["--winner"] if getattr(options, "winner", False) else []
    words = ["search" if winner else "work", *options.studies, *winner]
    for name in ("budget", "iterations", "trials", "sample", "body", "method", "minutes"):
        if (said := getattr(options, name, None)) is not None:
            words += [f"--{name}", *map(str, said if isinstance(said, list) else [said])]
    for module in options.modules:
        words += ["--import", module]
    return words


def _work(options: argparse.Namespace) -> None:
    """Make what is missing of studies, run after run."""
    from silem.study import work

    def made(record: RunRecord) -> None:
        _print_evaluation(record.run_id, record.evaluation)

    configs, progress = _configs(options), not options.quiet
    for config in configs if options.retry else ():
        runs.forgive(config)
    if options.workers:
        work.crew(_words(options), configs, options.workers, progress)
    else:
        work.work(configs, options.minutes or math.inf, progress, made)


def _campaign(options: argparse.Namespace) -> None:
    """`work --retry` on one study, by several processes."""
    options.retry = True
    _work(options)


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
    print(submit.submit(options.on, words, said))


def _search(options: argparse.Namespace) -> None:
    """Run a grid of the supplement, and rank its configurations."""
    if "/" not in options.studies[0]:
        raise SilemError(f"a search is STUDY/BODY/METHOD, not {_short(options.studies[0])}")
    _work(options)
    cell, budget = options.studies[0], budget_of(options)
    found = studies.ranking(cell, budget, options.trials, options.sample)
    for place, entry in enumerate(found, 1):
        said = " ".join(f"{name}={value}" for name, value in entry.settings.items())
        mark = "  (the supplement's best)" if entry.is_papers else ""
        fresh = f"  (on fresh seeds: {mean(entry.fresh):.0f})" if entry.fresh else ""
        print(f"{place:4} {entry.score:8.0f}  {said}{mark}{fresh}")


def _status(options: argparse.Namespace) -> None:
    """What of studies is finished, running, failed, missing, and how long the rest takes."""
    from silem.study import work

    for study in options.studies:
        print(work.status(study, budget_of(options), options.trials, options.sample))


def _show(options: argparse.Namespace) -> None:
    """Every value of a run, and where it comes from."""
    config = _finished(options.run_id).run_config() if options.run_id else config_of(options)
    print(config.describe())


def _evaluate(options: argparse.Namespace) -> None:
    """Evaluate a finished run's policy anew."""
    record = _finished(options.run_id)
    from silem.study.evaluate import evaluate, load_policy
    from silem.study.training import task_options

    config = record.run_config()
    policy, task, progress = load_policy(record), task_options(config), not options.quiet
    result = evaluate(policy, config.learner, options.episodes, progress=progress, **task)
    _print_evaluation(record.run_id, result.to_dict())


def _demonstrations(options: argparse.Namespace) -> None:
    """Record an expert's demonstrations."""
    from silem.study.demonstrate import demonstrate, demonstrator, describe, trial_name

    if bool(options.run) == bool(options.body):
        raise SilemError("demonstrations needs either --body or --run")
    name = None
    if options.run:
        record = _finished(options.run)
    else:
        record = demonstrator(options.body, options.budget, options.trial)
        name = None if options.trial is None else trial_name(record)
    path = demonstrate(
        record, options.trajectories, name=name, force=options.force, progress=not options.quiet
    )
    print(f"{path}: {describe(path.stem)}")


def _render(options: argparse.Namespace) -> None:
    """Film a finished run's policy."""
    record = _finished(options.run_id)
    try:
        from silem.report import film
    except ModuleNotFoundError as error:
        raise SilemError(f"films need {error.name}: pip install 'silem[video]'") from error
    from silem.study.evaluate import load_policy

    learner, policy = record.run_config().learner, load_policy(record)
    shown = {"duration_s": options.seconds, "seed": options.seed, "progress": not options.quiet}
    clip = film.rollout(learner, policy, **shown)
    film.write(options.out, clip)
    print(options.out)


def _export(options: argparse.Namespace) -> None:
    """Write a finished run's policy as numbers alone, for `silem.load_policy`."""
    policy = _finished(options.run_id).file(POLICY)
    if options.out.suffix != policy.suffix:
        raise SilemError(f"a policy is exported as {policy.suffix}, not {_short(str(options.out))}")
    files.write_bytes(options.out, policy.read_bytes())
    print(options.out)


def _verify(options: argparse.Namespace) -> None:
    """Check records, and evaluate policies anew."""
    verdicts = []
    for verdict in verify.verify_all(options.name, options.episodes):
        print(verdict, flush=True)
        verdicts.append(verdict)
    refuted = sum(verdict.outcome == verify.NOT for verdict in verdicts)
    if refuted:
        raise SilemError(f"{refuted} of {len(verdicts)} are not what they say")


def _bodies(options: argparse.Namespace) -> None:
    """List the bodies."""
    for name in bodies.names():
        print(f"{name:9} {bodies.get(name).description}")


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
