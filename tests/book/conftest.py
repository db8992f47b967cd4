"""The built book and a browser to read it with."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import filelock
import pytest
from playwright.sync_api import Browser, sync_playwright

from silem.errors import SilemError
from silem.report import bookbuild

CHROMIUM_NAMES = ("chromium", "chromium-browser", "google-chrome")
QUIET = ["--disable-background-networking", "--disable-component-update", "--disable-quic"]


@pytest.fixture(scope="session")
def html() -> Path:
    """The book's folder; built here, once for all workers, unless it is up to date."""
    bookbuild.BUILD.mkdir(exist_ok=True)
    with filelock.FileLock(bookbuild.BUILD / "tests.lock"):
        if not bookbuild.is_current():
            try:
                bookbuild.build(n_workers=2)
            except SilemError as error:
                pytest.fail(f"the book cannot be built: {error}", pytrace=False)
    return bookbuild.HTML


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """A headless Chromium from the system's packages."""
    found = [path for name in CHROMIUM_NAMES if (path := shutil.which(name))]
    if not found:
        pytest.fail(
            "no Chromium found; on Debian: apt-get install --no-install-recommends chromium",
            pytrace=False,
        )
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found[0], args=QUIET)
        yield browser
        browser.close()
