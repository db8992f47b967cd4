"""Executing notebooks and laying out the book."""

from __future__ import annotations

from pathlib import Path

import nbformat
import papermill
import pytest
from nbformat import v4

from silem.report import build, reads
from silem.util.errors import SilemError
from silem.util.paths import REPO


def write_notebook(path: Path, *sources: str) -> Path:
    cells = [v4.new_markdown_cell("# Title"), *map(v4.new_code_cell, sources)]
    cells[1].metadata["tags"] = ["parameters"]
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    nbformat.write(v4.new_notebook(cells=cells, metadata={"kernelspec": kernel}), path)
    return path


def test_executed_copies_hold_outputs_and_a_failure_names_its_notebook(tmp_path: Path) -> None:
    good = write_notebook(tmp_path / "01_good.ipynb", "x = 1", "print(x + 41)")
    bad = write_notebook(tmp_path / "02_bad.ipynb", "x = 1", "raise RuntimeError('no such expert')")
    with pytest.raises(SilemError, match=r"(?s)02_bad failed.*no such expert") as caught:
        build.execute([good, bad], tmp_path / "out", n_workers=2, parameters={})
    assert "01_good" not in str(caught.value)
    executed = nbformat.read(tmp_path / "out" / "01_good.ipynb", as_version=4)
    assert executed.cells[-1].outputs[0].text == "42\n"
    assert nbformat.read(good, as_version=4).cells[-1].outputs == []


def test_parameters_are_injected_and_folded_away(tmp_path: Path) -> None:
    parameters = {"01_page": {"budget": "book"}}
    path = write_notebook(tmp_path / "01_page.ipynb", "budget = 'tiny'", "print(budget)")
    build.execute([path], tmp_path / "out", 1, parameters)
    build.stage(tmp_path / "out", tmp_path / "source")
    staged = nbformat.read(tmp_path / "source" / "notebooks" / "01_page.ipynb", as_version=4)
    (injected,) = [c for c in staged.cells if "injected-parameters" in c.metadata.get("tags", [])]
    assert "hide-input" in injected.metadata["tags"]
    assert staged.cells[-1].outputs[0].text == "book\n"
    assert (tmp_path / "source" / "book" / "method.md").exists()


@pytest.mark.parametrize("empty", [True, False])
def test_what_shows_runs_is_left_out_where_there_are_none(tmp_path: Path, empty: bool) -> None:
    sources = [("needs-runs", "a"), ("with-runs", "b"), ("", "c"), ("needs-runs", "d")]
    sources += [("with-runs", "e")]
    cells = []
    for tag, source in sources:
        cells.append(v4.new_code_cell(source, metadata={"tags": [tag]} if tag else {}))
    if empty:
        html = f'<div class="admonition note {build.NO_RUNS}"><p>None.</p></div>'
        cells[0].outputs = [v4.new_output("display_data", {"text/html": html})]
    (tmp_path / "out").mkdir()
    nbformat.write(v4.new_notebook(cells=cells), tmp_path / "out" / "01_page.ipynb")
    build.stage(tmp_path / "out", tmp_path / "source")
    staged = nbformat.read(tmp_path / "source" / "notebooks" / "01_page.ipynb", as_version=4)
    assert "".join(cell.source for cell in staged.cells) == ("acde" if empty else "abcde")


def test_the_books_parameters_are_parameters_of_its_notebooks() -> None:
    paths = {path.stem: path for path in build.notebooks()}
    for name, parameters in build.BOOK_PARAMETERS.items():
        assert parameters.keys() <= papermill.inspect_notebook(paths[name]).keys()


@pytest.mark.parametrize(
    ("text", "builds"), [("# Page\n\n[](other.md)\n", False), ("# Page\n\nText.\n", True)]
)
def test_a_reference_that_leads_nowhere_fails_the_build(
    tmp_path: Path, text: str, builds: bool
) -> None:
    source = tmp_path / "source"
    source.mkdir()
    (source / "_config.yml").write_text("title: t\nauthor: a\n")
    (source / "_toc.yml").write_text("format: jb-book\nroot: page\n")
    (source / "page.md").write_text(text)
    if builds:
        for builder in ("html", "singlehtml"):
            pages = build.sphinx(source, tmp_path, builder)
            assert pages.name == builder and (pages / "page.html").exists()
    else:
        with pytest.raises(SilemError, match="did not build"):
            build.sphinx(source, tmp_path)


def test_the_table_of_contents_lists_every_notebook() -> None:
    toc = (REPO / "_toc.yml").read_text()
    assert [p.stem for p in build.notebooks() if f"notebooks/{p.stem}\n" not in toc] == []


def test_a_notebook_runs_again_only_when_it_or_what_it_read_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path / "data"))
    data = tmp_path / "data" / "results" / "study"
    (data / "one").mkdir(parents=True)
    (data / "one" / "record.json").write_text("1")
    path = write_notebook(
        tmp_path / "01_page.ipynb", "x = 1",
        f"import pathlib, time; print(time.time_ns(), [p.read_text() for p in"
        f" pathlib.Path({str(data)!r}).glob('*/record.json')], x)",
    )  # fmt: skip

    def fresh(**parameters: int) -> bool:
        return reads.is_fresh(path, tmp_path / "out" / path.name, parameters)

    build.execute([path], tmp_path / "out", 1, {})
    first = (tmp_path / "out" / path.name).read_text()
    (tmp_path / "data" / "unread.txt").write_text("nobody reads this")
    assert fresh() and not fresh(x=2)
    build.execute([path], tmp_path / "out", 1, {})
    assert (tmp_path / "out" / path.name).read_text() == first  # with its time
    (data / "one" / "record.json").write_text("2")
    assert not fresh()
    (data / "one" / "record.json").write_text("1")
    assert fresh()
    (data / "two").mkdir()  # a run that was not there
    assert not fresh()
    (data / "two").rmdir()
    path.write_text(path.read_text().replace(", x)", ", x, 'changed')"))
    assert not fresh()
