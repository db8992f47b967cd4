"""Every page of the built book, opened from the disk in headless Chromium."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import yaml
from playwright.sync_api import Browser, Page

from silem.report.film import why_no_pictures
from silem.util.paths import REPO

# One worker reads the book: it is built once and opened by one browser.
pytestmark = [pytest.mark.built, pytest.mark.xdist_group("book")]

LOCAL = ("file:", "data:", "blob:", "about:")

BROKEN_IMAGES = """() => [...document.images]
    .filter(image => !image.complete || image.naturalWidth === 0).map(image => image.src)"""
UNSET_MATHEMATICS = """() => [...document.querySelectorAll('.math')]
    .filter(node => !node.querySelector('mjx-container svg') || node.querySelector('mjx-merror'))
    .map(node => node.textContent)"""
CLIPPED_CODE = """() => [...document.querySelectorAll('div.highlight pre')]
    .filter(pre => pre.offsetParent && pre.scrollWidth > pre.clientWidth + 1)
    .map(pre => pre.textContent.split('\\n').sort((a, b) => b.length - a.length)[0])"""
OVERFLOW_PX = "() => document.scrollingElement.scrollWidth - window.innerWidth"
# what sticks out of the window and cannot be scrolled to
CUT_OFF = """() => [...document.querySelectorAll('article :is(table, pre, img, video, svg)')]
    .filter(one => one.getBoundingClientRect().right > innerWidth + 1)
    .filter(one => {
        while ((one = one.parentElement) && !/auto|scroll/.test(getComputedStyle(one).overflowX));
        return !one;
    }).map(one => one.outerHTML.slice(0, 200))"""
# A file's name says nothing, so words have spaces.
WITHOUT_WORDS = """() => [...document.querySelectorAll('img, video')]
    .filter(one => !(one.alt ?? one.ariaLabel ?? '').includes(' ')).map(one => one.src)"""
WITHOUT_CONTROLS = """() => [...document.querySelectorAll('video')]
    .filter(video => !video.controls || !video.poster).map(video => video.ariaLabel)"""
PLAY = """async video => {
    video.muted = true; video.loop = true;
    await video.play();
    const start = video.currentTime;
    for (let i = 0; i < 100 && video.currentTime === start; i++)
        await new Promise(done => setTimeout(done, 50));
    return video.currentTime !== start && video.videoWidth > 0;
}"""


def table_of_contents() -> list[str]:
    toc = yaml.safe_load((REPO / "_toc.yml").read_text())
    chapters = [chapter["file"] for part in toc["parts"] for chapter in part["chapters"]]
    return [toc["root"], *chapters]


@dataclass
class Opened:
    """A page, and what happened while it was opened."""

    page: Page
    requests: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)


def open_page(browser: Browser, path: Path, width: int = 1300) -> Opened:
    opened = Opened(browser.new_page(viewport={"width": width, "height": 900}))
    page = opened.page
    page.on("request", lambda request: opened.requests.append(request.url))
    page.on("pageerror", lambda error: opened.errors.append(str(error)))
    page.on(
        "console",
        lambda message: opened.errors.append(message.text) if message.type == "error" else None,
    )
    page.goto(path.as_uri(), wait_until="load")
    page.evaluate("() => window.MathJax ? MathJax.startup.promise : null")
    return opened


@pytest.fixture(scope="module", params=table_of_contents())
def opened(request: pytest.FixtureRequest, html: Path, browser: Browser) -> Iterator[Opened]:
    opened = open_page(browser, html / f"{request.param}.html")
    yield opened
    opened.page.close()


def test_page_is_complete_without_a_network(opened: Opened) -> None:
    page = opened.page
    assert page.locator("article h1").count() == 1
    assert page.locator(".output.stderr").all_inner_texts() == []  # a warning is not prose
    assert page.evaluate(BROKEN_IMAGES) == []
    assert page.evaluate(UNSET_MATHEMATICS) == []
    assert page.evaluate(WITHOUT_WORDS) == page.evaluate(WITHOUT_CONTROLS) == []
    for video in page.locator("video").all():
        assert video.evaluate(PLAY), "the video does not play"
    assert [url for url in opened.requests if not url.startswith(LOCAL)] == []
    assert opened.errors == []


def test_page_fits_its_width(opened: Opened) -> None:
    assert opened.page.evaluate(CLIPPED_CODE) == []
    for width in (1440, 390):
        opened.page.set_viewport_size({"width": width, "height": 900})
        assert opened.page.evaluate(OVERFLOW_PX) <= 0
        assert opened.page.evaluate(CUT_OFF) == []


def test_mathematics_is_there_to_be_set(html: Path, browser: Browser) -> None:
    opened = open_page(browser, html / "book/method.html")
    assert opened.page.locator("div.math mjx-container").count() >= 8
    opened.page.close()


@pytest.mark.skipif(bool(why_no_pictures("Humanoid")), reason="nothing can be drawn offscreen here")
def test_pages_have_their_films_and_pictures(html: Path) -> None:
    for name, n_films in (("01_bodies", 1), ("09_demonstration", 1), ("10_humanoids", 2)):
        page = (html / "notebooks" / f"{name}.html").read_text()
        assert page.count("<video") == n_films
        assert "Clip(" not in page  # which is what a clip would print
    svg = re.search(r'src="\.\./(_images/[^"]+\.svg)"', page)
    assert svg is not None and (html / svg[1]).read_text().count("<image ") == 3  # Figure 3a


def test_search_finds_a_word(html: Path, browser: Browser) -> None:
    opened = open_page(browser, html / "search.html")
    opened.page.goto((html / "search.html").as_uri() + "?q=embodiment")
    opened.page.locator("#search-results li a").first.wait_for(timeout=10_000)
    assert [url for url in opened.requests if not url.startswith(LOCAL)] == []
    opened.page.close()


def test_checks_see_what_is_wrong(tmp_path: Path, browser: Browser) -> None:
    """Negative control: a page with one fault of each kind."""
    path = tmp_path / "bad.html"
    path.write_text(
        "<body style='width:5000px'><img src='missing.png'><span class='math'>x</span>"
        "<div class='highlight'>"
        "<pre style='width:50px;overflow:auto'>a long line of code</pre></div>"
        "<article><table width=3000><tr><td>1</table><video src=x.mp4></video></article>"
        "<script src='http://localhost:9/x.js'></script><script>nonsense(</script>"
    )
    opened = open_page(browser, path)
    assert opened.page.evaluate(BROKEN_IMAGES) == [(tmp_path / "missing.png").as_uri()]
    assert opened.page.evaluate(UNSET_MATHEMATICS) == ["x"]
    assert opened.page.evaluate(CLIPPED_CODE) == ["a long line of code"]
    assert opened.page.evaluate(OVERFLOW_PX) > 0
    assert "<table" in opened.page.evaluate(CUT_OFF)[0]
    assert opened.page.evaluate(WITHOUT_CONTROLS) == [None]
    assert len(opened.page.evaluate(WITHOUT_WORDS)) == 2
    assert "http://localhost:9/x.js" in opened.requests
    assert any("SyntaxError" in error or "Unexpected" in error for error in opened.errors)
    opened.page.close()
