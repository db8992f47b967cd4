"""What README and book tell a reader to type works as they say."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from silem import cli as command_line
from silem.util.paths import REPO

PAGES = ["README.md", "book/how_to_run.md", "book/deviations.md"]
SMALL = {
    "[...]  ": "[np.random.default_rng(i).normal(size=(30, 3)) for i in range(3)]  ",
    "100_000": "2048",
    "progress_bar=True": "progress_bar=False",
}


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (REPO / page).read_text(), flags=re.DOTALL)


def readme_snippet() -> str:
    """README's Python, with numbers that take seconds; `test_install` runs it."""
    code = "import numpy as np\n" + "\n".join(blocks("README.md", "python"))
    for shown, small in SMALL.items():
        assert shown in code
        code = code.replace(shown, small)
    return code


def commands() -> list[str]:
    found = []
    for page in PAGES:
        for block in blocks(page, "bash"):
            lines = block.replace("\\\n", " ").splitlines()
            found += [line for line in lines if re.match(r"(python -m )?silem ", line)]
    return sorted(set(found))


@pytest.mark.parametrize("command", commands())
def test_commands_are_understood(command: str) -> None:
    words = shlex.split(command.removeprefix("python -m "), comments=True)[1:]
    if {"--help", "--version"} & {*words}:
        with pytest.raises(SystemExit, match="0"):
            command_line.main(words)
    else:
        assert callable(command_line.parser().parse_args(words).command)


def test_the_readmes_commands_work_as_printed_in_a_fresh_shell(tmp_path: Path) -> None:
    """In the repository, where other demonstrations of HC0 are committed; `tiny` for `quick`."""
    (script,) = [block for block in blocks("README.md", "bash") if "silem run" in block]
    binaries = tmp_path / "bin"
    binaries.mkdir()
    (binaries / "silem").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m silem "$@"\n')
    (binaries / "silem").chmod(0o755)
    script = script.replace("quick", "tiny").replace(". .venv/bin/activate", ":")
    done = subprocess.run(
        ["bash", "--noprofile", "--norc", "-euc", script],
        cwd=REPO, env={"HOME": str(tmp_path), "PATH": f"{binaries}:/usr/bin:/bin"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "silem-data" / "demonstrations" / "HC0.npz").exists()
    assert done.stdout.count("record.json\n") == 3


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", *PAGES[1:]])
def test_files_and_targets_that_are_named_exist(page: str) -> None:
    text = (REPO / page).read_text()
    named = re.findall(r"`((?:silem|notebooks|book|tests|\.ci)/[\w./-]+)`", text)
    assert [name for name in named if not (REPO / name).exists()] == []
    targets = re.findall(r"^([a-z]+):", (REPO / "Makefile").read_text(), flags=re.MULTILINE)
    assert set(re.findall(r"\bmake ([a-z]+)`", text)) <= set(targets)
