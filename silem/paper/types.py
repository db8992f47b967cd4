"""What ``silem/paper`` holds: the paper's tables, its numbers in sentences, and its symbols."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class PaperTable:
    """One table as the paper prints it.

    Attributes:
        key: Name of the table here; unique, where the supplement uses one label twice.
        label: The LaTeX source's label.
        source: ``"paper"`` or ``"supplement"``.
        number: Number of the table within its source, in order of appearance.
        section: Title of the section it stands in.
        kind: ``"common"``, ``"grid"``, ``"best"`` or ``"result"``.
        caption: The caption's words.
        rows: One mapping of column to printed value for each row.
        methods: Methods it holds for ("best" and "grid").
        families: Families of bodies it holds for ("common").
        bodies: Bodies it holds for ("grid").
        grid: Key of the grid that a table of best combinations was searched on.
        note: What is odd about it, if anything.
    """

    key: str
    label: str
    source: str
    number: int
    section: str
    kind: str
    caption: str
    rows: tuple[Mapping[str, Any], ...]
    methods: tuple[str, ...] = ()
    families: tuple[str, ...] = ()
    bodies: tuple[str, ...] = ()
    grid: str = ""
    note: str = ""

    @property
    def reference(self) -> str:
        """Name the table for a reader, e.g. ``"supplement, Table 16 (tab4.1)"``."""
        return f"{self.source}, Table {self.number} ({self.label})"

    @property
    def columns(self) -> list[str]:
        """List every column, in the order printed."""
        return list(dict.fromkeys(column for row in self.rows for column in row))


@dataclass(frozen=True)
class PaperNumber:
    """One number from a sentence of the paper.

    Attributes:
        name: Name of the number here.
        value: The number, or a list of numbers.
        meaning: What it measures.
        where: Section, figure or caption it stands in.
        quote: The words it was read from.
        unit: Its unit, if it has one.
        note: What is odd about it, if anything.
        in_words: True where the paper spells the number out.
    """

    name: str
    value: Any
    meaning: str
    where: str
    quote: str
    unit: str = ""
    note: str = ""
    in_words: bool = False


@dataclass(frozen=True)
class Symbol:
    """One symbol of the paper and this project's name for it.

    Attributes:
        symbol: The symbol in ASCII, as the tables' columns spell it.
        latex: The symbol as the paper sets it.
        meaning: The paper's words for it.
        parameter: This project's name of the parameter.
        unit: Its unit, if it has one.
        real: True where the values are real numbers even if printed without a decimal point.
    """

    symbol: str
    latex: str
    meaning: str
    parameter: str
    unit: str = ""
    real: bool = False
