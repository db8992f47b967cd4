"""A data folder to run the notebooks in: a made-up study, demonstrations and a few policies."""

from __future__ import annotations

import dataclasses
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pytest
from IPython.core import displayhook
from IPython.core.interactiveshell import InteractiveShell
from IPython.display import display
from IPython.utils.capture import capture_output
from nbformat import v4
from papermill.iorw import load_notebook_node
from papermill.parameterize import parameterize_notebook
from traitlets import Type
from traitlets.config import Config

from silem.envs import make_vec
from silem.motion import clips, demonstrations
from silem.motion.demonstrations import Demonstrations
from silem.report import film
from silem.study.config import RunConfig
from silem.study.runs import RunRecord
from silem.study.studies import experts, study_configs
from silem.util.errors import SilemError

REPO = Path(__file__).parents[2]
NOTEBOOKS = sorted((REPO / "notebooks").glob("*.ipynb"))

sys.path.insert(0, str(REPO / "tests" / "unit"))  # the made-up records are shared with its tests
import synthetic_records as synthetic  # noqa: E402

MISSING = {("silem", "HC1"): 3, ("silem-mlp", "HC0"): 0}
FILMED = [("silem", "HC2"), ("silem-minus", "HC2")]

Execute = Callable[..., nbformat.NotebookNode]


@pytest.fixture(scope="session")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with a study at the book budget, some of whose trials are missing."""
    folder = tmp_path_factory.mktemp("data")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SILEM_DATA_DIR", str(folder))
        synthetic.write_study("book", without=MISSING)
        synthetic.write_record(study_configs("fidelity", "book")[0], 1234.5)
        for method, body in FILMED:
            add_untrained_policy(RunConfig.create(body, method, budget="book"))
        shown = random_demonstrations("HC0")
        demonstrations.publish("HC0", shown)
        for config in experts("HC0", "book"):  # recorded already, so that no page has to
            add_untrained_policy(config)
            published = dataclasses.replace(shown, expert_run_id=config.run_id)
            demonstrations.publish(f"HC0_s{config.seed}", published)
    return folder


def add_untrained_policy(config: RunConfig) -> None:
    """Give a made-up record a policy that can act."""
    from silem.study import runs

    record = runs.find(config.run_id)
    assert record is not None
    synthetic.with_policy(record)


def random_demonstrations(body: str, n_trajectories: int = 20, n_steps: int = 60) -> Demonstrations:
    """Short trajectories of a random policy, as many as the supplement's combinations use."""
    env = make_vec(body, n_envs=n_trajectories, seed=0)
    rng = np.random.default_rng(0)
    states = [env.reset().copy()]
    for _ in range(n_steps):
        actions = rng.uniform(-1, 1, (n_trajectories, env.body.action_size))
        states.append(env.step(actions)[0].copy())
    env.close()
    features = np.stack(states, axis=1).astype(np.float32)
    return Demonstrations(tuple(features), (0.0,) * n_trajectories, body, "a random policy")


class DisplayHook(displayhook.DisplayHook):
    """Shows a cell's last value like anything that it displays."""

    def __call__(self, result: object = None) -> None:
        if result is not None:
            display(result)


class Shell(InteractiveShell):
    displayhook_class = Type(DisplayHook)


@pytest.fixture
def execute(data_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Execute:
    """Run a notebook by name, with parameters, in the made-up data folder.

    It runs in this process, where everything is imported already: a kernel's start costs more than
    most pages. The book, and `test_notebook_parameters`, run notebooks in kernels.
    """
    monkeypatch.setenv("SILEM_DATA_DIR", str(data_dir))
    monkeypatch.chdir(tmp_path)

    def run(name: str, **parameters: Any) -> nbformat.NotebookNode:
        notebook = parameterize_notebook(load_notebook_node(str(path_of(name))), parameters)
        Shell.clear_instance()
        shell = Shell.instance(config=Config(HistoryManager={"enabled": False}))
        try:
            for cell in notebook.cells:
                if cell.cell_type == "code":
                    with capture_output() as captured:
                        shell.run_cell(cell.source, store_history=True).raise_error()
                    cell.outputs = [
                        v4.new_output("display_data", output.data, metadata=output.metadata or {})
                        for output in captured.outputs
                    ]
                    if captured.stdout:
                        cell.outputs.append(v4.new_output("stream", text=captured.stdout))
        finally:
            Shell.clear_instance()
        return notebook

    return run


def path_of(name: str) -> Path:
    (path,) = [path for path in NOTEBOOKS if path.stem == name]
    return path


@pytest.fixture
def no_offscreen_rendering(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine on which MuJoCo cannot draw."""

    def refuse(*_: object) -> None:
        raise SilemError("no offscreen rendering with MUJOCO_GL='disable'")

    monkeypatch.setattr(film, "Camera", refuse)


@pytest.fixture
def only_demonstrations(execute: Execute, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A data folder with nothing but the committed demonstrations: no results, no raw clips."""
    folder = tmp_path / "data"
    shutil.copytree(REPO / "data" / "demonstrations", folder / "demonstrations")
    monkeypatch.setenv("SILEM_DATA_DIR", str(folder))
    monkeypatch.setenv(clips.ENV, str(tmp_path / "nowhere"))


def find(run_id: str, data_dir: Path) -> RunRecord:
    """Load a record of the made-up data folder, wherever it lies."""
    (path,) = data_dir.glob(f"*/halfcheetah/{run_id}/record.json")
    return RunRecord.load(path)


def output(notebook: nbformat.NotebookNode, cell_id: str) -> str:
    """All that a cell shows, as text: HTML, SVG, plain text and what it printed."""
    (cell,) = [cell for cell in notebook.cells if cell.id == cell_id]
    parts = []
    for item in cell.outputs:
        data = item.get("data", {})
        parts += [item.get("text", "")] if item.get("name") == "stdout" else []
        parts += [data[kind] for kind in ("text/html", "image/svg+xml") if kind in data]
        if set(data) == {"text/plain"}:
            parts.append(data["text/plain"])
    return "".join("".join(part) for part in parts)


def said(notebook: nbformat.NotebookNode) -> dict[str, str]:
    """The numbers that the page's sentences use, by name."""
    words = {}
    for cell in notebook.cells:
        for item in cell.get("outputs", []):
            name = item.get("metadata", {}).get("scrapbook", {}).get("name")
            if name:
                data = item["data"]
                text = next(value for key, value in data.items() if key.endswith("text/plain"))
                words[name] = text.strip("'")
    return words


def words(text: str) -> str:
    """What is read: the text without its markup."""
    text = text.replace("<wbr>", "")
    return " ".join(re.sub(r"<style.*?</style>|<[^>]*>", " ", text, flags=re.DOTALL).split())


def glue_roles(notebook: nbformat.NotebookNode) -> set[str]:
    """The names that the page's sentences ask for."""
    text = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    return set(re.findall(r"\{glue:text\}`(\w+)`", text))
