"""Execute notebooks with papermill, a few at a time, each in a process of its own."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from silem.util.errors import SilemError

CELL_TIMEOUT_S = 900

Parameters = Mapping[str, Mapping[str, Any]]
"""By the notebook's name, the parameters that differ from its defaults."""


@dataclass(frozen=True)
class Execution:
    """What came of executing one notebook.

    Attributes:
        name: The notebook's file name without its suffix.
        seconds: Wall time, the kernel's start included.
        error: The end of papermill's report, empty if the notebook ran through.
    """

    name: str
    seconds: float
    error: str


def execute(notebook: Path, target: Path, parameters: Mapping[str, Any]) -> Execution:
    """Execute one notebook with papermill.

    Args:
        notebook: The notebook, which is left as it is.
        target: The executed copy; written even if a cell fails, for a look at the failure.
        parameters: Those that differ from the notebook's defaults.
    """
    command = [sys.executable, "-m", "papermill", "--no-progress-bar", "--kernel", "python3"]
    command += ["--cwd", str(notebook.parent), "--execution-timeout", str(CELL_TIMEOUT_S)]
    for name, value in parameters.items():
        command += ["-p", name, str(value)]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYDEVD_DISABLE_FILE_VALIDATION": "1"}
    started = time.perf_counter()
    done = subprocess.run(
        [*command, str(notebook), str(target)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    error = done.stderr.strip()[-3000:] if done.returncode else ""
    return Execution(notebook.stem, time.perf_counter() - started, error)


def execute_notebooks(
    paths: Sequence[Path], folder: Path, n_workers: int, parameters: Parameters
) -> list[Execution]:
    """Execute notebooks side by side, with a progress bar.

    Args:
        paths: The notebooks.
        folder: Receives the executed copies; what it held before is removed.
        n_workers: How many run at a time, each in a process of its own.
        parameters: By the notebook's name, those that differ from its defaults.

    Returns:
        One entry per notebook, in the order of `paths`.

    Raises:
        SilemError: If a notebook failed, once all have run; the message holds each failure.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    bar = tqdm(total=len(paths), desc="notebooks", unit="page")
    done: dict[str, Execution] = {}
    with bar, ThreadPoolExecutor(n_workers) as pool:
        futures = [
            pool.submit(execute, path, folder / path.name, parameters.get(path.stem, {}))
            for path in paths
        ]
        for future in as_completed(futures):
            execution = future.result()
            done[execution.name] = execution
            state = "FAILED" if execution.error else "done"
            bar.write(f"  {execution.name:<20} {execution.seconds:6.1f} s  {state}")
            bar.update()
    failures = [f"{name} failed:\n{e.error}" for name, e in sorted(done.items()) if e.error]
    if failures:
        raise SilemError("\n\n".join(failures))
    return [done[path.stem] for path in paths]
