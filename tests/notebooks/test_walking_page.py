"""The page about walking, on a made-up study of the humanoids and without any run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import synthetic_records as synthetic
from conftest import Execute, add_untrained_policy, glue_roles, output, path_of, said, words
from test_structure import prose

from silem.report import claims, results
from silem.report.film import why_no_pictures
from silem.report.pages import walking
from silem.study.config import RunConfig
from silem.study.studies import cells

NAME = "12_walking"
FIGURES = ("fig-3b", "reversal", "curves", "long-curve", "fig-4", "starts-curves")


def planned(study: str, method: str, body: str) -> RunConfig:
    (cell,) = [c for c in cells(study) if (c.method, c.body) == (method, body)]
    return cell.config("book", seed=0)


@pytest.fixture(scope="module")
def humanoids(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """SILEM and PPO on Humanoid that walk; falls on Atlas, and from other starts."""
    folder = tmp_path_factory.mktemp("humanoids")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SILEM_DATA_DIR", str(folder))
        starts = planned("demonstration-starts", "silem", "Humanoid")
        synthetic.write_record(starts, 90.0)
        add_untrained_policy(starts)
        configs = [planned("humanoids", method, "Humanoid") for method in ("silem", "ppo")]
        configs.append(planned("humanoids", "silem", "Atlas"))
        for config, return_mean in zip(configs, (840.0, 860.0, 60.0), strict=True):
            synthetic.write_record(config, return_mean)
        for config in configs:
            add_untrained_policy(config)
    return folder


@pytest.fixture
def data_dir(humanoids: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stand in for the folder of the other pages' made-up study."""
    monkeypatch.setenv("SILEM_DATA_DIR", str(humanoids))
    return humanoids


def test_the_page_types_no_results() -> None:
    assert re.findall(r"\d+\.\d+|\b\d{3,}\b", prose(path_of(NAME))) == []


def test_walking(execute: Execute) -> None:
    page = execute(NAME, budget="book", video_s=0.1)
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    frame = results.load_records("humanoids", "book")
    expected = walking.cell_sentences(frame, "x", "silem", "Humanoid")["x_steps"]
    assert int(spoken["Humanoid_steps"].replace(",", "")) == expected
    assert spoken["HumanoidR_steps"] == "–"
    assert [int(spoken[f"n_{name}"]) for name in ("cells", "walk", "fall")] == [3, 2, 1]
    for cell_id in FIGURES:
        assert output(page, cell_id).startswith("<svg"), cell_id
    assert "Atlas SILEM falls 1 " in words(output(page, "walks"))
    assert "SILEM demonstration's states falls 1 " in words(output(page, "starts"))
    assert "2,000" in words(output(page, "long"))
    claimed = words(output(page, "claims"))
    assert all(claim.text in claimed for claim in claims.of("humanoids"))
    assert int(spoken["n_undecided"]) == int(spoken["n_claims"])  # one trial decides nothing
    for cell_id, said_there in {
        "why": "Humanoid TPIL – – – not run yet", "search": "clip range 0.2 – – –",
        "limbs": "HumanoidR 0 1.32 → – ", "gap": "open: too few trials",
    }.items():  # fmt: skip
        assert said_there in words(output(page, cell_id)), cell_id
    assert "– (981 with it) on Humanoid, – (– with it) on HumanoidR" in spoken["without_penalty"]
    film = output(page, "film")
    assert "twelve cells, on one clock" in words(film)
    assert film.count("data:video/mp4;base64,") == (not why_no_pictures("Humanoid"))


def test_without_any_run_the_page_says_so(execute: Execute) -> None:
    page = execute(NAME, budget="tiny")
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    assert spoken["n_cells"] == "0"
    assert {spoken["longest"], spoken["Atlas_steps"], spoken["long_iterations"]} == {"–"}
    assert "0 runs" in words(output(page, "records"))
    for cell_id in FIGURES:
        assert output(page, cell_id).startswith("<svg"), cell_id
    for cell_id in ("walks", "long", "starts"):
        assert "no run" in words(output(page, cell_id))
