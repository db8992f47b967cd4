"""What every notebook has to look like, and the strict door in its third cell."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import Any

import nbformat
import pytest
from conftest import NOTEBOOKS

from silem.report.notebook import literal_assignments
from silem.study import runs
from silem.study.studies import experts
from silem.util.errors import SilemError

MAX_CODE_LINES = 15
MAX_DOOR_LINES = 22  # the third cell: imports and parameters
MAX_WIDTH = 94  # columns that fit on a page of the book
RESULT_PAGES = ("05_halfcheetah", "06_affine_or_mlp", "07_scorecard")

every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def read(path: Path) -> nbformat.NotebookNode:
    return nbformat.read(path, as_version=4)


def code_cells(path: Path) -> list[nbformat.NotebookNode]:
    return [cell for cell in read(path).cells if cell.cell_type == "code"]


def prose(path: Path) -> str:
    return "\n".join(cell.source for cell in read(path).cells if cell.cell_type == "markdown")


def test_the_pages_of_the_study_are_there() -> None:
    assert [path.stem for path in NOTEBOOKS][:7] == [
        "01_bodies",
        "02_experts",
        "03_demonstrations",
        "04_imitate",
        *RESULT_PAGES,
    ]


@every_notebook
def test_is_valid_and_holds_no_outputs(path: Path) -> None:
    notebook = read(path)
    nbformat.validate(notebook)
    assert (notebook.nbformat, notebook.nbformat_minor) == (4, 5)
    assert notebook.metadata.kernelspec.name == "python3"
    for cell in code_cells(path):
        assert cell.outputs == []
        assert cell.execution_count is None


@every_notebook
def test_begins_with_the_one_title_then_parameters_then_the_door(path: Path) -> None:
    title, parameters, door = read(path).cells[:3]
    assert title.cell_type == "markdown"
    assert title.source.startswith("# ")
    without_code = re.sub(r"```.*?```", "", prose(path), flags=re.DOTALL)
    assert len(re.findall(r"^# ", without_code, flags=re.MULTILINE)) == 1
    assert "parameters" in parameters.metadata.tags
    assert {"hide-input", "remove-cell"} & set(parameters.metadata.tags)
    assert "parameters(globals()," in door.source.replace("\n", "").replace(" ", "")
    assert all("parameters" not in cell.metadata.get("tags", []) for cell in code_cells(path)[1:])


@every_notebook
def test_parameters_are_typed_literals_each_with_an_explanation(path: Path) -> None:
    cell = code_cells(path)[0]
    for statement, line in zip(ast.parse(cell.source).body, cell.source.splitlines(), strict=True):
        assert isinstance(statement, ast.AnnAssign), line
        assert type(ast.literal_eval(statement.value)).__name__ == statement.annotation.id
        assert re.search(r"  # \w+", line), line


@every_notebook
def test_only_the_second_cell_sets_parameters(path: Path) -> None:
    # The strict door takes every cell of nothing but literals for parameters.
    first, *others = [literal_assignments(cell.source) for cell in code_cells(path)]
    assert first
    assert not any(others)


@every_notebook
def test_cells_are_short_and_fit_the_page(path: Path) -> None:
    _, door, *others = code_cells(path)
    assert len(door.source.splitlines()) <= MAX_DOOR_LINES
    for cell in others:
        assert len(cell.source.splitlines()) <= MAX_CODE_LINES, cell.id
    for cell in code_cells(path)[1:]:
        assert all(len(line) <= MAX_WIDTH for line in cell.source.splitlines()), cell.id


@every_notebook
def test_logic_lives_in_the_package(path: Path) -> None:
    for cell in code_cells(path):
        for node in ast.walk(ast.parse(cell.source)):
            assert not isinstance(node, ast.ClassDef)
            if isinstance(node, ast.FunctionDef):
                assert node.end_lineno - node.lineno < 5, node.name


@every_notebook
def test_there_is_at_least_as_much_prose_as_code(path: Path) -> None:
    code = "".join(cell.source for cell in code_cells(path))
    assert len("".join(prose(path).split())) >= len("".join(code.split()))


@every_notebook
def test_explains_every_step(path: Path) -> None:
    """No three visible code cells follow each other without a word between them."""
    kinds = ""
    for cell in read(path).cells[3:]:
        hidden = {"remove-input", "hide-input", "remove-cell"} & set(cell.metadata.get("tags", []))
        kinds += "m" if cell.cell_type == "markdown" else "" if hidden else "c"
    assert "ccc" not in kinds


@pytest.mark.parametrize("name", RESULT_PAGES)
def test_result_pages_type_no_results(name: str) -> None:
    (path,) = [path for path in NOTEBOOKS if path.stem == name]
    assert re.findall(r"\d+\.\d+|\b\d{3,}\b", prose(path)) == []


def door(path: Path, **given: Any) -> dict[str, Any]:
    """Run a notebook's second and third cell as in Jupyter, with parameters in between."""
    _, parameters, third = [cell.source for cell in read(path).cells[:3]]
    injected = "\n".join(f"{name} = {value!r}" for name, value in given.items())
    namespace: dict[str, Any] = {"In": ["", parameters, injected]}
    exec(parameters, namespace)
    exec(third.partition("records =")[0], namespace | given, namespace)
    return vars(namespace["p"])


def defaults(path: Path) -> dict[str, Any]:
    statements = ast.parse(code_cells(path)[0].source).body
    return {
        statement.target.id: ast.literal_eval(statement.value)
        for statement in statements
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name)
    }


@every_notebook
def test_the_door_knows_exactly_the_parameters(path: Path) -> None:
    assert door(path) == defaults(path)


@every_notebook
def test_the_door_refuses_unknown_names_and_wrong_types(path: Path) -> None:
    with pytest.raises(SilemError, match=r"unknown parameter 'sede'.*Allowed: "):
        door(path, sede=7)
    for name in defaults(path):
        with pytest.raises(SilemError, match=rf"{name} = \[\] is not .*Allowed: .*{name}: "):
            door(path, **{name: []})


def test_the_page_of_demonstrations_shows_whoever_demonstrates() -> None:
    (path,) = [path for path in NOTEBOOKS if path.stem == "03_demonstrations"]
    shown = defaults(path)
    demonstrator = runs.demonstrator(experts(shown["body"], shown["budget"]))
    assert shown["seed"] == demonstrator.run_config.seed
