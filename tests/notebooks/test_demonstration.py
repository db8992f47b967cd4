"""The page of the demonstration: another clip, and a machine that cannot draw offscreen."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import nbformat
import pytest
from conftest import NOTEBOOKS, REPO, Execute, glue_roles, output, said

from silem.motion import clips
from silem.motion.demonstrator import CLIPS

NAME = "09_demonstration"


@pytest.fixture
def only_demonstrations(execute: Execute, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A data folder with nothing but the committed demonstrations: no results, no raw clips."""
    folder = tmp_path / "data"
    shutil.copytree(REPO / "data" / "demonstrations", folder / "demonstrations")
    monkeypatch.setenv("SILEM_DATA_DIR", str(folder))
    monkeypatch.setenv(clips.ENV, str(tmp_path / "nowhere"))


def text_of(html: str) -> str:
    return " ".join(re.sub(r"<style.*?</style>|<[^>]*>", " ", html, flags=re.DOTALL).split())


@pytest.mark.usefixtures("only_demonstrations")
def test_without_offscreen_rendering(execute: Execute, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    page = execute(NAME, clip="08_07")
    note = text_of(output(page, "film"))
    assert "No video" in note and "MUJOCO_GL" in note
    assert "<video" not in output(page, "film")
    for cell_id in ("poses", "features"):
        assert output(page, cell_id).startswith("<svg")
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    assert (spoken["clip"], spoken["n_states"], spoken["speed_m_s"]) == ("08_07", "101", "1.72")
    assert "08_07.amc" in text_of(output(page, "origin"))
    table = text_of(output(page, "clips"))
    assert all(clip in table for clip in CLIPS)
    assert "frames 2, 3, 4, 5, 6 repeat the one before" in table


def test_the_acknowledgement_is_word_for_word() -> None:
    (path,) = [path for path in NOTEBOOKS if path.stem == NAME]
    cells = nbformat.read(path, as_version=4).cells
    prose = "\n".join(cell.source for cell in cells if cell.cell_type == "markdown")
    assert clips.ACKNOWLEDGEMENT in " ".join(prose.replace("\n> ", " ").split())
