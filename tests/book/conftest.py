"""The built book and a browser to read it with."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, sync_playwright

from silem.report import build
from silem.util import files
from silem.util.errors import SilemError
from silem.util.paths import REPO

CHROMIUM_NAMES = ("chromium", "chromium-browser", "google-chrome")
QUIET = ["--disable-background-networking", "--disable-component-update", "--disable-quic"]


@pytest.fixture(scope="session")
def html() -> Path:
    """The pages of the book: those of `make book` if they are up to date, else built here.

    Here the notebooks run with their own defaults, once for all workers.
    """
    if pages := build.current():
        return pages
    root = REPO / "_build" / "tests"
    root.mkdir(parents=True, exist_ok=True)
    with files.lock(root / "tests.lock", wait_s=float("inf")):
        try:
            return build.current(root) or build.build(n_workers=2, root=root, parameters={})
        except SilemError as error:
            pytest.fail(f"the book cannot be built: {error}", pytrace=False)


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
