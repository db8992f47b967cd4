"""Campaigns: many runs on one machine, in a pool of worker processes.

Every worker is one ``silem ...`` command. A worker that is killed is started again and goes on from
its checkpoint; a campaign that is stopped goes on where it was when asked for again. However it
ends, its workers end with it.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence, Set
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from silem import bodies
from silem.motion.demonstrations import is_published
from silem.study import demonstrate, runs
from silem.study.checkpoint import CHECKPOINT, PROGRESS
from silem.study.config import RunConfig
from silem.study.record import RunRecord
from silem.study.settings import expert_of
from silem.util import files, paths
from silem.util.errors import SilemError

_POLL_S = 0.2
MAX_KILLS = 5
"""How often in a row a worker may be killed before its checkpoint advances, or its task failed."""


@dataclass
class Task:
    """One command for a worker."""

    name: str  # a run's id, or "demonstrations HC0"
    arguments: list[str]  # what follows ``silem``
    folder: Path  # where its log goes and its progress file and checkpoint may stand
    needs: set[str]  # names of the tasks that must be done before


def plan(configs: Sequence[RunConfig]) -> list[Task]:
    """Return the commands that are still to be run, each after what it needs.

    An imitator whose demonstrations are not there yet waits for the experts that the demonstrator
    is chosen from (see `demonstrate.demonstrator`) and for its recording.

    Raises:
        SilemError: Demonstrations are missing whose expert is neither finished nor among
            `configs`; or a finished run was made with others than those there are now.
    """
    tasks: dict[str, Task] = {}
    waiting = {config.run_id: config for config in configs if runs.finished(config) is None}
    for run_id, config in waiting.items():
        needs = set()
        if config.demonstrations and not is_published(config.demonstrations):
            recording = _recording(config, waiting.keys())
            tasks.setdefault(recording.name, recording)
            needs.add(recording.name)
        folder = runs.run_folder(config)
        arguments = ["run", "--wait", "--config", str(folder / "config.json")]
        tasks[run_id] = Task(run_id, arguments, folder, needs)
    for config in waiting.values():
        files.write_json(runs.run_folder(config) / "config.json", config.to_dict())
    return list(tasks.values())


def _recording(config: RunConfig, waiting: Set[str]) -> Task:
    """Return the task that records the demonstrations that a run needs."""
    name, budget = config.demonstrations, config.budget.base_name
    body, trial = expert_of(name)
    runs.check_made_by_an_expert(body)
    needed = [e for e in demonstrate.experts(body, budget) if trial in (None, e.seed)]
    for expert in needed:
        if expert.run_id not in waiting and runs.find(expert.run_id) is None:
            raise SilemError(
                f"{config.run_id} needs demonstrations of {name}, and the expert {expert.run_id} is"
                f" neither finished nor part of this campaign; first: {expert.command}"
            )
    arguments = ["demonstrations", "--body", body, "--budget", budget]
    if trial is not None:
        arguments += ["--trial", str(trial)]
    folder = paths.runs_dir() / config.study / f"demonstrations_{name}"
    needs = {expert.run_id for expert in needed} & waiting
    return Task(f"demonstrations {name}", arguments, folder, needs)


def campaign(
    configs: Sequence[RunConfig], n_workers: int = 2, progress: bool = True
) -> list[RunRecord]:
    """Make every run that is not finished yet, in the order given, and return all records.

    Args:
        configs: The runs.
        n_workers: Worker processes at a time; each keeps one core busy.
        progress: Show one overall bar, and a line per running run.

    Raises:
        SilemError: As `plan`, before anything starts; or some runs failed, after all others were
            finished.
        KeyboardInterrupt: On Ctrl-C or SIGTERM, after the workers were stopped.
    """
    if n_workers < 1:
        raise SilemError(f"workers must be 1 or more, not {n_workers}")
    pool = _Pool(plan(configs), n_workers, progress, total=len(configs))
    try:
        with runs.sigterm_as_interrupt():
            pool.work()
    except KeyboardInterrupt:
        message = "stopped the campaign and its workers; the same command goes on"
        raise KeyboardInterrupt(message) from None
    if pool.failures:
        raise SilemError("; ".join(pool.failures.values()))
    return [record for config in configs if (record := runs.finished(config)) is not None]


class _Pool:
    """The tasks under way, and what came of those before."""

    def __init__(self, tasks: list[Task], n_workers: int, progress: bool, total: int) -> None:
        self.failures: dict[str, str] = {}
        self._pending = tasks
        self._done: set[str] = set()
        self._running: dict[str, _Worker] = {}
        self._n_workers = n_workers
        todo = sum(task.arguments[0] == "run" for task in tasks)
        hidden = not progress
        self._overall = tqdm(
            total=total, initial=total - todo, desc="runs", unit="run", disable=hidden
        )
        self._lines = [
            tqdm(total=0, position=i + 1, bar_format="{desc}", disable=hidden, leave=False)
            for i in range(n_workers)
        ]

    def work(self) -> None:
        """Run everything; stops the workers when interrupted."""
        try:
            while self._pending or self._running:
                self._start_ready()
                time.sleep(_POLL_S)
                for worker in list(self._running.values()):
                    if worker.ended():
                        del self._running[worker.task.name]
                        self._settle(worker.task, worker.failure)
                lines = [_describe(worker.task) for worker in self._running.values()]
                for i, bar in enumerate(self._lines):
                    bar.set_description_str(lines[i] if i < len(lines) else "")
                self._overall.refresh()
        except BaseException:
            for worker in self._running.values():
                worker.process.send_signal(signal.SIGTERM)
            for worker in self._running.values():
                worker.process.wait()
            raise
        finally:
            for bar in (*self._lines, self._overall):
                bar.close()

    def _start_ready(self) -> None:
        for task in list(self._pending):
            if len(self._running) == self._n_workers:
                return
            if broken := task.needs & self.failures.keys():
                self._pending.remove(task)
                self._settle(task, f"{task.name} needs {', '.join(sorted(broken))}, which failed")
            elif task.needs <= self._done:
                self._pending.remove(task)
                self._running[task.name] = _Worker(task)

    def _settle(self, task: Task, failure: str) -> None:
        if failure:
            self.failures[task.name] = failure
            self._overall.write(failure)
        else:
            self._done.add(task.name)
            self._overall.update(task.arguments[0] == "run")


class _Worker:
    """A process that does a task, and the next one after each that was killed."""

    def __init__(self, task: Task) -> None:
        self.task, self.failure = task, ""
        self._kills, self._log = 0, task.folder / "log.txt"
        self._start()

    def _start(self) -> None:
        command = [sys.executable, "-m", "silem", *self.task.arguments, "--quiet", "--with-input"]
        for module in sorted({bodies.module_of(name) for name in bodies.names()} - {""}):
            command += ["--import", module]
        moved = {"OMP_NUM_THREADS": "1", "SILEM_DATA_DIR": str(paths.data_dir())}
        if root := paths.checkout():
            moved["PYTHONPATH"] = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
        self.task.folder.mkdir(parents=True, exist_ok=True)
        self._reached = self._checkpoint()
        # A session of its own: Ctrl-C in the terminal reaches the campaign alone, which then stops
        # each worker once. Its input is a pipe that ends when the campaign does.
        with open(self._log, "wb") as stream:
            self.process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=stream, stderr=stream,
                env=os.environ | moved, start_new_session=True,
            )  # fmt: skip

    def _checkpoint(self) -> int:
        path = self.task.folder / CHECKPOINT
        return path.stat().st_mtime_ns if path.exists() else 0

    def ended(self) -> bool:
        """Return whether the task is done, or failed for the reason then in `failure`."""
        code, name = self.process.poll(), self.task.name
        if code is None:
            return False
        if code > 0:
            lines = self._log.read_text(errors="replace").strip().splitlines() or ["no message"]
            self.failure = f"{name} failed: {lines[-1]} (log: {self._log})"
        elif code < 0:
            self._kills = self._kills + 1 if self._checkpoint() == self._reached else 0
            if self._kills < MAX_KILLS:
                self._start()
                return False
            self.failure = f"{name} was killed {MAX_KILLS} times without getting on"
        return True


def _describe(task: Task) -> str:
    try:
        state = json.loads((task.folder / PROGRESS).read_text())
    except (OSError, ValueError):  # not there yet, or just gone
        return f"  {task.name}"
    value = state["return"]
    shown = "" if value is None else f", return {value:.0f}"
    return f"  {task.name}: {state['iteration']}/{state['n_iterations']} iterations{shown}"
