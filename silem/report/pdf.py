"""The whole book as one PDF: what `make pdf` calls, after `make book`.

The staged sources are built as a single page, which Chromium prints; Debian's package ``chromium``
and ``fonts-liberation`` are all that it needs beside the book's own environment.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

from silem.report import build
from silem.util import files
from silem.util.errors import SilemError
from silem.util.paths import REPO

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


def single_page(source: Path, output: Path) -> Path:
    """Build staged sources as one page; return it.

    Raises:
        SilemError: If jupyter-book reports an error.
    """
    program = Path(sys.executable).with_name("jupyter-book")
    command = [str(program), "build", str(source), "--path-output", str(output)]
    done = subprocess.run([*command, "--builder", "singlehtml", "-q"], check=False)
    folder = output / "_build" / "singlehtml"
    made = folder / "book" / "intro.html"
    if done.returncode or not made.exists():
        raise SilemError("the single page did not build; its errors are listed above")
    # Sphinx links from the root, wherever the first page lies
    files.write_text(folder / "book.html", made.read_text().replace('"../_static/', '"_static/'))
    return folder / "book.html"


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


def main() -> None:
    """Write ``_build/silem.pdf`` from the sources that the book was built from."""
    started, target = time.perf_counter(), REPO / "_build" / "silem.pdf"
    try:
        if build.current() is None:
            build.build()
        page = single_page(REPO / "_build" / "source", REPO / "_build" / "pdf")
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=chromium(), args=QUIET)
            print_page(browser, page, target)
            browser.close()
    except SilemError as error:
        sys.exit(f"error: {error}")
    print(f"{target}: {target.stat().st_size / 1e6:.1f} MB, {time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
