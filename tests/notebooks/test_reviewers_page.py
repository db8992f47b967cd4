"""The pages of what the book cost and for reviewers, on a made-up study."""

from __future__ import annotations

import re

from conftest import Execute, glue_roles, output, said, words

FIGURES = [f"{kind}-{name}" for kind in ("improvement", "profiles")
           for name in ("halfcheetah", "ant", "humanoids")]  # fmt: skip


def test_cost(execute: Execute) -> None:
    page = execute("18_cost")
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    assert int(spoken["runs"].replace(",", "")) > 50
    (all_runs,) = re.findall(r"\ball (\d+) (\d+) ", words(output(page, "by-study")))
    assert all_runs == (spoken["runs"], spoken["missing"])


def test_reviewers(execute: Execute) -> None:
    page = execute("19_reviewers")
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    verdicts = [int(spoken[name]) for name in ("hold", "fail", "undecided")]
    assert sum(verdicts) == int(spoken["claims"]) and min(verdicts[:2]) > 0
    assert "95 %" not in words(output(page, "cards")) and "HC0.npz" in output(page, "cards")
    for name in FIGURES:
        assert "<svg" in output(page, name)
        assert "budget book" in words(output(page, f"{name}-trace"))
