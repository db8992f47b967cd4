"""The page on retargeting, on a machine that cannot draw offscreen."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from conftest import REPO, Execute, glue_roles, output, said

NAME = "11_retargeting"


def text_of(html: str) -> str:
    return " ".join(re.sub(r"<style.*?</style>|<[^>]*>", " ", html, flags=re.DOTALL).split())


def test_without_offscreen_rendering(
    execute: Execute, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "data"  # nothing but the committed demonstrations
    shutil.copytree(REPO / "data" / "demonstrations", folder / "demonstrations")
    monkeypatch.setenv("SILEM_DATA_DIR", str(folder))
    monkeypatch.setenv("MUJOCO_GL", "disable")
    page = execute(NAME, body="Atlas", film_all=True, video_s=2.3)
    note = output(page, "film")
    assert "<video" not in note
    assert "No video" in text_of(note) and "MUJOCO_GL" in note
    for cell_id in ("poses", "residuals", "limits", "skate"):
        assert output(page, cell_id).startswith("<svg")
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    assert (spoken["tolerance_mm"], spoken["converged_Atlas"]) == ("30", "39")
    ratios = text_of(output(page, "ratios"))
    assert "HumanoidR's over his 0.98 0.59 1.77" in ratios.replace("&#x27;", "'")
    assert text_of(output(page, "hands")).count("100 100") == 6
