"""Tables of synthetic studies, each made once for the tests of a module."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pytest


@pytest.fixture(scope="module")
def studies(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, tuple[pd.DataFrame, Path]]:
    """Every case of the module's `CASES`, as its `make` makes it in a folder of its own."""
    module = request.module
    folders = {case: tmp_path_factory.mktemp("study") for case in module.CASES}
    return {case: (module.make(case, folder), folder) for case, folder in folders.items()}


@pytest.fixture
def frame(
    request: pytest.FixtureRequest,
    studies: dict[str, tuple[pd.DataFrame, Path]],
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[pd.DataFrame]:
    """The study named by the test's parameter, or the whole one."""
    table, folder = studies[getattr(request, "param", "whole")]
    monkeypatch.setenv("SILEM_DATA_DIR", str(folder))
    yield table
