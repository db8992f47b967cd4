"""The built book and a browser to read it with."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, sync_playwright

from silem.report import build, pdf, web
from silem.util.errors import SilemError
from silem.util.paths import REPO


@pytest.fixture(scope="session")
def html() -> Path:
    """The pages as ``make book`` leaves them: what has not changed is not built again."""
    try:
        return build.build()
    except SilemError as error:
        pytest.fail(f"the book cannot be built: {error}", pytrace=False)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """A headless Chromium from the system's packages."""
    try:
        program = pdf.chromium()
    except SilemError as error:
        pytest.fail(str(error), pytrace=False)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=pdf.QUIET)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the scripts and packs of the pages, for pages that a test writes."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copytree(REPO / "book" / "_static", folder / "_static")
    web.write(folder / "_static" / "web")
    return folder
