"""The page on retargeting, on a machine that cannot draw offscreen."""

from __future__ import annotations

import pytest
from conftest import Execute, glue_roles, output, said, words

NAME = "11_retargeting"


@pytest.mark.usefixtures("only_demonstrations", "no_offscreen_rendering")
def test_without_offscreen_rendering(execute: Execute) -> None:
    page = execute(NAME, body="Atlas", film_all=True, video_s=2.3)
    note = output(page, "film")
    assert "<video" not in note
    assert "No video" in words(note) and "MUJOCO_GL" in note
    for cell_id in ("poses", "residuals", "limits", "skate"):
        assert output(page, cell_id).startswith("<svg")
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    assert (spoken["tolerance_mm"], spoken["converged_Atlas"]) == ("30", "39")
    ratios = words(output(page, "ratios"))
    assert "HumanoidR's over his 0.98 0.59 1.77" in ratios.replace("&#x27;", "'")
    assert "1 / a of SILEM, no run" in words(output(page, "scales"))
    assert words(output(page, "hands")).count("100 100") == 6
