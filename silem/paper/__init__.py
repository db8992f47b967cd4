"""The paper's own tables and numbers, read from ``silem/paper/*.toml``.

Nothing else in this project types a number of the paper: hyper-parameters, results and the claims
that the scorecard checks all come from here, each with the table or sentence it was printed in.
"""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from typing import Any

from silem.paper.types import PaperNumber, PaperTable, Symbol
from silem.util.errors import SilemError, choose

KINDS = ("common", "grid", "best", "result")

# Methods of this project whose best combination the paper prints under another method's name.
# Table 1's MLP takes SILEM's own combination: the paper gives it none.
_TABLE_METHOD = {"silem-mlp": "silem"}

# A body that the paper has no row for takes HalfCheetah0's row of SILEM's table, the one row that
# agrees with the common PPO table (tab2) in every entry the two share.
_DEFAULT_ROW = ("HC0", "silem")
_TRANSFORM_SYMBOLS = ("N_G", "d", "w_d", "w_b")

# The experts' own bodies: here "own expert" and "the family's expert" are the same demonstrations.
_ORIGINAL_BODIES = ("HC0", "Ant0")


@cache
def tables() -> dict[str, PaperTable]:
    """Load every table of the paper and its supplement, in the order they are printed.

    Returns:
        Mapping from the table's key to the table.

    Raises:
        SilemError: If a TOML file is missing, broken, or uses a key twice.
    """
    found: dict[str, PaperTable] = {}
    for name in ("results", "common", "half_cheetah", "ant", "humanoids"):
        for entry in _read(name)["table"]:
            fields: dict[str, Any] = {
                k: tuple(v) if isinstance(v, list) else v for k, v in entry.items()
            }
            table = PaperTable(**fields)
            if table.key in found:
                raise SilemError(f"silem/paper: table {table.key!r} is given twice")
            choose("kind of table", table.kind, KINDS)
            found[table.key] = table
    return dict(sorted(found.items(), key=lambda item: (item[1].source, item[1].number)))


@cache
def numbers() -> dict[str, PaperNumber]:
    """Load every number that the paper gives in a sentence, by name."""
    return {entry["name"]: PaperNumber(**entry) for entry in _read("text")["number"]}


@cache
def symbols() -> dict[str, Symbol]:
    """Load the paper's symbols, e.g. ``symbols()["N_D"].parameter == "n_disc_updates"``."""
    return {entry["symbol"]: Symbol(**entry) for entry in _read("symbols")["symbol"]}


def table(key: str) -> PaperTable:
    """Return one table by key, e.g. ``table("tab4.1")``.

    Raises:
        SilemError: If the paper has no such table.
    """
    return tables()[choose("table of the paper", key, tables())]


def number(name: str) -> Any:
    """Return the value of one number, e.g. ``number("random_return") == -1555``.

    Raises:
        SilemError: If no such number was recorded.
    """
    return numbers()[choose("number of the paper", name, numbers())].value


def common(family: str = "halfcheetah") -> dict[str, Any]:
    """Return the common PPO settings of a family of bodies (supplement, tab2 or tab2_h).

    Args:
        family: ``"halfcheetah"``, ``"ant"`` or ``"humanoid"``.

    Returns:
        Mapping from this project's parameter name to the printed value.
    """
    by_family = {name: t for t in tables().values() for name in t.families}
    chosen = by_family[choose("family of bodies", family, by_family)]
    return {row["parameter"]: row["value"] for row in chosen.rows}


def best_table(body: str, method: str) -> PaperTable | None:
    """Find the table that prints the best combination of a body and method.

    Args:
        body: This project's name of the body, e.g. ``"HC1"``.
        method: A method of this project.

    Returns:
        The table, or None where the paper has no row for them.
    """
    wanted = _TABLE_METHOD.get(method, method)
    for candidate in tables().values():
        if candidate.kind == "best" and wanted in candidate.methods:
            if any(_body_names()[row["body"]] == body for row in candidate.rows):
                return candidate
    return None


def best_combination(body: str, method: str, demonstrations: str = "") -> dict[str, Any]:
    """Return the hyper-parameters that the supplement found best for one cell of the study.

    ``silem``, ``silem-minus`` and ``silem-minus-own`` have a table each (HalfCheetah: tab4.1 to
    tab4.3, Ant: tab3.1 to tab3.3); ``silem-mlp`` takes SILEM's; ``ppo`` the common table (tab2);
    ``random`` has none. A body that the paper does not know takes HalfCheetah0's combination of
    SILEM, which agrees with the common table.

    Args:
        body: The learner's body, e.g. ``"HC1"``.
        method: ``"ppo"``, ``"random"``, ``"silem"``, ``"silem-minus"``, ``"silem-minus-own"`` or
            ``"silem-mlp"``.
        demonstrations: The expert's body. ``silem-minus`` from the learner's own expert is
            ``silem-minus-own``, except on a family's original body, where both cells exist and
            the method's name alone tells them apart.

    Returns:
        Mapping with the names of ``HyperParameters``; only what the paper prints for the method,
        so SILEM⁻ has no entry for the transform.

    Raises:
        SilemError: If the method is unknown.
    """
    known = {name for t in tables().values() for name in t.methods} | set(_TABLE_METHOD)
    choose("method", method, sorted(known | {"ppo", "random"}))
    if method == "random":
        return {}
    if method == "ppo":
        return {name: common()[name] for name in ("n_epochs", "minibatch_size")}
    if method == "silem-minus" and demonstrations == body and body not in _ORIGINAL_BODIES:
        method = "silem-minus-own"
    row = _best_row(body, method)
    if row is None and method.startswith("silem"):
        row = _best_row(*_DEFAULT_ROW)
    if row is None:
        raise SilemError(f"the paper has no hyper-parameters for {method} on {body!r}")
    if method.startswith("silem-minus"):
        row = {symbol: value for symbol, value in row.items() if symbol not in _TRANSFORM_SYMBOLS}
    return {
        symbols()[symbol].parameter: float(value) if symbols()[symbol].real else value
        for symbol, value in row.items()
    }


def grid_values(key: str) -> dict[str, list[Any]]:
    """Return a searched grid as symbol -> values, e.g. ``grid_values("tab4")["n"] == [10, 20]``.

    Raises:
        SilemError: If the table is not a grid.
    """
    chosen = table(key)
    if chosen.kind != "grid":
        raise SilemError(f"table {key!r} is a table of kind {chosen.kind!r}, not a grid")
    return {row["symbol"]: list(row["values"]) for row in chosen.rows}


def _best_row(body: str, method: str) -> dict[str, Any] | None:
    """Return the printed best combination as symbol -> value, or None where there is none."""
    chosen = best_table(body, method)
    for row in chosen.rows if chosen else ():
        if _body_names()[row["body"]] == body:
            return {symbol: value for symbol, value in row.items() if symbol != "body"}
    return None


@cache
def _body_names() -> dict[str, str]:
    """Map the tables' names of bodies to this project's."""
    return dict(_read("bodies")["names"])


def _read(name: str) -> dict[str, Any]:
    """Parse one file of ``silem/paper``."""
    path = Path(__file__).with_name(f"{name}.toml")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise SilemError(f"cannot read {path}: {error}") from error
