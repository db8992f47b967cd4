"""Build the book: execute the notebooks, stage them with the prose, run jupyter-book.

``python -m silem.report.build`` is what ``make book`` calls; with ``--figures`` it redraws instead
the committed figures, with ``--pdf`` it prints the book to one file, with ``--film`` it films a run
for the slider. Executed notebooks and ``book/`` are laid out as one source tree, so that a page has
the same path in the repository and in the book. A failing notebook or a Sphinx warning fails the
build.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import nbformat
from tqdm import tqdm

from silem.report import glance, pdf, reads, web
from silem.report.notebook import NO_RUNS
from silem.report.pages import slider
from silem.util.errors import SilemError
from silem.util.files import lock
from silem.util.paths import REPO

Parameters = Mapping[str, Mapping[str, Any]]
"""By the notebook's name, the parameters that differ from its defaults."""

BOOK_PARAMETERS: Parameters = {
    "01_bodies": {"video_s": 6.0},
    "02_experts": {"budget": "quick", "video_s": 6.0},
    "04_imitate": {"body": "HC0", "budget": "quick", "video_s": 6.0},
    "05_halfcheetah": {"video_s": 7.0},
    "09_demonstration": {"video_s": 60.0},  # all of it
    "10_humanoids": {"n_episodes": 100, "video_s": 2.0},
    "11_retargeting": {"film_all": True, "video_s": 2.3},
    "12_walking": {"budget": "book", "n_episodes": 4, "video_s": 6.0},
    "13_demonstrators": {"video_s": 6.0},
    "14_ants": {"video_s": 6.0},
    "16_any_body": {"budget": "quick", "steps": 20_000, "video_s": 6.0},
    "17_beyond": {"n_episodes": 20},
}
"""The book's own; the notebooks' defaults are made for tests."""

_CELL_TIMEOUT_S = 900
_FOLDED = {
    "parameters": "Show the parameters",
    "injected-parameters": "Show the parameters set for this book",
}


def notebooks() -> list[Path]:
    """Return the book's notebooks in their order."""
    return sorted((REPO / "notebooks").glob("[0-9][0-9]_*.ipynb"))


def execute(paths: Sequence[Path], folder: Path, n_workers: int, parameters: Parameters) -> None:
    """Execute notebooks side by side, each in a process of its own, with a progress bar.

    The folder receives the executed copies, failed ones too. One that it already holds stays if
    neither the notebook nor anything that it read has changed; all else there is removed. Once all
    have run, a SilemError holds each failure.
    """
    folder.mkdir(parents=True, exist_ok=True)
    fresh = [p for p in paths if reads.is_fresh(p, folder / p.name, parameters.get(p.stem, {}))]
    paths = [path for path in paths if path not in fresh]
    for old in folder.iterdir():
        if old.name.partition(".")[0] not in {path.stem for path in fresh}:
            old.unlink()
    failures: dict[str, str] = {}
    bar = tqdm(total=len(paths), desc="notebooks", unit="page")
    with bar, ThreadPoolExecutor(n_workers) as pool:
        futures = {
            pool.submit(_papermill, path, folder / path.name, parameters.get(path.stem, {})): path
            for path in paths
        }
        for future in as_completed(futures):
            name, (seconds, error) = futures[future].stem, future.result()
            failures |= {name: error} if error else {}
            bar.write(f"  {name:<20} {seconds:6.1f} s  {'FAILED' if error else 'done'}")
            bar.update()
    if failures:
        raise SilemError("\n\n".join(f"{n} failed:\n{e}" for n, e in sorted(failures.items())))


def _papermill(notebook: Path, target: Path, parameters: Mapping[str, Any]) -> tuple[float, str]:
    """Execute one notebook; return the seconds it took and the end of its error, "" for none."""
    command = [sys.executable, "-m", "papermill", "--no-progress-bar", "--kernel", "python3"]
    command += ["--cwd", str(notebook.parent), "--execution-timeout", str(_CELL_TIMEOUT_S)]
    for name, value in parameters.items():
        command += ["-p", name, str(value)]
    command += [str(notebook), str(target)]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYDEVD_DISABLE_FILE_VALIDATION": "1"}
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as noted:
        environment |= reads.watching(Path(noted))
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if not done.returncode:
            reads.keep(notebook, target, parameters, Path(noted))
    error = (done.stderr.strip() or "no message")[-3000:] if done.returncode else ""
    return time.perf_counter() - started, error


def stage(executed: Path, target: Path) -> None:
    """Lay out the book's sources anew: configuration, prose, notebooks with parameters folded."""
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(REPO / "book", target / "book", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("_config.yml", "_toc.yml"):
        shutil.copy2(REPO / name, target / name)
    (target / "notebooks").mkdir()
    for path in sorted(executed.glob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        for cell in notebook.cells:
            tags = cell.metadata.get("tags", [])
            for tag in _FOLDED.keys() & set(tags):
                cell.metadata["tags"] = [*tags, *({"hide-input"} - set(tags))]
                cell.metadata["mystnb"] = {"code_prompt_show": _FOLDED[tag]}
        notebook.cells = list(_with_something_to_show(notebook.cells))
        nbformat.write(notebook, target / "notebooks" / path.name)


def _with_something_to_show(cells: Sequence[Any]) -> Iterator[Any]:
    """Leave out the cells that show runs, where the last that asked for some found none."""
    empty = False
    for cell in cells:
        tags = cell.metadata.get("tags", [])
        if "needs-runs" in tags:
            empty = NO_RUNS in str(cell.outputs)
        if not empty or "with-runs" not in tags:
            yield cell


def sphinx(source: Path, output: Path, builder: str = "html") -> Path:
    """Run jupyter-book on a staged source tree, into a builder's folder, which is returned.

    HTML's warnings are errors; the single page of a PDF repeats them. SilemError if it fails.
    """
    pages = output / "_build" / builder
    for stale in (builder, ".doctrees", "jupyter_execute"):
        shutil.rmtree(pages.with_name(stale), ignore_errors=True)
    program = Path(sys.executable).with_name("jupyter-book")
    command = [str(program), "build", str(source), "--path-output", str(output), "-q"]
    command += ["-W", "-n", "--keep-going"] if builder == "html" else ["--builder", builder]
    # sphinx-external-toc looks at every object there is, torch's deprecated ones included.
    environment = os.environ | {"PYTHONWARNINGS": "ignore::FutureWarning"}
    if subprocess.run(command, env=environment, check=False).returncode:
        raise SilemError("the book did not build; its warnings and errors are listed above")
    return pages


def build(n_workers: int = 2, builder: str = "html") -> Path:
    """Build the whole book in ``_build``, and return the folder of its pages.

    `n_workers` notebooks run at a time. SilemError if one or a page fails, or another build runs.
    """
    folder = REPO / "_build"
    executed, source = folder / "executed", folder / "source"
    with lock(folder / "book.lock"):
        execute(notebooks(), executed, n_workers, BOOK_PARAMETERS)
        stage(executed, source)
        web.write(source / "book" / "_static" / "web")
        pages = sphinx(source, REPO, builder)
        web.finish(pages)
    return pages


def main(arguments: Sequence[str] | None = None) -> None:
    """Build the book, or draw its figures, from the command line."""
    parser = argparse.ArgumentParser(prog="python -m silem.report.build", description=__doc__)
    parser.add_argument("--workers", type=int, default=2, help="notebooks at a time")
    parser.add_argument("--figures", action="store_true", help="redraw book/figures instead")
    parser.add_argument("--pdf", action="store_true", help="print it to one file instead")
    parser.add_argument("--film", metavar="RUN_ID", help="film a run while it learns instead")
    options = parser.parse_args(arguments)
    started = time.perf_counter()
    try:
        if options.film:
            return slider.of_training(options.film)
        if options.figures:
            return print(*(path.relative_to(REPO) for path in glance.write()), sep="\n")
        made = REPO / "_build" / "silem.pdf"
        if options.pdf:
            pdf.write(build(options.workers, builder="singlehtml"), made)
        else:
            made = build(options.workers) / "index.html"
        print(f"The book is built ({time.perf_counter() - started:.0f} s). Open {made}")
    except SilemError as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
