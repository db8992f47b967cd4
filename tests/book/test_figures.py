"""The figures that are committed as files."""

from __future__ import annotations

from pathlib import Path

from silem.report import build
from silem.util.paths import REPO


def test_committed_figures_show_the_committed_records(tmp_path: Path) -> None:
    stale = [
        path.name
        for path in build.draw_figures(tmp_path)
        if path.read_bytes() != (REPO / "book" / "figures" / path.name).read_bytes()
    ]
    assert stale == [], "run `make figures` and commit what it draws"
