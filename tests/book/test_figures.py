"""The figures that are committed as files."""

from __future__ import annotations

from pathlib import Path

from silem.report import bookfigures


def test_committed_figures_show_the_committed_records(tmp_path: Path) -> None:
    stale = [
        path.name
        for path in bookfigures.draw(tmp_path)
        if path.read_bytes() != (bookfigures.FOLDER / path.name).read_bytes()
    ]
    assert stale == [], "run `make figures` and commit what it draws"
