"""The wheel: what is in it, what it needs, and that it works in an environment of its own.

It is installed beside the packages that are here already, with no network. With
``SILEM_TEST_INSTALL=index``, as in CI, the environment is empty and pip fetches what the wheel asks
for.
"""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib
import venv
import zipfile
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import NamedTuple

import pytest
from test_examples import readme_snippet

import silem
from silem.util.paths import REPO

FROM_INDEX = os.environ.get("SILEM_TEST_INSTALL") == "index"


class Installed(NamedTuple):
    wheel: Path
    bin: Path


def run(*command: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command with nothing of this checkout in its environment."""
    env = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "SILEM_DATA_DIR")}
    return subprocess.run(
        [str(word) for word in command],
        cwd=cwd, env=env, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    folder = tmp_path_factory.mktemp("wheel")
    built = run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder, cwd=REPO)
    assert built.returncode == 0, built.stderr
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "env")
    binaries = folder / "env" / "bin"
    pip = sys.executable, "-m", "pip", "--python", binaries / "python"
    options = [] if FROM_INDEX else ["--no-deps", "--no-index"]
    done = run(*pip, "install", "--quiet", *options, wheel, cwd=folder)
    assert done.returncode == 0, done.stderr
    if not FROM_INDEX:
        (site,) = (folder / "env" / "lib").glob("python*/site-packages")
        here = [path for path in sys.path if path.endswith("-packages")]
        (site / "here.pth").write_text("\n".join(here))
    return Installed(wheel, binaries)


def test_the_readmes_snippet_runs_from_another_folder(installed: Installed, tmp_path: Path) -> None:
    code = f"{readme_snippet()}\nprint(silem.__file__)"
    done = run(installed.bin / "python", "-c", code, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith(str(installed.bin.parent))
    assert (tmp_path / "pendulum.zip").exists()


def test_runs_of_an_installed_package(installed: Installed, tmp_path: Path) -> None:
    """Constants, tables and the human's clip are found, and results go to the working folder."""
    words = "run --body Atlas --method silem --budget tiny --quiet".split()
    done = run(installed.bin / "silem", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    record = Path(done.stdout.splitlines()[-1])
    assert record.is_relative_to(tmp_path / "silem-data" / "runs" / "humanoid")
    assert '"git_commit": null' in record.read_text()
    again = run(installed.bin / "python", "-m", "silem", *words, cwd=tmp_path)
    assert again.stdout == done.stdout
    version = run(installed.bin / "silem", "--version", cwd=tmp_path)
    assert version.stdout == f"silem {silem.__version__}\n"


def test_what_needs_a_checkout_says_so(installed: Installed, tmp_path: Path) -> None:
    code = "from silem.util import paths; print(paths.checkout()); paths.REPO"
    done = run(installed.bin / "python", "-c", code, cwd=tmp_path)
    assert done.stdout == "None\n"
    assert "SilemError: the book and its figures need a checkout" in done.stderr


def test_a_clone_beside_a_script_does_not_shadow_the_package(
    installed: Installed, tmp_path: Path
) -> None:
    (tmp_path / "silem" / "silem").mkdir(parents=True)
    (tmp_path / "silem" / "silem" / "__init__.py").touch()
    (tmp_path / "script.py").write_text("import silem; print(silem.__version__)")
    done = run(installed.bin / "python", "script.py", cwd=tmp_path)
    assert done.stdout == f"{silem.__version__}\n", done.stderr


def test_the_wheel_holds_the_package_and_its_data_alone(installed: Installed) -> None:
    names = zipfile.ZipFile(installed.wheel).namelist()
    assert {name.partition("/")[0] for name in names} == {
        "silem",
        f"silem-{silem.__version__}.dist-info",
    }
    needed = ["bodies/atlas.xml", "clips/cmu_08_01.npz", "clips/manifest.json", "paper/text.toml"]
    assert {f"silem/{name}" for name in (*needed, "py.typed")} <= set(names)
    assert not [name for name in names if "HC0" in name]
    assert installed.wheel.stat().st_size < 4e6


def test_every_import_is_declared() -> None:
    project = tomllib.loads((REPO / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    declared = {"library": names(project["dependencies"])}
    declared["video"] = declared["library"] | names(extras["video"])
    declared["book"] = declared["video"] | names(extras["book"])
    declared["dask"] = declared["library"] | names(extras["dask"])
    declared["test"] = declared["book"] | names(extras["dask"]) | names(extras["test"])
    pinned = names((REPO / "environment.txt").read_text().splitlines())
    assert {area: sorted(undeclared(area, declared[area])) for area in declared} == {
        area: [] for area in declared
    }
    indirect = {
        "docutils",
        "ipython",
        "myst-nb",
        "nbformat",
        "pillow",
        "pyyaml",
        "sphinx",
        "traitlets",
    }
    assert declared["test"] - {"silem"} - indirect <= pinned


def names(requirements: list[str]) -> set[str]:
    """Return the names of distributions that requirements ask for."""
    found = [re.match(r"[A-Za-z0-9._-]+", line) for line in requirements]
    return {canonical(match[0]) for match in found if match}


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def undeclared(area: str, declared: set[str]) -> set[str]:
    """Return the third-party modules that a part of the code imports without a requirement."""
    submit = REPO / "silem" / "study" / "submit.py"
    library = [p for p in (REPO / "silem").rglob("*.py") if "report" not in p.parts]
    report = list((REPO / "silem" / "report").rglob("*.py"))
    tests = [*(REPO / "tests").rglob("*.py"), *(REPO / "benchmarks").rglob("*.py")]
    files = {
        "library": [path for path in library if path != submit],
        "dask": [submit],
        "video": [path for path in report if path.stem == "film"],
        "book": report,
        "test": tests,
    }[area]
    own = {"silem", "benchmarks"} | {path.stem for path in tests}
    distributions = packages_distributions()
    return {
        module
        for module in set().union(*map(imported, files)) - own - sys.stdlib_module_names
        if not {canonical(name) for name in distributions.get(module, [module])} & declared
    }


def imported(path: Path) -> set[str]:
    """Return the top-level modules that a file imports anywhere."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module)
    return {name.partition(".")[0] for name in found}
