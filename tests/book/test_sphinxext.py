"""Numbers and tables that the prose takes from the code."""

from __future__ import annotations

import pytest
from docutils.core import publish_doctree
from docutils.parsers.rst import roles

from silem import paper
from silem.report import sphinxext
from silem.study.settings import HyperParameters


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (-1555, "−1,555"),
        (2249, "2,249"),
        (0.999, "0.999"),
        (2e-4, "0.0002"),
        (1e-5, "10⁻⁵"),
        (2.5e-7, "2.5 × 10⁻⁷"),
        ([10, 20], "10, 20"),
        (1.0, "1"),
    ],
)
def test_numbers_are_written_as_prose_does(value: object, text: str) -> None:
    assert sphinxext.as_text(value) == text


def test_layers() -> None:
    assert sphinxext.layers([128, 128, 128]) == "3 × 128"
    assert sphinxext.layers([128, 64]) == "128, 64"
    assert sphinxext.layers([100]) == "100"


def parsed(text: str) -> str:
    roles.register_local_role("paper-number", sphinxext.role(sphinxext.paper_number))
    roles.register_local_role("setting", sphinxext.role(sphinxext.setting))
    return publish_doctree(text, settings_overrides={"report_level": 5}).astext()


def test_roles_show_the_value_the_code_uses() -> None:
    assert parsed(":paper-number:`expert_return`") == f"{paper.number('expert_return'):,}"
    expected = sphinxext.as_text(HyperParameters().gradient_penalty)
    assert parsed(":setting:`gradient_penalty`") == expected


@pytest.mark.parametrize("role", ["paper-number", "setting"])
def test_an_unknown_name_is_an_error_that_lists_the_allowed_ones(role: str) -> None:
    text = parsed(f":{role}:`nonsense`")
    assert "nonsense" in text and "allowed" in text


def test_every_table_has_a_cell_for_each_column() -> None:
    tables = [sphinxext.paper_table(key) for key in paper.tables()]
    for table in (*tables, sphinxext.settings(), sphinxext.budgets()):
        assert table.rows and {len(row) for row in table.rows} == {len(table.head)}, table.name
