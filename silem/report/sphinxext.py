"""Sphinx extension: the paper's tables and numbers, and this project's settings, in the prose.

A page that names a number takes it from where the code takes it, so that the two cannot differ:

- ``{paper-number}`expert_return` ``: a number of the paper, its source shown on hovering;
- ``{setting}`gradient_penalty` ``: the default of a hyper-parameter of this project;
- ``{paper-table}`` with a key such as ``tab4.1``: a table of the paper;
- ``{settings}`` and ``{budgets}``: this project's hyper-parameters and budgets as tables.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from silem import paper
from silem.study.settings import BUDGETS, METHODS, HyperParameters, namesake
from silem.util.errors import SilemError, choose

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


def layers(value: Any) -> str:
    """Write layer sizes, e.g. ``3 × 128``, and anything else as text."""
    equal = isinstance(value, list | tuple) and len(value) > 1 and len(set(value)) == 1
    return f"{len(value)} × {value[0]}" if equal else as_text(value)


def paper_number(name: str) -> tuple[str, str]:
    """Return a number of the paper, ``name.1`` for a list's second entry, and its source."""
    key, _, index = name.partition(".")
    value, about = paper.number(key), paper.numbers()[key]
    text = as_text(value[int(index)]) if index else layers(value)
    return text, f"{about.meaning} ({about.where})"


def setting(name: str) -> tuple[str, str]:
    """Return the default of a field of `HyperParameters`; it needs no source."""
    defaults = dataclasses.asdict(HyperParameters())
    return layers(defaults[choose("setting", name, defaults)]), ""


def role(read: Callable[[str], tuple[str, str]]) -> Any:
    """Return a role that writes what `read` finds by name, its source shown on hovering."""

    def write(name: str, raw: str, text: str, line: int, inliner: Any, *_: Any, **__: Any) -> Any:
        try:
            shown, source = read(text)
        except SilemError as error:
            return [], [inliner.reporter.error(str(error), line=line)]
        abbreviation = nodes.abbreviation(raw, shown, explanation=source)
        return [abbreviation if source else nodes.Text(shown)], []

    return write


class Table(NamedTuple):
    """A table: its target for ``{numref}``, its caption as Markdown, its head and its rows."""

    name: str
    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def paper_table(key: str = "") -> Table:
    """Return a table of the paper; its caption names where the paper has it."""
    table, known = paper.table(key), paper.symbols()

    def code(name: str | None) -> str:
        return f"`{name}`" if name else ""

    def heading(column: str) -> str:
        """Write a symbol as a formula, in tables of results alone if one letter."""
        if table.kind == "best":
            return known[column].latex if column in known else column.capitalize()
        return column.replace("_", " ") if len(column) > 1 else f"${column}$"

    if table.kind == "common":
        head = ["Hyper-parameter", "Value", "Name here"]
        rows = [[r["meaning"], as_text(r["value"]), code(r["parameter"])] for r in table.rows]
    elif table.kind == "grid":
        head = ["Symbol", "Hyper-parameter", "Values", "Name here"]
        rows = []
        for row in table.rows:
            symbol, star = known[row["symbol"]], "**" * bool(row.get("silem_only"))
            about = f"{star}{row['meaning']}{star}", as_text(row["values"])
            rows.append([symbol.latex, *about, code(symbol.parameter)])
    else:
        head = [heading(column) for column in table.columns]
        rows = [[as_text(row[column]) for column in table.columns] for row in table.rows]
    caption = f"{table.caption} ({table.source}, Table {table.number}) {table.note or ''}"
    return Table(f"paper-{table.key.replace('.', '-')}", caption.strip(), head, rows)


def settings() -> Table:
    """Return this project's hyper-parameters: name, default and the methods that use each."""
    learned, rows = set(METHODS) - {"random"}, []
    for field in dataclasses.fields(HyperParameters):
        users = field.metadata["methods"]
        used_by = "all" if set(users) == learned else ", ".join(users)
        default = layers(field.default)
        for name, method in METHODS.items():
            if chosen := method.chosen.get(field.name):
                default += f"; {name} {layers(chosen.value)}"
        rows.append((f"`{field.name}`", default, used_by))
    caption = (
        "The hyper-parameters of `HyperParameters`, their defaults, and the methods that use"
        " each. The paper's best combination of a cell replaces the defaults."
    )
    return Table("settings", caption, ("Name", "Default", "Used by"), rows)


def budgets() -> Table:
    """Return the budgets: how much each spends on a run."""
    names = "Environments", "Steps per iteration", "Iterations", "Trials", "Evaluation episodes"
    rows = []
    for budget in BUDGETS.values():
        more = ""
        for name, family in (("Ants", "ant"), ("humanoids", "humanoid")):
            if (theirs := namesake(budget, family).n_iterations) != budget.n_iterations:
                more += f"; {name} {as_text(theirs)}"
        spent = budget.n_envs, budget.steps_per_iteration, budget.n_iterations, budget.n_trials
        row = [f"`{budget.name}`", *map(as_text, (*spent, budget.n_eval_episodes))]
        rows.append([*row[:3], row[3] + more, *row[4:]])
    return Table("budgets", "What each budget spends on a run.", ["Budget", *names], rows)


TABLES: dict[str, Callable[..., Table]] = {
    "paper-table": paper_table,
    "settings": settings,
    "budgets": budgets,
}


class TableDirective(SphinxDirective):
    """One of `TABLES`, written as Markdown and parsed by MyST."""

    optional_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the table, captioned and numbered."""
        try:
            table = TABLES[self.name](*self.arguments)
        except SilemError as error:
            raise self.error(str(error)) from error
        # Colons, not backticks: a caption may hold code.
        lines = [f":::{{table}} {table.caption}", f":name: {table.name}", ":align: center", ""]
        rows = [table.head, ["---"] * len(table.head), *table.rows]
        lines += [f"| {' | '.join(row)} |" for row in rows]
        parent = nodes.container()
        self.state.nested_parse(StringList([*lines, ":::"], source=""), self.content_offset, parent)
        return list(parent.children)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the roles and directives with Sphinx."""
    app.add_role("paper-number", role(paper_number))
    app.add_role("setting", role(setting))
    for name in TABLES:
        app.add_directive(name, TableDirective)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
