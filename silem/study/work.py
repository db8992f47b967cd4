"""Working through studies: a loop that makes one run after another, and what such loops have done.

The file system is the truth. A loop takes the next run whose lock is free; so any number of loops
on any number of machines share a data folder, and any of them may die at any moment.
"""

import math
import os
import socket
import subprocess
import sys
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from statistics import mean
from typing import Any

from tqdm import tqdm

from silem.motion import demonstrations as demos
from silem.study import runs
from silem.study.config import RunConfig
from silem.study.runs import PROGRESS, RunRecord
from silem.study.settings import Budget
from silem.study.studies import STUDIES, experts, narrowed
from silem.util import files, paths
from silem.util.errors import SilemError, reason

STOPPED = 130
"""The exit code of a loop that was stopped, or whose time was up: the same command goes on."""
_GOES_ON = "the same command goes on"
_POLL_S, _LONGEST_POLL_S = 1.0, 30.0
_SHOWN_EVERY_S = 5.0
_MOST_LOST = 5  # runs in a row
_MOST_KILLS = 100  # of one loop of a crew, which is then not started again
_ENOUGH = 3  # measured runs of a kind


def experts_of(config: RunConfig) -> list[RunConfig]:
    """Return the experts of whom the rule still has to choose a run's demonstrator.

    None where its demonstrations are there, or it needs none (see `runs.demonstrator`).
    """
    name = config.demonstrations
    if not name or demos.is_published(name):
        return []
    body, trial = demos.expert_of(name)
    runs.check_made_by_an_expert(name)
    return experts(body, config.budget.base_name, trial)


def check(configs: Sequence[RunConfig]) -> None:
    """Refuse work that cannot be done.

    Raises SilemError: an imitator's expert is neither finished nor among the runs; a finished run
    was made with other demonstrations than those there are now; or there are no locks.
    """
    planned = {config.run_id for config in configs}
    lacking = [
        (config, expert)
        for config in configs
        for expert in (experts_of(config) if not runs.finished(config) else ())
        if expert.run_id not in planned and not runs.is_finished(expert)
    ]
    if lacking:
        config, expert = lacking[0]
        first = expert.command
        if expert.study in STUDIES and expert.seed in (seeds := STUDIES[expert.study].seeds):
            others = [needed for _, needed in lacking if needed.study == expert.study]
            names = " ".join(dict.fromkeys(other.body for other in others))
            trials = max(seeds.index(other.seed) for other in others) + 1
            first = f"silem work {expert.study} --method ppo --body {names}"
            first += f" --budget {expert.budget.base_name} --trials {trials}"
        raise SilemError(
            f"{config.run_id} needs demonstrations of {config.demonstrations}, and the expert"
            f" {expert.run_id} is neither finished nor asked for; first: {first}"
        )
    files.check_locks(paths.runs_dir())


def work(
    configs: Sequence[RunConfig],
    minutes: float = math.inf,
    progress: bool = True,
    made: Callable[[RunRecord], None] = lambda record: None,
) -> None:
    """Make one run after another until none is left that nobody is at.

    Always the first in the order given whose lock is free, whose experts are finished, which has
    not failed, and which can reach a checkpoint in the time left, as far as its speed is known.

    `configs` are the runs of all that share the work; one under way stops at its last checkpoint
    within the `minutes`. `progress` shows a bar for each run, `made` is called with the record of
    each that this loop has finished.

    Raises SilemError as `check`, before anything starts; or some of the runs have failed, after all
    others were made. Raises KeyboardInterrupt on Ctrl-C or SIGTERM, or when time is up.
    """
    until, pause_s = time.monotonic() + 60.0 * minutes, _POLL_S
    lost: list[str] = []
    try:
        with runs.stoppable():
            check(configs)
            while (one := _pass(configs, until, progress, made, lost)) is not None:
                # the file system is asked for thousands of files each time
                pause_s = _POLL_S if one else min(2 * pause_s, _LONGEST_POLL_S)
                time.sleep(0.0 if one else min(pause_s, max(until - time.monotonic(), 0.0)))
    except KeyboardInterrupt as interrupt:
        raise KeyboardInterrupt(f"{str(interrupt) or 'stopped'}; {_GOES_ON}") from None
    failed(configs, refuse=True)


def _pass(
    configs: Sequence[RunConfig],
    until: float,
    progress: bool,
    made: Callable[[RunRecord], None],
    lost: list[str],
) -> bool | None:
    """Make the first run that can be made; return whether any could, None if none ever can be."""
    left = [config for config in configs if not runs.is_finished(config)]
    step_s = speeds(configs) if until < math.inf else lambda config: None
    waiting = late = False
    experts_are: dict[str, set[str]] = {}  # by demonstrations
    for config in left:
        if runs.state(config) in ("running", "failed"):
            continue
        if (name := config.demonstrations) not in experts_are:
            experts_are[name] = {runs.state(expert) for expert in experts_of(config)}
        if "failed" in experts_are[name]:
            continue
        budget = config.budget
        segment_s = (step_s(config) or 0.0) * budget.checkpoint_every * budget.steps_per_iteration
        if experts_are[name] - {"finished"}:
            waiting = True
        elif time.monotonic() + segment_s > until:
            late = True
        elif record := _make(config, progress, until, lost):
            made(record)
            return True
    if late or (waiting and time.monotonic() > until):
        raise KeyboardInterrupt(f"time is up: {len(left)} of {len(configs)} runs are left")
    return False if waiting else None


def _make(config: RunConfig, progress: bool, until: float, lost: list[str]) -> RunRecord | None:
    """Make a run, and first its demonstrations; None where somebody else does, or it has failed.

    `lost` are those that this loop has seen fail since one was finished. Raises SilemError: they
    are so many that the fault may be this machine's.
    """
    try:
        if needed := experts_of(config):
            from silem.study.evaluate import demonstrate  # with all that learns

            record = runs.demonstrator(needed)
            demonstrate(record, name=config.demonstrations, progress=progress)
        record = runs.run(config, progress, until=until, starts=runs.STARTS)
        lost.clear()
        return record
    except files.Held:
        return None
    except Exception as error:  # whatever it is, the other runs go on
        if not isinstance(error, SilemError):
            traceback.print_exc()
        host = socket.gethostname()
        runs.fail(config, f"{reason(error)} (on {host})")
        lost.append(config.run_id)
        if len(lost) == _MOST_LOST:
            told = f"{len(lost)} runs in a row have failed on {host}, which may be its own fault"
            raise SilemError(f"{told}: {reason(error)} (--retry tries them again)") from error
        return None


def failed(configs: Sequence[RunConfig], *, refuse: bool = False) -> dict[str, str]:
    """Return why runs have failed, by run id; to `refuse` raises SilemError if any has."""
    reasons = {}
    for config in [config for config in configs if runs.state(config) == "failed"]:
        with suppress(FileNotFoundError):
            text = (runs.run_folder(config) / runs.FAILED).read_text(errors="replace")
            reasons[config.run_id] = reason(ValueError(text))
    if refuse and reasons:
        told = "; ".join(f"{name} failed: {why}" for name, why in reasons.items())
        raise SilemError(f"{told} (--retry tries again)")
    return reasons


# ---------------------------------------------------------------- several loops on one machine


def crew(
    words: Sequence[str],
    configs: Sequence[RunConfig],
    n: int,
    minutes: float = math.inf,
    progress: bool = True,
) -> None:
    """Let `n` processes work, each by the command line ``silem`` `words`, with one bar for all.

    However this process ends, they end with it. One that is killed is started again, for what is
    left of the `minutes`. Raises SilemError, KeyboardInterrupt: As `work`.
    """
    check(configs)
    until, log = time.monotonic() + 60.0 * minutes, paths.runs_dir() / "work.log"
    kills, next_shown = 0, 0.0
    loops: list[subprocess.Popen[bytes]] = []
    bar = tqdm(total=len(configs), desc="runs", unit="run", disable=not progress)
    try:
        with runs.stoppable(), bar:
            loops += [_start(words, until, log) for _ in range(n)]
            while any(loop.poll() is None or loop.returncode < 0 for loop in loops):
                for i in [i for i, loop in enumerate(loops) if (loop.poll() or 0) < 0]:
                    loops[i], kills = _start(words, until, log), kills + 1
                if kills > _MOST_KILLS * n:
                    raise SilemError(f"workers are killed again and again (log: {log})")
                if time.monotonic() >= next_shown:
                    _show(bar, configs)
                    next_shown = time.monotonic() + _SHOWN_EVERY_S
                time.sleep(_POLL_S / 4)
            _show(bar, configs)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped all workers at their checkpoints; {_GOES_ON}") from None
    finally:
        for loop in loops:
            loop.terminate()
        for loop in loops:
            loop.wait()
    failed(configs, refuse=True)
    codes = [loop.returncode for loop in loops]
    if STOPPED in codes:
        raise KeyboardInterrupt(f"time is up; {_GOES_ON}")
    if any(codes):
        lines = log.read_text(errors="replace").strip().splitlines() or ["no message"]
        raise SilemError(f"workers ended with {codes}: {lines[-1]} (log: {log})")


def _start(words: Sequence[str], until: float, log: Path) -> subprocess.Popen[bytes]:
    """Start a loop whose input, a pipe, ends when this process does.

    It has a session of its own: Ctrl-C in the terminal reaches this process alone, which then
    stops each loop once.
    """
    command = [sys.executable, "-m", "silem", *words, "--quiet", "--with-input"]
    if until < math.inf:
        command += ["--minutes", str(max(1, math.ceil((until - time.monotonic()) / 60)))]
    with open(log, "ab") as stream:
        return subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=stream, stderr=stream,
            env=os.environ | environment(), start_new_session=True,
        )  # fmt: skip


def environment() -> dict[str, str]:
    """Return what a loop elsewhere needs of this process's environment."""
    moved = {"OMP_NUM_THREADS": "1", "SILEM_DATA_DIR": str(paths.data_dir())}
    if root := paths.checkout():
        there = os.environ.get("PYTHONPATH", "").split(os.pathsep)
        moved["PYTHONPATH"] = os.pathsep.join(filter(None, dict.fromkeys([str(root), *there])))
    return moved


def _show(bar: "tqdm[Any]", configs: Sequence[RunConfig]) -> None:
    if bar.disable:
        return
    left = [config for config in configs if not runs.is_finished(config)]
    bar.n = len(configs) - len(left)
    bar.set_postfix_str("; ".join(describe(c) for c in left if runs.state(c) == "running"))


# ---------------------------------------------------------------- what has been done


def progress_of(config: RunConfig) -> dict[str, Any]:
    """Return what an unfinished run last said of itself: iteration, return, wall time."""
    with suppress(SilemError):  # not there yet, or just gone
        said = files.read_json(runs.run_folder(config) / PROGRESS)
        if isinstance(said, dict) and {"iteration", "return", "wall_time_s"} <= said.keys():
            return said
    return {"iteration": 0, "return": None, "wall_time_s": 0.0}


def describe(config: RunConfig) -> str:
    """Say in a few words how far a run is."""
    said = progress_of(config)
    text = f"{config.run_id} {said['iteration']}/{config.budget.n_iterations}"
    return text if said["return"] is None else f"{text}, return {said['return']:.0f}"


def speeds(configs: Sequence[RunConfig]) -> Callable[[RunConfig], float | None]:
    """Return what tells how many seconds a step of a run takes, its evaluation included.

    That is measured: by the run itself, else by others of the same method and body, the same
    method, the same body, or any; None where nothing was measured.
    """
    spent: dict[tuple[str, str], list[float]] = defaultdict(list)

    def kinds(config: RunConfig) -> list[tuple[str, str]]:
        return [(method, body) for method in (config.method, "") for body in (config.body, "")]

    def measured(config: RunConfig) -> float | None:
        if runs.is_finished(config):
            record = runs.find(config.run_id)
            return record.wall_time_s / config.budget.n_steps if record else None
        said = progress_of(config)
        n_steps = said["iteration"] * config.budget.steps_per_iteration
        return said["wall_time_s"] / n_steps if n_steps else None

    for config in configs:
        enough = len(spent[config.method, config.body]) >= _ENOUGH or config.method == "random"
        if not enough and (one := measured(config)):
            for kind in kinds(config):
                spent[kind].append(one)

    def of(config: RunConfig) -> float | None:
        found = next((spent[kind] for kind in kinds(config) if spent.get(kind)), [])
        return measured(config) or (mean(found) if found else None)

    return of


def status(study: str, budget: Budget, *which: int | None) -> str:
    """Return what has been done of a study: cells by trials, who is at what, failures, time left.

    `which` are numbers of trials and cells, as in `silem.study.studies.narrowed`.
    """
    part = narrowed(study, budget, *which)
    seeds, shown = part.seeds, part.cells
    names = [" from ".join(filter(None, (f"{c.method} {c.body}", c.demonstrations))) for c in shown]
    several = {name for name, count in Counter(names).items() if count > 1}
    rows = [[cell.config(budget, seed) for seed in seeds] for cell in shown]
    configs = [config for trial in zip(*rows, strict=True) for config in trial]
    states = {config.run_id: runs.state(config) for config in configs}
    titles = [
        name + "".join(f" {k}={v}" for k, v in (cell.overrides if name in several else ()))
        for cell, name in zip(shown, names, strict=True)
    ]
    width = max(map(len, titles), default=0) + 2
    lines = [f"{study}, budget {budget.name}, trials by seed:"]
    lines.append((" " * width + "".join(f"{seed:<10}" for seed in seeds)).rstrip())
    for title, row in zip(titles, rows, strict=True):
        told = "".join(f"{states[config.run_id]:<10}" for config in row)
        lines.append(f"{title:{width}}{told}".rstrip())
    at_work = [config for config in configs if states[config.run_id] == "running"]
    for config in at_work:
        lock = runs.run_folder(config) / runs.LOCK
        lines.append(f"at work: {describe(config)} ({files.holder(lock)})")
    lines += [f"failed: {name}: {why}" for name, why in failed(configs).items()]
    left = [c for c in configs if states[c.run_id] not in ("finished", "failed")]
    told = f"left: {len(left)} of {len(configs)} runs"
    if learning := [config for config in left if config.method != "random"]:
        step_s, hours = speeds(configs), 0.0
        for config in learning:
            done = progress_of(config)["iteration"] * config.budget.steps_per_iteration
            hours += (step_s(config) or math.nan) * (config.budget.n_steps - done) / 3600
        if math.isnan(hours):
            told += ", an unknown time: no speed is measured yet"
        else:
            told += f", {hours:.1f} hours for one worker at the speed measured"
            told += f", {hours / len(at_work):.1f} for {len(at_work)}" if len(at_work) > 1 else ""
    return "\n".join([*lines, told])
