"""What work loops cost, and how fast thousands of records are read, in processor time.

    python -m benchmarks.campaign [--iterations 60] [--rounds 2] [--records 5000]

Two loops make the same two runs as two bare processes side by side: first one, then the other,
several rounds. Then a made-up study of so many records is read as `silem status` and the book do.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np

from silem.report.results import load_records
from silem.study import work
from silem.study.config import TRIAL_SEEDS, RunConfig
from silem.study.runs import CURVE, POLICY, RECORD, TRANSFORM, RunRecord, curve_csv, curve_row
from silem.study.settings import BUDGETS
from silem.study.studies import STUDIES, Cell, Study, study_configs
from silem.util import files, paths

BODIES = ("HC0", "HC1")


def processor_s(processes: Callable[[], list[subprocess.Popen[bytes]]]) -> float:
    """Return the processor time of processes and all that they start, in an empty data folder."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["SILEM_DATA_DIR"] = folder
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        for process in processes():
            if process.wait():
                raise SystemExit(f"{process.args!r} failed")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def silem(*words: str) -> subprocess.Popen[bytes]:
    """Start a command."""
    return subprocess.Popen([sys.executable, "-m", "silem", *words, "--quiet"], stdout=-3)


def overhead(iterations: int, rounds: int) -> None:
    """Compare two loops with two bare runs."""
    counts = ("--budget", "quick", "--iterations", str(iterations))
    bare: list[float] = []
    loops: list[float] = []
    words = ("work", "halfcheetah", "--method", "ppo", "--body", *BODIES, *counts, "--workers", "2")

    def runs() -> list[subprocess.Popen[bytes]]:
        return [silem("run", "--body", body, "--method", "ppo", *counts) for body in BODIES]

    for _ in range(rounds):
        bare.append(processor_s(runs))
        loops.append(processor_s(lambda: [silem(*words)]))
    share = median(bare) / median(loops)
    print(f"two bare runs {median(bare):.1f} s, two loops {median(loops):.1f} s: {share:.1%}")


def made_up(n: int) -> None:
    """Define a study of `n` runs and write their records, each whole and true to itself."""
    settings = [(("learning_rate", 1e-4 * (1 + i / n)),) for i in range(n // len(TRIAL_SEEDS))]
    cells = tuple(Cell("made-up", "silem", f"HC{i % 3}", "HC0", s) for i, s in enumerate(settings))
    STUDIES["made-up"] = Study(cells, TRIAL_SEEDS, "as many as wanted")
    steps = BUDGETS["book"].steps_per_iteration
    rows = np.array([curve_row(i, i * steps, {"return_mean": 1.0}) for i in range(1, 801)])
    template = paths.data_dir() / "template"
    files.write_text(template / CURVE, curve_csv(rows))
    files.write_npz(template / TRANSFORM, {"A": np.ones(26), "b": np.zeros(26)})
    for config in study_configs("made-up", "book"):
        folder = paths.results_dir("made-up") / config.run_id
        folder.mkdir(parents=True)
        files.write_tensors(template / POLICY, {"w": np.zeros(9000)}, {"run_id": config.run_id})
        for path in template.iterdir():
            (folder / path.name).write_bytes(path.read_bytes())
        record = made_up_record(config, folder)
        content = dataclasses.asdict(record)
        del content["folder"]
        (folder / RECORD).write_text(json.dumps(content, indent=2))


def made_up_record(config: RunConfig, folder: Path) -> RunRecord:
    """Return a record that agrees with itself."""
    returns = [1000.0 + i for i in range(config.budget.n_eval_episodes)]
    evaluation = {
        "n_episodes": len(returns), "return_mean": float(np.mean(returns)),
        "return_std": float(np.std(returns)), "returns": returns, "speed_m_s": 1.0,
        "upright": 1.0, "disc_reward_mean": 400.0,
    }  # fmt: skip
    hashes = {name: files.sha256(folder / name) for name in (CURVE, POLICY, TRANSFORM)}
    training = {"n_steps": config.budget.n_steps, "steps_per_s": 2400.0}
    source = {"git_commit": "0" * 40, "git_dirty": False, "packages": {}}
    return RunRecord(
        config.run_id, "finished", config.to_dict(), evaluation, training, source, "0" * 64, 700.0,
        hashes, folder, 650.0,
    )  # fmt: skip


def reading(n: int) -> None:
    """Time `silem status` and the study's frame."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["SILEM_DATA_DIR"] = folder
        made_up(n)
        for name, read in (
            ("status", lambda: work.status("made-up", BUDGETS["book"])),
            ("the study's frame", lambda: load_records("made-up", "book")),
        ):
            start = time.process_time()
            found = read()
            taken = time.process_time() - start
            whole = found.count("finished") if isinstance(found, str) else len(found)
            print(f"{name}: {whole} records in {taken:.2f} s")


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--iterations", type=int, default=60, help="default: %(default)s")
    parser.add_argument("--rounds", type=int, default=2, help="default: %(default)s")
    parser.add_argument("--records", type=int, default=5000, help="default: %(default)s")
    options = parser.parse_args()
    if options.records:
        reading(options.records)
    if options.rounds:
        overhead(options.iterations, options.rounds)


if __name__ == "__main__":
    main()
