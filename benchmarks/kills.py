"""Kill runs at random with ``kill -9``, and compare what is left with what unharmed ones leave.

``python -m benchmarks.kills --kills 100`` makes an expert, its demonstrations and an imitator from
them, again and again, at a tiny budget whose runs are published as evidence. The process at work
is killed at a random moment, or within a random write to the disk, and started again until it ends.
With ``--work`` it is ``silem work`` with two workers and eight runs, or a worker of it.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any

import numpy as np

from silem.motion import demonstrations as demos
from silem.study import evaluate, runs, training
from silem.study.config import RunConfig
from silem.study.runs import CHECKPOINT, RECORD, RunRecord
from silem.study.settings import BUDGETS, Budget
from silem.util import files, paths

PHASES = ("starting", "training", "evaluation", "publishing", "recording demonstrations")
SMALL: dict[str, Any] = {"minibatch_size": 32, "n_epochs": 2}
Phase = Any  # a shared whole number, which typeshed has no name for at run time


def work(phase: Phase) -> None:
    """Make everything that is not there yet."""
    expert = runs.run(RunConfig.create("HC0", "ppo", None, "book", 0, **SMALL), progress=False)
    phase.value = PHASES.index("recording demonstrations")
    evaluate.demonstrate(expert, 2)
    phase.value = 0
    imitator = RunConfig.create("HC0", "silem", None, "book", 0, n_trajectories=2, **SMALL)
    runs.run(imitator, progress=False)


def told(phase: Phase, index: int, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that says in which phase it is."""

    def call(*arguments: Any, **options: Any) -> Any:
        phase.value = index
        return function(*arguments, **options)

    return call


def worker(phase: Phase, deadly_write: int | None) -> None:
    """Work in a process of its own; die within the given write to the disk, if any."""
    homes = ((training, "train"), (evaluate, "evaluate"), (RunRecord, "save"))
    for index, (home, name) in enumerate(homes, 1):
        setattr(home, name, told(phase, index, getattr(home, name)))
    left = deadly_write

    def deadly(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            nonlocal left
            if left is not None:
                left -= 1
                if left < 0:
                    os.kill(os.getpid(), signal.SIGKILL)
            return function(*arguments, **options)

        return call

    for name in ("fsync", "replace"):
        setattr(os, name, deadly(getattr(os, name)))
    work(phase)


def outcome() -> dict[str, Any]:
    """Return all that must not depend on kills: every file's name, and what it holds."""
    found: dict[str, Any] = {}
    for path in sorted(paths.data_dir().rglob("*")):
        name = str(path.relative_to(paths.data_dir()))
        if path.name == RECORD:
            content = files.read_json(path)
            found[name] = [content[key] for key in ("run_id", "evaluation", "config", "files")]
        elif path.name == CHECKPOINT:
            arrays, _ = files.read_tensors(path)
            found[name] = {key: array.tobytes() for key, array in arrays.items()}
        elif path.is_file():
            lock = path.suffix == ".lock"  # holds the last process's number
            found[name] = "" if lock else hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def one_round(
    rng: np.random.Generator, longest_s: float, n_writes: int, most: int
) -> tuple[dict[str, Any], Counter[str]]:
    """Kill and go on until everything is made; return what is there and when the kills came."""
    kills: Counter[str] = Counter()
    context = multiprocessing.get_context("fork")
    while True:
        spared = kills.total() >= most
        in_a_write = not spared and rng.random() < 0.5
        phase: Synchronized[int] = context.Value("i", 0)
        process = context.Process(
            target=worker, args=(phase, int(rng.integers(n_writes)) if in_a_write else None)
        )
        process.start()
        process.join(None if spared or in_a_write else rng.uniform(0, longest_s))
        process.kill()
        process.join()
        if process.exitcode == 0:
            return outcome(), kills
        if process.exitcode != -signal.SIGKILL:
            raise SystemExit(f"a worker failed with exit code {process.exitcode}")
        kills[PHASES[phase.value]] += 1


WORK = ["work", "halfcheetah", "--body", "HC0", "--budget", "tiny", "--trials", "2", "--quiet"]
WORK += ["--method", "ppo", "silem", "silem-minus", "random", "--workers", "2", "--retry"]


def workers() -> list[int]:
    """Return the processes of workers that are at work in this data folder."""
    wanted, found = f"SILEM_DATA_DIR={paths.data_dir()}".encode(), []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
            if b"--with-input" in words and wanted in (folder / "environ").read_bytes():
                found.append(int(folder.name))
        except OSError:  # ended meanwhile
            continue
    return found


def crew_round(
    rng: np.random.Generator, longest_s: float, most: int
) -> tuple[dict[str, Any], Counter[str]]:
    """Kill the scheduler, or workers of it, and go on until everything is made."""
    kills: Counter[str] = Counter()
    while True:
        process = subprocess.Popen([sys.executable, "-m", "silem", *WORK])
        while kills.total() < most:
            try:
                process.wait(rng.uniform(0, longest_s))
                break
            except subprocess.TimeoutExpired:
                at_work = workers()
            if not at_work or rng.random() < 0.5:
                process.kill()
                kills["scheduler"] += 1
                break
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(rng.choice(at_work)), signal.SIGKILL)
                kills["worker"] += 1
        if process.wait() == 0:
            return outcome(), kills
        # 2: a run was killed five times at one checkpoint, which --retry forgives
        if process.returncode not in (-signal.SIGKILL, 2):
            raise SystemExit(f"work failed with exit code {process.returncode}")
        for _ in range(600):
            if not workers():
                break
            time.sleep(0.1)
        else:
            raise SystemExit("workers go on a minute after their scheduler was killed")


def crews(n_kills: int, rng: np.random.Generator) -> None:
    """Kill schedulers and their workers, round after round."""
    kills, n_rounds = Counter[str](), 0
    with tempfile.TemporaryDirectory() as folder:
        os.environ["SILEM_DATA_DIR"] = folder
        began = time.perf_counter()
        reference, _ = crew_round(rng, 0.0, 0)
        longest_s = (time.perf_counter() - began) / 6
        while kills.total() < n_kills:
            shutil.rmtree(folder)
            Path(folder).mkdir()
            found, came = crew_round(rng, longest_s, min(25, n_kills - kills.total()))
            kills += came
            n_rounds += 1
            names = [k for k in reference | found if reference.get(k) != found.get(k)]
            if names := [name for name in names if not name.endswith(("work.log", ".lock"))]:
                raise SystemExit(f"after {dict(came)} these differ: {', '.join(names)}")
            print(f"{kills.total()} kills, {n_rounds} rounds", flush=True)
    print(f"{dict(kills)} in {n_rounds} rounds: same bits, nothing left over, nobody left alone")


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--kills", type=int, default=100, help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="default: %(default)s")
    parser.add_argument("--work", action="store_true", help="kill `silem work` and its workers")
    options = parser.parse_args()
    if options.work:
        crews(options.kills, np.random.default_rng(options.seed))
        return
    BUDGETS["book"] = Budget("book", 2, 128, 6, 1, 2, 2)
    rng = np.random.default_rng(options.seed)
    kills: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["SILEM_DATA_DIR"] = folder
        began = time.perf_counter()
        reference, _ = one_round(rng, 0.0, 1, 0)
        longest_s, n_rounds = time.perf_counter() - began, 0
        # Every write reaches fsync twice and replace once. Half of what an unharmed round takes:
        # later ones of a round have less to do.
        longest_s, n_writes = longest_s / 2, 3 * len(reference) // 2
        while kills.total() < options.kills:
            shutil.rmtree(folder)
            Path(folder).mkdir()
            found, came = one_round(
                rng, longest_s, n_writes, min(20, options.kills - kills.total())
            )
            kills += came
            n_rounds += 1
            if found != reference:
                names = [k for k in reference | found if reference.get(k) != found.get(k)]
                raise SystemExit(f"after {dict(came)} these differ: {', '.join(names)}")
            print(f"{kills.total()} kills, {n_rounds} rounds", flush=True)
        assert demos.is_published("HC0")
    when = ", ".join(f"{kills[name]} {name}" for name in PHASES)
    print(f"{kills.total()} kills in {n_rounds} rounds ({when}): same bits, nothing left over")


if __name__ == "__main__":
    main()
