"""The paper's own tables and numbers, read from ``silem/paper/*.toml``; typed nowhere else.

Hyper-parameters, results and the claims that the scorecard checks come from here, each with the
table or sentence it was printed in.
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from silem.util.errors import SilemError, choose

# Methods of this project whose best combination the paper prints under another method's name.
# Table 1's MLP takes SILEM's own combination: the paper gives it none.
_TABLE_METHOD = {"silem-mlp": "silem"}
_TRANSFORM_SYMBOLS = ("N_G", "d", "w_d", "w_b")

# The experts' own bodies: here "own expert" and "the family's expert" are the same demonstrations.
_ORIGINAL_BODIES = ("HC0", "Ant0")


@dataclass(frozen=True)
class PaperTable:
    """One table as the paper prints it."""

    key: str  #: name of the table here; unique, where the supplement uses one label twice
    label: str  #: the LaTeX source's label
    source: str  #: ``"paper"`` or ``"supplement"``
    number: int  #: within its source, in order of appearance
    section: str  #: title of the section it stands in
    kind: str  #: ``"common"``, ``"grid"``, ``"best"`` or ``"result"``
    caption: str
    rows: Sequence[Mapping[str, Any]]  #: one mapping of column to printed value for each row
    methods: Sequence[str] = ()  #: those it holds for ("best" and "grid")
    families: Sequence[str] = ()  #: families of bodies it holds for ("common")
    bodies: Sequence[str] = ()  #: those it holds for ("grid")
    grid: str = ""  #: key of the grid that a table of best combinations was searched on
    note: str = ""  #: what is odd about it, if anything

    @property
    def columns(self) -> list[str]:
        """Every column, in the order printed."""
        return list(dict.fromkeys(column for row in self.rows for column in row))


@dataclass(frozen=True)
class PaperNumber:
    """One number from a sentence of the paper."""

    name: str  #: name of the number here
    value: Any  #: the number, or a list of numbers
    meaning: str  #: what it measures
    where: str  #: section, figure or caption it stands in
    quote: str  #: the words it was read from
    unit: str = ""
    note: str = ""  #: what is odd about it, if anything
    in_words: bool = False  #: whether the paper spells the number out


@dataclass(frozen=True)
class Symbol:
    """One symbol of the paper and this project's name for it."""

    symbol: str  #: in ASCII, as the tables' columns spell it
    latex: str  #: as the paper sets it
    meaning: str  #: the paper's words for it
    parameter: str  #: this project's name of the parameter
    unit: str = ""
    real: bool = False  #: whether values are real numbers even if printed without a decimal point


@cache
def tables() -> dict[str, PaperTable]:
    """Load every table of the paper and its supplement by key, in the order they are printed."""
    found = [
        PaperTable(**entry)
        for name in ("results", "common", "half_cheetah", "ant", "humanoids")
        for entry in _read(name)["table"]
    ]
    return {table.key: table for table in sorted(found, key=lambda t: (t.source, t.number))}


@cache
def numbers() -> dict[str, PaperNumber]:
    """Load every number that the paper gives in a sentence, by name."""
    return {entry["name"]: PaperNumber(**entry) for entry in _read("text")["number"]}


@cache
def symbols() -> dict[str, Symbol]:
    """Load the paper's symbols, e.g. ``symbols()["N_D"].parameter == "n_disc_updates"``."""
    return {entry["symbol"]: Symbol(**entry) for entry in _read("symbols")["symbol"]}


def table(key: str) -> PaperTable:
    """Return one table by key, e.g. ``table("tab4.1")``; SilemError if the paper has none."""
    return tables()[choose("table of the paper", key, tables())]


def number(name: str) -> Any:
    """Return a number's value, e.g. ``number("random_return") == -1555``; SilemError if unknown."""
    return numbers()[choose("number of the paper", name, numbers())].value


def common(family: str = "halfcheetah") -> dict[str, Any]:
    """Return the common PPO settings of a family (supplement, tab2 or tab2_h), by our names.

    Raises SilemError on anything but ``"halfcheetah"``, ``"ant"`` and ``"humanoid"``.
    """
    by_family = {name: t for t in tables().values() for name in t.families}
    chosen = by_family[choose("family of bodies", family, by_family)]
    return {row["parameter"]: row["value"] for row in chosen.rows}


def best_combination(
    body: str, method: str, demonstrations: str = ""
) -> tuple[dict[str, Any], PaperTable | None]:
    """Return the hyper-parameters that the supplement found best for one cell, and their table.

    Every imitator has tables of its own (HalfCheetah: tab4.1 to tab4.3, Ant: tab3.1 to tab3.3)
    but ``silem-mlp``, which takes SILEM's. ``silem-minus`` from the learner's own expert is
    ``silem-minus-own``, except on a family's original body, where both cells exist and the
    method's name alone tells them apart.

    Args:
        body: The learner's body, e.g. ``"HC1"``.
        method: A method of this project.
        demonstrations: The expert's body.

    Returns:
        The values by the names of ``HyperParameters``, those alone that the paper prints for the
        method: SILEM⁻ has none for the transform. Where it prints none, nothing and no table.
    """
    if method == "silem-minus" and demonstrations == body and body not in _ORIGINAL_BODIES:
        if (own := best_combination(body, "silem-minus-own"))[1]:
            return own
    printed_as = _TABLE_METHOD.get(method, method)
    left_out = ("body", *(_TRANSFORM_SYMBOLS if method.startswith("silem-minus") else ()))
    for candidate in tables().values():
        for row in candidate.rows if candidate.kind == "best" else ():
            if printed_as in candidate.methods and _read("bodies")["names"][row["body"]] == body:
                known = {symbols()[name]: row[name] for name in row if name not in left_out}
                values = {s.parameter: float(v) if s.real else v for s, v in known.items()}
                return values, candidate
    return {}, None


def grid_values(key: str) -> dict[str, list[Any]]:
    """Return a searched grid by symbol, e.g. ``grid_values("tab4")["n"] == [10, 20]``.

    Raises SilemError if the table is not a grid.
    """
    chosen = table(key)
    if chosen.kind != "grid":
        raise SilemError(f"table {key!r} is a table of kind {chosen.kind!r}, not a grid")
    return {row["symbol"]: list(row["values"]) for row in chosen.rows}


@cache
def _read(name: str) -> dict[str, Any]:
    return tomllib.loads(Path(__file__).with_name(f"{name}.toml").read_text(encoding="utf-8"))
