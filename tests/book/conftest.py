"""The built book and a browser to read it with."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, sync_playwright

from silem.report import build, pdf, web
from silem.util import files
from silem.util.errors import SilemError
from silem.util.paths import REPO


@pytest.fixture(scope="session")
def html(testrun_uid: str) -> Path:
    """The pages of the book, built once for all workers: those that share what another one builds.

    Here the notebooks run with their own defaults, if they or what they read have changed.
    """
    root = REPO / "_build" / "tests"
    root.mkdir(parents=True, exist_ok=True)
    chosen = root / "pages.json"
    with files.lock(root / "tests.lock", wait_s=float("inf")):
        known = files.read_json(chosen) if chosen.exists() else {}
        if known.get("run") == testrun_uid:
            return Path(known["pages"])
        try:
            pages = build.build(n_workers=2, root=root, parameters={})
        except SilemError as error:
            pytest.fail(f"the book cannot be built: {error}", pytrace=False)
        files.write_json(chosen, {"run": testrun_uid, "pages": str(pages)})
        return pages


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
