"""The whole book as one PDF: Chromium prints the single page that Sphinx makes of it.

Debian's packages ``chromium`` and ``fonts-liberation`` are all that it needs beside the book's own
environment.
"""

import shutil
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

from silem.util import files
from silem.util.errors import SilemError

CHROMIUM_NAMES = ("chromium", "chromium-browser", "google-chrome")
QUIET = ["--disable-background-networking", "--disable-component-update", "--disable-quic"]
_WAIT = """async () => {
  await window.MathJax?.startup?.promise;
  for (const image of document.images) image.loading = "eager";
  await Promise.all([...document.images].map(image => image.decode().catch(() => 0)));
}"""
_FOOTER = (
    '<div style="font-size: 8px; width: 100%; text-align: center; color: #666">'
    '<span class="pageNumber"></span></div>'
)


def chromium() -> str:
    """Return the browser's program; raises SilemError where there is none."""
    found = [path for name in CHROMIUM_NAMES if (path := shutil.which(name))]
    if not found:
        raise SilemError(
            "no Chromium found; on Debian: apt-get install --no-install-recommends chromium"
        )
    return found[0]


def print_page(browser: Browser, page: Path, target: Path) -> None:
    """Print a page from the disk to a PDF of A4 sheets, with an outline."""
    opened = browser.new_context(offline=True, color_scheme="light").new_page()
    opened.add_init_script("localStorage.setItem('mode', 'light')")
    opened.goto(page.as_uri(), wait_until="load", timeout=120_000)
    opened.evaluate(_WAIT)
    data = opened.pdf(
        format="A4", print_background=True, outline=True, tagged=True,
        display_header_footer=True, header_template="<span></span>", footer_template=_FOOTER,
        margin={"top": "16mm", "bottom": "18mm", "left": "16mm", "right": "16mm"},
    )  # fmt: skip
    opened.context.close()
    files.write_bytes(target, data)


def write(pages: Path, target: Path) -> None:
    """Print the book's single page, as Sphinx built it into a folder, to a file."""
    page = pages / "book.html"
    # Sphinx links from the root, wherever the first page lies
    made = (pages / "book" / "intro.html").read_text()
    files.write_text(page, made.replace('"../_static/', '"_static/'))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium(), args=QUIET)
        print_page(browser, page, target)
        browser.close()
