"""Sphinx extension: the paper's tables and numbers, and this project's settings, in the prose.

A page that names a number takes it from where the code takes it, so that the two cannot differ:

- ``{paper-number}`expert_return` ``: a number of the paper, its source shown on hovering;
- ``{setting}`gradient_penalty` ``: the default of a hyper-parameter of this project;
- ``{paper-table}`` with a key such as ``tab4.1``: a table of the paper;
- ``{settings}`` and ``{budgets}``: this project's hyper-parameters and budgets as tables.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective, SphinxRole

from silem import paper
from silem.paper.types import PaperTable
from silem.study.settings import BUDGETS, METHODS, Budget, HyperParameters, of_family
from silem.util.errors import SilemError

Row = Sequence[str]
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def as_text(value: Any) -> str:
    """Write a number or a list of numbers as prose does: a true minus, powers of ten raised."""
    if isinstance(value, list | tuple):
        return ", ".join(as_text(entry) for entry in value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    if float(value).is_integer() and abs(value) < 1e12:
        return f"{value:,.0f}".replace("-", "−")
    digits, _, exponent = f"{value:.12g}".replace("-", "−").partition("e")
    if not exponent:
        return digits
    power = "10" + str(int(exponent.replace("−", "-"))).translate(_RAISED)
    return power if digits == "1" else f"{digits} × {power}"


def layers(sizes: Sequence[int]) -> str:
    """Write layer sizes, e.g. ``3 × 128``."""
    equal = len(sizes) > 1 and len(set(sizes)) == 1
    return f"{len(sizes)} × {sizes[0]}" if equal else as_text(sizes)


class PaperNumberRole(SphinxRole):
    """``{paper-number}`name` ``, or ``name.1`` for the second entry of a list."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Return the number as an abbreviation whose explanation names the source."""
        name, _, index = self.text.partition(".")
        try:
            value = paper.number(name)
        except SilemError as error:
            return [], [self.inliner.reporter.error(str(error), line=self.lineno)]
        entry = value[int(index)] if index else value
        text = layers(entry) if isinstance(entry, list) else as_text(entry)
        source = f"{paper.numbers()[name].meaning} ({paper.numbers()[name].where})"
        return [nodes.abbreviation(self.rawtext, text, explanation=source)], []


class SettingRole(SphinxRole):
    """``{setting}`name` ``: the default of a field of `HyperParameters`."""

    def run(self) -> tuple[list[nodes.Node], list[nodes.system_message]]:
        """Return the default as text."""
        defaults = dataclasses.asdict(HyperParameters())
        if self.text not in defaults:
            message = f"unknown setting {self.text!r}; allowed: {', '.join(defaults)}"
            return [], [self.inliner.reporter.error(message, line=self.lineno)]
        value = defaults[self.text]
        return [nodes.Text(layers(value) if isinstance(value, tuple) else as_text(value))], []


class TableDirective(SphinxDirective):
    """Base of the directives that write a table as Markdown and let MyST parse it."""

    def markdown_table(
        self, name: str, caption: str, head: Row, rows: Iterable[Row]
    ) -> list[nodes.Node]:
        """Return a captioned, numbered table.

        Args:
            name: Target for ``{numref}``.
            caption: The caption, as Markdown.
            head: The columns' names.
            rows: The cells, one sequence per row.
        """
        # Colons, not backticks: a caption may hold code.
        lines = [f":::{{table}} {caption}", f":name: {name}", ":align: center", ""]
        lines += [_line(head), _line(["---"] * len(head)), *map(_line, rows), ":::"]
        parent = nodes.container()
        self.state.nested_parse(StringList(lines, source=""), self.content_offset, parent)
        return list(parent.children)


def _line(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


class PaperTableDirective(TableDirective):
    """One table of the paper, by its key in ``silem/paper``."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the table, its caption naming where the paper has it."""
        try:
            table = paper.table(self.arguments[0])
        except SilemError as error:
            raise self.error(str(error)) from error
        write = {"common": _common, "grid": _grid, "best": _best, "result": _result}[table.kind]
        head, rows = write(table)
        caption = f"{table.caption} ({table.source}, Table {table.number})"
        if table.note:
            caption += f" {table.note}"
        return self.markdown_table(f"paper-{table.key.replace('.', '-')}", caption, head, rows)


def _parameter(name: str) -> str:
    return f"`{name}`" if name else ""


def _common(table: PaperTable) -> tuple[Row, list[Row]]:
    rows: list[Row] = [
        (r["meaning"], as_text(r["value"]), _parameter(r["parameter"])) for r in table.rows
    ]
    return ("Hyper-parameter", "Value", "Name here"), rows


def _grid(table: PaperTable) -> tuple[Row, list[Row]]:
    rows: list[Row] = []
    for row in table.rows:
        symbol = paper.symbols()[row["symbol"]]
        meaning = f"**{row['meaning']}**" if row.get("silem_only") else row["meaning"]
        values = as_text(row["values"])
        rows.append((symbol.latex, meaning, values, _parameter(symbol.parameter)))
    return ("Symbol", "Hyper-parameter", "Values", "Name here"), rows


def _best(table: PaperTable) -> tuple[Row, list[Row]]:
    known = paper.symbols()
    head = [known[c].latex if c in known else c.capitalize() for c in table.columns]
    return head, [[as_text(row[c]) for c in table.columns] for row in table.rows]


def _result(table: PaperTable) -> tuple[Row, list[Row]]:
    head = [c.replace("_", " ") if len(c) > 1 else f"${c}$" for c in table.columns]
    return head, [[as_text(row[c]) for c in table.columns] for row in table.rows]


class SettingsDirective(TableDirective):
    """This project's hyper-parameters: name, default and the methods that use each."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        rows = []
        for field in dataclasses.fields(HyperParameters):
            default = field.default
            text = layers(default) if isinstance(default, tuple) else as_text(default)
            users = field.metadata["methods"]
            learned = [method for method in METHODS if method != "random"]
            everyone = set(users) == set(learned)
            rows.append((f"`{field.name}`", text, "all" if everyone else ", ".join(users)))
        caption = "The hyper-parameters of `HyperParameters`, their defaults, "
        caption += "and the methods that use each. The paper's best combination of a cell replaces "
        caption += "the defaults."
        return self.markdown_table("settings", caption, ("Name", "Default", "Used by"), rows)


class BudgetsDirective(TableDirective):
    """The budgets: how much each spends."""

    def run(self) -> list[nodes.Node]:
        """Return the table."""
        head = ["Budget", "Environments", "Steps per iteration", "Iterations", "Trials"]
        head.append("Evaluation episodes")
        rows = [
            (
                f"`{budget.name}`",
                as_text(budget.n_envs),
                as_text(budget.steps_per_iteration),
                iterations(budget),
                as_text(budget.n_trials),
                as_text(budget.n_eval_episodes),
            )
            for budget in BUDGETS.values()
        ]
        return self.markdown_table("budgets", "What each budget spends on a run.", head, rows)


def iterations(budget: Budget) -> str:
    """Write a budget's iterations, and the humanoids' where those are others."""
    humanoids = of_family(budget, "humanoid").n_iterations
    text = as_text(budget.n_iterations)
    same = humanoids == budget.n_iterations
    return text if same else f"{text}; humanoids {as_text(humanoids)}"


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the roles and directives with Sphinx."""
    app.add_role("paper-number", PaperNumberRole())
    app.add_role("setting", SettingRole())
    app.add_directive("paper-table", PaperTableDirective)
    app.add_directive("settings", SettingsDirective)
    app.add_directive("budgets", BudgetsDirective)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
