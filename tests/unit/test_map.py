"""The map: rooms import from the left only, and no module imports itself in a circle."""

import ast
import graphlib
from collections.abc import Iterator
from pathlib import Path

import pytest

import silem

ROOMS = ["util", "paper", "bodies", "motion", "envs", "algorithms", "study", "report"]
ROOT = Path(silem.__file__).parent
PATHS = {path.relative_to(ROOT.parent).with_suffix(""): path for path in sorted(ROOT.rglob("*.py"))}
MODULES = {".".join(name.parts).removesuffix(".__init__"): path for name, path in PATHS.items()}


def imports(module: str, *, at_start: bool) -> Iterator[str]:
    """Yield the package's modules that one imports: all of them, or those of its own top level."""
    tree = ast.parse(MODULES[module].read_text())
    for node in tree.body if at_start else ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            while name and name not in MODULES:
                name = name.rpartition(".")[0]
            if name not in ("", "silem", module):
                yield name


def room(module: str) -> str:
    return module.split(".")[1]


@pytest.mark.parametrize("module", [name for name in MODULES if name.count(".") > 1])
def test_a_room_imports_from_the_left_only(module: str) -> None:
    allowed = ROOMS[: ROOMS.index(room(module)) + 1]
    wrong = {name for name in imports(module, at_start=False) if room(name) not in allowed}
    assert not wrong, f"{module} imports {wrong}"


def test_no_module_imports_itself_in_a_circle() -> None:
    graph = {name: set(imports(name, at_start=True)) for name in MODULES if name != "silem"}
    list(graphlib.TopologicalSorter(graph).static_order())  # raises CycleError


def test_the_library_is_small() -> None:
    """A newcomer reads it in an afternoon; whoever needs more room makes room first."""
    library = {name: path for name, path in MODULES.items() if room(name + ".") != "report"}
    lines = sum(len(path.read_text().splitlines()) for path in library.values())
    assert lines <= 9_510
    assert len([path for path in library.values() if path.name != "__init__.py"]) <= 40
    assert len([path for path in ROOT.iterdir() if path.is_file()]) <= 6


def test_the_books_code_is_small() -> None:
    """Figures, tables and pages too: most of a page is a few lines around what is there."""
    report = [path for name, path in MODULES.items() if room(name + ".") == "report"]
    assert sum(len(path.read_text().splitlines()) for path in report) <= 5_745
