"""Every link inside the built book leads to a page, and to a place on it."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

# One worker reads the book: it is built once and opened by one browser.
pytestmark = [pytest.mark.built, pytest.mark.xdist_group("book")]

REFERENCES = {"href", "src", "poster", "data"}


class Targets(HTMLParser):
    """What a page refers to, and the places on it that can be referred to."""

    def __init__(self) -> None:
        super().__init__()
        self.references: set[str] = set()
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in REFERENCES and value:
                self.references.add(value)
            if name in ("id", "name") and value:
                self.anchors.add(value)


def read(page: Path, cache: dict[Path, Targets]) -> Targets:
    if page not in cache:
        cache[page] = Targets()
        cache[page].feed(page.read_text())
    return cache[page]


def broken_links(folder: Path) -> list[str]:
    cache: dict[Path, Targets] = {}
    broken = []
    pages = [page for page in folder.rglob("*.html") if "_static" not in page.parts]
    for page in sorted(pages):  # _static holds the theme's templates
        for reference in sorted(read(page, cache).references):
            parts = urlsplit(reference)
            if parts.scheme or parts.netloc:
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            exists = target.is_file()
            if exists and parts.fragment and target.suffix == ".html":
                exists = unquote(parts.fragment) in read(target, cache).anchors
            if not exists:
                broken.append(f"{page.relative_to(folder)}: {reference}")
    return broken


def test_no_link_is_broken(html: Path) -> None:
    assert broken_links(html) == []


def test_a_broken_link_is_seen(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<a href="b.html#there">x</a><a href="b.html#gone">x</a>'
        '<img src="no.png"><a href="#me" id="me">'
    )
    (tmp_path / "b.html").write_text('<p id="there">')
    assert broken_links(tmp_path) == ["a.html: b.html#gone", "a.html: no.png"]


def test_every_page_of_results_names_its_runs_or_says_that_there_are_none(html: Path) -> None:
    for name in ("05_halfcheetah", "06_affine_or_mlp"):
        text = (html / "notebooks" / f"{name}.html").read_text()
        assert "silem run" in text or "no run" in text
