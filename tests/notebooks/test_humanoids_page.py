"""The page on the humanoids, on a machine that cannot draw offscreen."""

from __future__ import annotations

import pytest
from conftest import Execute, glue_roles, output, said, words

NAME = "10_humanoids"


@pytest.mark.usefixtures("only_demonstrations", "no_offscreen_rendering")
def test_without_offscreen_rendering(execute: Execute) -> None:
    page = execute(NAME, body="Atlas", n_episodes=2)
    for cell_id in ("limp", "random"):
        note = output(page, cell_id)
        assert "<video" not in note
        assert "No video" in words(note) and "MUJOCO_GL" in note
    for cell_id in ("fig-3a", "fig-reward"):
        assert output(page, cell_id).startswith("<svg")
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    assert (spoken["right_factor"], spoken["left_factor"], spoken["ankle_rad"]) == (
        "1.5",
        "0.5",
        "0.1",
    )
    assert spoken["n_episodes"] == "2"
    distances = words(output(page, "distances"))
    assert "Humanoid 1.26 1.26 0.00 0.40 0.40 0.00" in distances
    assert "Atlas 0.99 1.08 +0.09 0.91 0.98 +0.07" in distances
    assert "r_leg_akx −0.10 0.10 45" in words(output(page, "joints"))
    assert "skeletal features 23 action 28" in words(output(page, "gymnasium"))
