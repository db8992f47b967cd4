"""The page of the seven Ants, on a made-up study with holes and without any run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import synthetic_records as synthetic
from conftest import Execute, add_untrained_policy, glue_roles, output, path_of, said, words
from test_structure import prose

from silem.report import claims, results
from silem.report.film import why_no_pictures
from silem.report.pages import ants
from silem.study.studies import study_configs

NAME = "14_ants"
FIGURES = ("fig-2d", "curves", "transforms", "tracking")
MISSING = {("silem", "Ant5"): 0, ("silem-minus", "Ant3"): 1, ("ppo", "Ant2"): 2}


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three trials of every Ant, some missing; absorbing states on Ant0 alone."""
    folder = tmp_path_factory.mktemp("ants")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SILEM_DATA_DIR", str(folder))
        written = synthetic.write_study(n_trials=3, study="ant", without=MISSING)
        for config in study_configs("ant-absorbing", "book", body=["Ant0"]):
            synthetic.write_record(config)
        for record in written:
            config = record.run_config
            filmed = config.seed == 0 and config.body in ("Ant0", "Ant6")
            if filmed and config.method.startswith("silem"):
                add_untrained_policy(config)
    return folder


@pytest.fixture
def data_dir(made_up: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stand in for the folder of the other pages' made-up study."""
    monkeypatch.setenv("SILEM_DATA_DIR", str(made_up))
    return made_up


def test_the_page_types_no_results() -> None:
    assert re.findall(r"\d+\.\d+|\b\d{3,}\b", prose(path_of(NAME))) == []


def test_ants(execute: Execute) -> None:
    page = execute(NAME, budget="book", video_s=0.1)
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    frame = results.load_records("ant", "book")
    score = results.scores(frame, "silem", "Ant6").mean()
    assert spoken["silem_Ant6"] == f"{score:.2f}"
    level = results.scores(frame, "ppo", "Ant6", "return_mean").mean()
    assert spoken["standing_Ant6"] == f"{1000 / level:.2f}"
    assert spoken["n_experts"] == str(len(results.select(frame, ["ppo"])))
    assert spoken["n_iterations"] == "1,000"
    for cell_id in FIGURES:
        assert output(page, cell_id).startswith("<svg"), cell_id
    low = [results.scores(frame, "silem-minus", "Ant6", name) for name in ("return_mean", "steps")]
    (returned, steps), cells = [f"{values.mean():,.0f}" for values in low], output(page, "cells")
    assert re.search(rf"\(Ant0 expert\) 3 {returned} \S+ to \S+ {steps} ", words(cells))
    absorbing = words(output(page, "absorbing"))
    assert re.search(r"Ant0 SILEM no 3 2,\d{3} 1,000", absorbing)
    assert re.search(r"Ant0 SILEM yes 3 2,\d{3} 1,000 \S+ \S+ \S+ \[", absorbing)
    assert "A forward velocity" in words(output(page, "tracking-says"))
    claimed = words(output(page, "claims"))
    assert all(claim.text in claimed for claim in claims.of("ant"))
    assert "SILEM Ant5 0; 3 needed" in claimed
    missing = words(output(page, "missing")).partition("not made yet (")[2]
    assert missing.count("silem run") == len(frame.attrs["missing"])
    if not why_no_pictures("Ant6"):
        assert "SILEM | SILEM⁻ | SILEM⁻ own" in words(output(page, "film-Ant6"))


def test_without_any_run_the_page_says_so(execute: Execute) -> None:
    page = execute(NAME, budget="tiny")
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    assert {spoken[name] for name in ("silem_Ant0", "share_Ant6", "steps_ppo_Ant0")} == {"–"}
    assert (spoken["n_experts"], spoken["n_hold"]) == ("0", "0")
    assert spoken["n_undecided"] == spoken["n_claims"] == str(len(claims.of("ant")))
    assert "0 runs" in words(output(page, "records"))
    for cell_id in FIGURES:
        assert output(page, cell_id).startswith("<svg"), cell_id
    assert words(output(page, "absorbing")).count("Ant0 SILEM yes 0") == 1
    assert spoken["n_entries"] == "0"
    assert "Ant6, first trials, in real time: SILEM: no run yet" in words(output(page, "film-Ant6"))
    assert ants.correlations(results.load_records("ant", "tiny")).empty
    assert "No run of the Ants' study is finished; 175" in words(output(page, "needs"))
