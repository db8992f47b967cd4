"""The generated box and the film's caption, and that the pages hold what is true now."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import synthetic_records as synthetic
import yaml

from silem.report import claims, glance
from silem.report.web import BODIES
from silem.study.config import RunConfig
from silem.study.studies import cells
from silem.util.errors import SilemError
from silem.util.paths import REPO


@pytest.fixture
def made_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """SILEM fails on HC2 and is now better, now worse on HC1; one run of it on Humanoid."""
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    synthetic.write_study()
    (wavers,) = (c for c in cells("halfcheetah") if (c.method, c.body) == ("silem", "HC1"))
    for seed, score in enumerate((0.7, 1.1, 0.7, 1.1, 0.9)):
        goal = score * synthetic.EXPERT_RETURNS["HC1"]
        synthetic.write_record(wavers.config("book", seed), goal)
    for cell in cells("humanoids"):
        if (cell.method, cell.body) == ("silem", "Humanoid"):
            synthetic.write_record(cell.config("book", 0), 840.0)
    return tmp_path


def row(box: str, start: str) -> list[str]:
    line = next(line for line in box.splitlines() if line.startswith(f"| {start}"))
    return [cell.strip() for cell in line.strip("|").split("|")]


@pytest.mark.parametrize("page", glance.PAGES, ids=lambda page: page.name)
def test_the_pages_say_what_the_committed_records_say(
    page: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("SILEM_DATA_DIR", raising=False)
    assert page.read_text() == glance.filled(page), "run `make figures` and commit what it writes"
    assert glance.FIGURE.read_text() == glance.figure(), "run `make figures`"


def test_what_fails_stands_beside_what_holds(made_up: Path) -> None:
    box = glance.box()
    assert row(box, "SILEM reaches expert level")[1:] == [
        "HC0", "HC2", "HC1 (interval spans the bound)",
    ]  # fmt: skip
    assert row(box, "SILEM far outperforms TPIL")[3] == (
        "Atlas, Humanoid, HumanoidR (too few trials)"
    )
    titles = {claim.title for study in glance.FAMILIES for claim in claims.of(study)}
    assert all(f"| {title} |" in box for title in titles)
    heads = [line for line in box.splitlines() if line.startswith("| claim |")]
    counts = [[int(n) for n in re.findall(r"\((\d+)\)", head)] for head in heads]
    assert [sum(found) for found in counts] == [len(claims.of(s)) for s in glance.FAMILIES]
    assert counts[0][1] >= 1 and counts[1:] == [[0, 0, 34], [0, 0, 27]]


def test_the_box_counts_trainings_and_hours(made_up: Path) -> None:
    # 13 cells of HalfCheetah are trained, five times each, and one humanoid, 420 s each.
    assert "66 finished trainings" in (box := glance.box())
    assert f"and {66 * 420 / 3600:.1f} hours of wall time, on" in box
    assert "(1 to 5 in each cell" in box
    assert "](../book/figures/halfcheetah.svg)" in glance.box("../")


def test_hours_are_processor_time_where_it_was_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    first, second = (RunConfig.create("HC0", "ppo", budget="book", seed=s) for s in (0, 1))
    synthetic.write_record(first, processor_time_s=3 * 3600.0)
    assert "and 3.0 hours of processor time, on" in glance.box()  # no hours by the clock: 420 s
    synthetic.write_record(second)
    assert "3.0 hours of processor time and 0.1 hours of wall time where that was not counted" in (
        box := glance.box()
    )
    assert "(one trial), on one processor core" in box


def test_the_films_caption_says_how_many_stand_behind_it(made_up: Path) -> None:
    caption = glance.film()
    assert "SILEM has one trial on 1 of 3 bodies (Humanoid 1), of which 1 walks" in caption
    assert "SILEM⁻ has no run" in caption and BODIES["Humanoid"] in caption


def test_without_any_run_the_box_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    assert "0 finished trainings" in glance.box() and "SILEM has no run" in glance.film()


def test_a_block_without_its_end_is_refused(made_up: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- film: begin -->\nold\n<!-- film: end -->\nafter")
    assert glance.filled(page) == (
        f"before\n<!-- film: begin -->\n{glance.film()}\n<!-- film: end -->\nafter"
    )
    for text in ("no block", "<!-- film: begin -->\nold", "<!-- flim: begin --><!-- flim: end -->"):
        page.write_text(text)
        with pytest.raises(SilemError, match=r"page\.md: a generated block"):
            glance.filled(page)


def test_the_film_is_of_a_run_that_is_committed() -> None:
    assert (REPO / "data" / "results" / "humanoids" / BODIES["Humanoid"]).is_dir()


def test_the_introduction_lists_every_page() -> None:
    toc = yaml.safe_load((REPO / "_toc.yml").read_text())
    chapters = {chapter["file"] for part in toc["parts"] for chapter in part["chapters"]}
    table = re.findall(r"^\| \[\]\(([^)]+)\)", (REPO / "book/intro.md").read_text(), re.MULTILINE)
    listed = [str((REPO / "book" / link).resolve().relative_to(REPO)) for link in table]
    assert {name.rpartition(".")[0] for name in listed} == chapters
    assert len(set(listed)) == len(listed)
