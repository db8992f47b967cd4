"""The page of the demonstration: another clip, and a machine that cannot draw offscreen."""

from __future__ import annotations

import nbformat
import pytest
from conftest import Execute, glue_roles, output, path_of, said, words

from silem.motion import clips
from silem.motion.demonstrator import CLIPS

NAME = "09_demonstration"


@pytest.mark.usefixtures("only_demonstrations", "no_offscreen_rendering")
def test_without_offscreen_rendering(execute: Execute) -> None:
    page = execute(NAME, clip="08_07")
    note = words(output(page, "film"))
    assert "No video" in note and "MUJOCO_GL" in note
    assert "<video" not in output(page, "film")
    for cell_id in ("poses", "features"):
        assert output(page, cell_id).startswith("<svg")
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    assert (spoken["clip"], spoken["n_states"], spoken["speed_m_s"]) == ("08_07", "101", "1.72")
    assert "08_07.amc" in words(output(page, "origin"))
    table = words(output(page, "clips"))
    assert all(clip in table for clip in CLIPS)
    assert "frames 2, 3, 4, 5, 6 repeat the one before" in table


def test_the_acknowledgement_is_word_for_word() -> None:
    cells = nbformat.read(path_of(NAME), as_version=4).cells
    prose = "\n".join(cell.source for cell in cells if cell.cell_type == "markdown")
    assert clips.ACKNOWLEDGEMENT in " ".join(prose.replace("\n> ", " ").split())
