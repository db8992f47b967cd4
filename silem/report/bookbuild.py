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
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

import nbformat

from silem.report.execution import Parameters, execute_notebooks
from silem.util.errors import SilemError
from silem.util.files import lock, read_json, write_json
from silem.util.paths import REPO, data_dir

STATE = "book.json"  # what a finished build was made from

BOOK_PARAMETERS: Parameters = {
    "01_bodies": {"video_s": 6.0},
    "02_experts": {"budget": "quick", "video_s": 6.0},
    "04_imitate": {"body": "HC0", "budget": "quick", "video_s": 6.0},
    "05_halfcheetah": {"video_s": 7.0},
    "10_humanoids": {"n_episodes": 100, "video_s": 2.0},
    "11_retargeting": {"film_all": True, "video_s": 2.3},
    "12_walking": {"budget": "book", "video_s": 6.0},
}
"""Parameters that differ from a notebook's defaults, which are made for tests."""


def notebooks() -> list[Path]:
    """Return the book's notebooks in their order."""
    return sorted((REPO / "notebooks").glob("[0-9][0-9]_*.ipynb"))


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
    folders = [REPO / name for name in ("book", "notebooks", "silem", "silem/paper", "data/search")]
    folders += [data_dir() / name for name in ("results", "demonstrations")]
    single = [REPO / name for name in ("_config.yml", "_toc.yml", "environment.txt")]
    digest = hashlib.sha256()
    for path in [*_files(folders), *single]:
        digest.update(str(path).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def html(root: Path = REPO) -> Path:
    """Return the folder that holds the pages of the book built under `root`."""
    return root / "_build" / "html"


def is_current(root: Path = REPO) -> bool:
    """Say whether the book under `root` was built, without failure, from what is here now."""
    state = root / "_build" / STATE
    if not (html(root) / "index.html").exists() or not state.exists():
        return False
    return bool(read_json(state)["digest"] == source_digest())


def build(
    n_workers: int = 2,
    reuse_executed: bool = False,
    root: Path = REPO,
    parameters: Parameters = BOOK_PARAMETERS,
) -> Path:
    """Build the whole book in ``_build`` under `root`.

    Args:
        n_workers: How many notebooks run at a time.
        reuse_executed: Take the notebooks executed last time, where there are any.
        root: The folder to build under.
        parameters: By the notebook's name, those that differ from its defaults.

    Returns:
        The first page.

    Raises:
        SilemError: If a notebook or a page fails, or another build is under way.
    """
    folder = root / "_build"
    executed, source = folder / "executed", folder / "source"
    with lock(folder / "book.lock"):
        (folder / STATE).unlink(missing_ok=True)
        digest = source_digest()
        if not (reuse_executed and any(executed.glob("*.ipynb"))):
            execute_notebooks(notebooks(), executed, n_workers, parameters)
        stage(executed, source)
        build_html(source, root)
        if not reuse_executed:
            write_json(folder / STATE, {"digest": digest})
    return html(root) / "index.html"


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
