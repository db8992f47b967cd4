"""The strict door for notebook parameters, alone and through papermill."""

from __future__ import annotations

from pathlib import Path

import nbformat
import papermill
import pytest
from nbformat.v4 import new_code_cell, new_notebook

from silem.report.notebook import parameters
from silem.util.errors import SilemError

SCHEMA = {"body": ["HC0", "HC1"], "seed": int, "video_s": float, "fast": bool}
GOOD = {"body": "HC0", "seed": 3, "video_s": 1.5, "fast": False}

DOOR = """\
from silem.report.notebook import parameters
p = parameters(globals(), body=["HC0", "HC1"], seed=int, video_s=float)
print(vars(p))"""


def in_notebook(*cells: str, **namespace: object) -> dict[str, object]:
    """What ``globals()`` holds once the cells have run in Jupyter."""
    return {"get_ipython": object(), "In": ["", *cells], "Out": {}} | namespace


def given(values: dict[str, object]) -> dict[str, object]:
    """What ``globals()`` holds after a cell that assigns the values."""
    cell = "\n".join(f"{name} = {value!r}" for name, value in values.items())
    return in_notebook(cell.replace("= nan", "= float('nan')"), **values)


def test_returns_the_values_as_attributes() -> None:
    p = parameters(given(GOOD), **SCHEMA)
    assert vars(p) == GOOD


def test_int_is_taken_for_a_float() -> None:
    p = parameters(given(GOOD | {"video_s": 2}), **SCHEMA)
    assert p.video_s == 2.0
    assert isinstance(p.video_s, float)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"sede": 7}, "unknown parameter 'sede'"),
        ({"seed": "7"}, "seed = '7' is not of type int"),
        ({"seed": True}, "seed = True is not of type int"),
        ({"seed": 7.0}, "seed = 7.0 is not of type int"),
        ({"fast": 1}, "fast = 1 is not of type bool"),
        ({"body": "HC9"}, "body = 'HC9' is not one of HC0, HC1"),
        ({"body": "HC"}, "body = 'HC' is not one of HC0, HC1"),
        ({"video_s": float("nan")}, "video_s = nan is not a finite float"),
        ({"video_s": None}, "video_s = None is not a finite float"),
    ],
)
def test_refuses_and_lists_what_is_allowed(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(SilemError) as caught:
        parameters(given(GOOD | wrong), **SCHEMA)
    assert message in str(caught.value)
    allowed = (
        "Allowed: body: one of HC0, HC1; seed: of type int; "
        "video_s: a finite float; fast: of type bool"
    )
    assert str(caught.value).endswith(allowed)


def test_reports_every_problem_in_one_error() -> None:
    wrong = {"body": "HC9", "seed": "7", "sede": 1, "fast": True}
    with pytest.raises(SilemError) as caught:
        parameters(given(wrong), **SCHEMA)
    for part in ("'sede'", "'HC9'", "'7'", "'video_s' is missing"):
        assert part in str(caught.value)


def test_in_a_notebook_variables_of_other_cells_are_no_parameters() -> None:
    cells = ['body = "HC0"', "import os\nn = 3", "m = len('abc')", "broken ="]
    found = in_notebook(*cells, body="HC0", n=3, m=3)
    assert vars(parameters(found, body=str)) == {"body": "HC0"}


def test_in_a_notebook_the_injected_cell_sets_parameters_too() -> None:
    cells = ['body: str = "HC0"  # the body', "# Parameters\nrate = float('nan')\nlist_ = [-1]"]
    found = in_notebook(*cells, body="HC0", rate=float("nan"), list_=[-1])
    with pytest.raises(SilemError, match=r"'rate'; unknown parameter 'list_'"):
        parameters(found, body=str)


def test_in_a_notebook_the_door_can_be_run_again() -> None:
    wrong, door, right = "sede = 7", "import silem\np = door()", "seed = 7"
    mended = in_notebook(wrong, door, right, door, sede=7, seed=7)
    assert vars(parameters(mended, seed=int)) == {"seed": 7}
    unmended = in_notebook(right, wrong, door, door, sede=7, seed=7)
    with pytest.raises(SilemError, match="unknown parameter 'sede'"):
        parameters(unmended, seed=int)


@pytest.fixture
def notebook(tmp_path: Path) -> Path:
    """A notebook with nothing in it but the door."""
    defaults = new_code_cell(
        'body: str = "HC0"\nseed: int = 0\nvideo_s: float = 1.5', metadata={"tags": ["parameters"]}
    )
    nb = new_notebook(cells=[defaults, new_code_cell(DOOR), new_code_cell("n = 3")])
    nb.metadata["kernelspec"] = {"name": "python3", "display_name": "", "language": "python"}
    nbformat.write(nb, tmp_path / "door.ipynb")
    return tmp_path / "door.ipynb"


def execute(notebook: Path, **given: object) -> nbformat.NotebookNode:
    out = notebook.with_name("out.ipynb")
    repo = Path(__file__).parents[2]
    return papermill.execute_notebook(notebook, out, given, progress_bar=False, cwd=repo)


def test_papermill_with_an_unknown_name_and_a_wrong_type_fails(notebook: Path) -> None:
    with pytest.raises(papermill.PapermillExecutionError) as caught:
        execute(notebook, sede=7, body=3)
    assert caught.value.ename == "SilemError"
    assert "unknown parameter 'sede'; body = 3 is not one of HC0, HC1" in caught.value.evalue
    assert "Allowed: body: one of HC0, HC1; seed: of type int" in caught.value.evalue
