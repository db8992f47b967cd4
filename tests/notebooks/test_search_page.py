"""The page of the supplement's search: a finished one with its winner, one that has begun, none."""

from __future__ import annotations

from pathlib import Path

import pytest
import synthetic_records as synthetic
from conftest import Execute, glue_roles, output, said, words

from silem.study.studies import fresh_configs, ranking, study_configs

NAME = "15_search"
DONE, BEGUN = "halfcheetah/HC2/silem", "ant/Ant3/silem"
N = 8


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """HC2's search: small minibatches are best, the third by luck; of Ant3's two configurations."""
    folder = tmp_path_factory.mktemp("search")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SILEM_DATA_DIR", str(folder))
        configs = study_configs(DONE, "quick", 2, N)
        for config in configs:
            lucky = 900 if config.hyper == configs[2].hyper else 0
            synthetic.write_record(config, 12800 / config.hyper.minibatch_size + lucky)
        for config in fresh_configs(DONE, "quick", 2, N):
            synthetic.write_record(config, 12800 / config.hyper.minibatch_size)
        for i, config in enumerate(study_configs(BEGUN, "quick", 2, N)[: N + 2]):
            synthetic.write_record(config, 500.0 + 20 * i)
    return folder


@pytest.fixture
def data_dir(made_up: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stand in for the folder of the other pages' made-up study."""
    monkeypatch.setenv("SILEM_DATA_DIR", str(made_up))
    return made_up


def text(page: object, cell_id: str) -> str:
    (cell,) = [cell for cell in page.cells if cell.id == cell_id]
    return "".join(str(item.data.get("text/markdown", "")) for item in cell.outputs)


def test_search(execute: Execute) -> None:
    page = execute(NAME, sample=N)
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    assert [spoken[f"n_grid_{body}"] for body in ("HC2", "Ant3")] == ["64", "240"]
    assert spoken["n_iterations"] == "60"
    first, *others = ranking(DONE, "quick", 2, N)
    table = words(output(page, "hc2-ranking"))
    assert f"{first.score:,.0f} " in table and table.count("(supplement)") == 1
    place = next(i for i, entry in enumerate(others, 2) if entry.is_papers)
    assert f"combination is on place {place} of {N}" in text(page, "hc2-says")
    assert "Configurations differ by more than the trials" in text(page, "hc2-says")
    assert f"2 of {N} configurations" in text(page, "ant3-says")
    for name in ("hc2", "ant3"):
        assert output(page, f"{name}-sensitivity").startswith("<svg")
    assert "data/results/search-halfcheetah-HC2-silem" in output(page, "hc2-runs")
    gone = f"{sum(first.fresh) / 3 - first.score:,.0f}".replace("-", "−")
    assert int(gone.replace("−", "-")) < -800 and f" {gone} [" in table
    assert f"silem search {DONE} --budget quick --sample {N} --trials 2" in output(page, "again")


def test_without_any_run_the_page_says_so(execute: Execute) -> None:
    page = execute(NAME, budget="tiny", n_iterations=2)
    assert glue_roles(page) <= said(page).keys()
    for name in ("hc2", "ant3"):
        assert "not run yet" in words(output(page, f"{name}-ranking"))
        assert "not run yet" in text(page, f"{name}-says")
        assert output(page, f"{name}-sensitivity").startswith("<svg")
        assert "0 runs, 48 of the planned runs" in words(output(page, f"{name}-runs"))
    assert "No run of the search on HC2 is finished; 48" in words(output(page, "hc2-needs"))
    assert "--iterations 2" in output(page, "again")
