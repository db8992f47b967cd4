"""Build the book: execute the notebooks, stage them with the prose, run jupyter-book.

``python -m silem.report.bookbuild`` is what ``make book`` calls. The three steps are separate:

1. papermill executes every notebook in its own process, a few at a time (`execute_notebooks`);
2. the executed copies and ``book/`` are laid out as one source tree in ``_build/source``
   (`stage`), so that a page has the same path in the repository and in the book;
3. jupyter-book turns that tree into ``_build/html`` with execution off (`build_html`).

A failing notebook or a Sphinx warning fails the build.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import nbformat
from tqdm import tqdm

from silem.errors import SilemError
from silem.files import lock, write_json
from silem.paths import REPO, data_dir

BUILD = REPO / "_build"
HTML = BUILD / "html"
EXECUTED = BUILD / "executed"
SOURCE = BUILD / "source"
STATE = BUILD / "book.json"

CELL_TIMEOUT_S = 300

BOOK_PARAMETERS: Mapping[str, Mapping[str, Any]] = {
    "01_bodies": {"video_s": 4.0},
    "02_experts": {"video_s": 5.0},
    "04_imitate": {"video_s": 4.0},
    "05_halfcheetah": {"video_s": 6.0},
}
"""Parameters that differ from a notebook's defaults, which are made for tests."""


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


def notebooks() -> list[Path]:
    """Return the book's notebooks in their order."""
    return sorted((REPO / "notebooks").glob("[0-9][0-9]_*.ipynb"))


def execute(notebook: Path, target: Path) -> Execution:
    """Execute one notebook with papermill and the book's parameters.

    Args:
        notebook: The notebook, which is left as it is.
        target: The executed copy; written even if a cell fails, for a look at the failure.
    """
    command = [sys.executable, "-m", "papermill", "--no-progress-bar", "--kernel", "python3"]
    command += ["--cwd", str(notebook.parent), "--execution-timeout", str(CELL_TIMEOUT_S)]
    for name, value in BOOK_PARAMETERS.get(notebook.stem, {}).items():
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


def execute_notebooks(paths: Sequence[Path], folder: Path, n_workers: int) -> list[Execution]:
    """Execute notebooks side by side, with a progress bar.

    Args:
        paths: The notebooks.
        folder: Receives the executed copies; what it held before is removed.
        n_workers: How many run at a time, each in a process of its own.

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
        futures = [pool.submit(execute, path, folder / path.name) for path in paths]
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


_FOLDED = {
    "parameters": "Show the parameters",
    "injected-parameters": "Show the parameters set for this book",
}


def fold_parameters(notebook: nbformat.NotebookNode) -> None:
    """Fold away the cells with a notebook's parameters, papermill's own one included, in place."""
    for cell in notebook.cells:
        tags = cell.metadata.get("tags", [])
        for tag in _FOLDED.keys() & set(tags):
            cell.metadata["tags"] = [*tags, *({"hide-input"} - set(tags))]
            cell.metadata["mystnb"] = {"code_prompt_show": _FOLDED[tag]}


def stage(executed: Path, target: Path) -> None:
    """Lay out the sources of the book: configuration, prose and executed notebooks.

    Args:
        executed: The folder of executed notebooks.
        target: The source tree for jupyter-book; replaced.
    """
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(REPO / "book", target / "book", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("_config.yml", "_toc.yml"):
        shutil.copy2(REPO / name, target / name)
    (target / "notebooks").mkdir()
    for path in sorted(executed.glob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        fold_parameters(notebook)
        nbformat.write(notebook, target / "notebooks" / path.name)


def build_html(source: Path, output: Path) -> None:
    """Run jupyter-book on a staged source tree, warnings being errors.

    Args:
        source: The staged source tree.
        output: The folder under which ``_build/html`` appears; an older build is replaced.

    Raises:
        SilemError: If jupyter-book reports an error or a warning.
    """
    for stale in ("html", ".doctrees", "jupyter_execute"):
        shutil.rmtree(output / "_build" / stale, ignore_errors=True)
    program = Path(sys.executable).with_name("jupyter-book")
    command = [str(program), "build", str(source), "--path-output", str(output)]
    command += ["-W", "-n", "--keep-going", "-q"]
    # sphinx-external-toc looks at every object there is, torch's deprecated ones included.
    environment = os.environ | {"PYTHONWARNINGS": "ignore::FutureWarning"}
    if subprocess.run(command, env=environment, check=False).returncode:
        raise SilemError("the book did not build; its warnings and errors are listed above")


def _files(folders: Iterable[Path]) -> list[Path]:
    found = [path for folder in folders for path in folder.rglob("*") if path.is_file()]
    return sorted(path for path in found if "__pycache__" not in path.parts)


def source_digest() -> str:
    """Return one SHA-256 over everything the book is made from: code, words, records."""
    folders = [REPO / name for name in ("book", "notebooks", "silem", "data/paper")]
    folders += [data_dir() / name for name in ("results", "demonstrations")]
    single = [REPO / name for name in ("_config.yml", "_toc.yml", "environment.txt")]
    digest = hashlib.sha256()
    for path in [*_files(folders), *single]:
        digest.update(str(path).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def is_current() -> bool:
    """Say whether ``_build/html`` was built, without failure, from what is here now."""
    if not (HTML / "index.html").exists() or not STATE.exists():
        return False
    return bool(json.loads(STATE.read_text())["digest"] == source_digest())


def build(n_workers: int = 2, reuse_executed: bool = False) -> Path:
    """Build the whole book.

    Args:
        n_workers: How many notebooks run at a time.
        reuse_executed: Take the notebooks executed last time, where there are any.

    Returns:
        The first page, ``_build/html/index.html``.

    Raises:
        SilemError: If a notebook or a page fails, or another build is under way.
    """
    with lock(BUILD / "book.lock"):
        STATE.unlink(missing_ok=True)
        digest = source_digest()
        if not (reuse_executed and any(EXECUTED.glob("*.ipynb"))):
            execute_notebooks(notebooks(), EXECUTED, n_workers)
        stage(EXECUTED, SOURCE)
        build_html(SOURCE, REPO)
        if not reuse_executed:
            write_json(STATE, {"digest": digest})
    return HTML / "index.html"


def main(arguments: Sequence[str] | None = None) -> int:
    """Build the book from the command line; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m silem.report.bookbuild", description=__doc__)
    parser.add_argument("--workers", type=int, default=2, help="notebooks at a time")
    parser.add_argument(
        "--reuse-executed", action="store_true", help="take the notebooks executed last time"
    )
    options = parser.parse_args(arguments)
    started = time.perf_counter()
    try:
        first_page = build(options.workers, options.reuse_executed)
    except SilemError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    seconds = time.perf_counter() - started
    print(f"The book is built ({seconds:.0f} s). Open {first_page}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
