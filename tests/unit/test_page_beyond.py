"""What the page beyond the paper computes and draws, on made-up records."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import synthetic_records as synthetic

from silem import bodies
from silem.report import claims, results, tables
from silem.report.pages import beyond as page
from silem.report.transforms import feature_names
from silem.study.studies import SLOPES_DEG, TORSOS, study_configs
from silem.util import files

LENGTHS = {body: bodies.get(body).length[1] for body in ("HC0", *TORSOS)}
FALLS = {"silem": 0.0, "silem-minus": 0.4, "tpil": 0.8}  # of the level, by metre


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    return tmp_path


def table(spread: float = 0.0) -> pd.DataFrame:
    """Two trials of each method, whose mean falls with the torso as `FALLS` says."""
    rows = [
        {"body": body, "method": method,
         "return_mean": 1000 * (1 - fall * (length - 1)) + spread * sign,
         "speed_m_s": 2 * (1 - fall * (length - 1)) + 1e-3 * spread * sign}
        for body, length in LENGTHS.items()
        for method, fall in {**FALLS, page.OWN: 0.0}.items()
        for sign in (-1, 1)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_half_is_lost_where_the_line_falls_through_it() -> None:
    found = page.half_points(table(), LENGTHS)
    for what in ("return", "speed"):
        lost = found[what, "half lost at"]
        # 1 - 0.4 (l - 1) is one half at 2.25 m, 1 - 0.8 (l - 1) at 1.625 m, between two torsos
        assert list(lost[["SILEM⁻", "TPIL"]]) == pytest.approx([2.25, 1.625])
        assert lost["SILEM"] == math.inf  # beyond the ladder
        assert list(found[what, "from"]) == pytest.approx(list(lost))  # equal trials: no width
    shuffled = page.half_points(
        table().sample(frac=1, random_state=0), dict(reversed(LENGTHS.items()))
    )
    pd.testing.assert_frame_equal(shuffled, found)


def test_a_halfs_interval_holds_it_and_grows_with_the_spread_of_trials() -> None:
    narrow, wide = (page.half_points(table(spread), LENGTHS)["return"] for spread in (20, 100))
    for found in (narrow, wide):
        row = found.loc["SILEM⁻"]
        assert row["from"] < row["half lost at"] < row["to"]
    widths = [found.loc["SILEM⁻", "to"] - found.loc["SILEM⁻", "from"] for found in (narrow, wide)]
    assert widths[1] > 2 * widths[0]


def test_without_a_bodys_runs_no_half_is_told() -> None:
    runs = table()
    gone = runs[~(runs["body"].eq("HC-2") & runs["method"].eq("tpil"))]
    found = page.half_points(gone, LENGTHS)["return"]
    assert found.loc["TPIL"].isna().all() and not found.loc["SILEM⁻"].isna().any()
    own = runs[~(runs["body"].eq("HC-2") & runs["method"].eq(page.OWN))]
    assert page.half_points(own, LENGTHS).isna().all(axis=None)


def test_half_is_lost_at_the_first_body_that_begins_below_it() -> None:
    runs = table()
    runs.loc[runs["method"].eq("tpil"), ["return_mean", "speed_m_s"]] = -5.0
    assert page.half_points(runs, LENGTHS).loc["TPIL", ("return", "half lost at")] == 1.0


def test_a_ladder_reads_what_it_shares_with_the_papers_study(data: Path) -> None:
    synthetic.write_study("book")
    shared = page.runs("ladder", {"halfcheetah": ["HC0"]}, page.LADDER, "book")
    assert set(shared["body"]) == {"HC0"} and len(shared) == 3 * 5  # TPIL is the ladder's
    assert len(shared.attrs["missing"]) == len(study_configs("ladder", "book"))
    assert page.half_points(shared, LENGTHS).isna().all(axis=None)


def test_ensembles_are_told_apart_by_their_maps(data: Path) -> None:
    synthetic.write_study("book", n_trials=1)
    for config in study_configs("ensembles", "book", 2):
        if config.body == "HC0":
            synthetic.write_record(config, 100.0 * config.hyper.transform_components)
    one = {"halfcheetah": ["HC0", "HC2"], "ant": ["Ant6"]}
    found = tables.ensembles(page.runs("ensembles", one, ("silem", "silem-mlp"), "book")).data
    trials = found.set_index(["body", "f"])["trials"]
    assert trials["HC0", "affine, K = 1"] == trials["HC0", "MLP"] == "1"
    assert trials["HC0", "affine, K = 4"] == "2" and trials["Ant6", "affine, K = 4"] == "0"
    apart = found.set_index(["body", "f"])["maps apart (%)"]
    assert apart["HC0", "affine, K = 1"] == "–" and apart["HC0", "affine, K = 4"].isdigit()
    means = found.set_index(["body", "f"])["return"].str.partition("<")[0]
    for count in (2, 4, 8):
        assert float(means["HC0", f"affine, K = {count}"]) == pytest.approx(100 * count, abs=10)


@pytest.mark.parametrize(("share", "verdict"), [(1.0, claims.HOLDS), (0.1, claims.FAILS)])
def test_an_offset_of_pitch_has_to_be_the_angle(data: Path, share: float, verdict: str) -> None:
    column = feature_names("HC0-slope-10").index("pitch")
    for config in study_configs("slope", "book", body=["HC0-slope-10"]):
        record = synthetic.write_record(config, 1000.0 if config.method == "silem" else 500.0)
        if config.method == "silem":
            arrays = {"A": np.ones(26), "b": np.zeros(26)}
            arrays["b"][column] = share * math.radians(10.0) + 1e-3 * config.seed
            files.write_npz(record.folder / "transform.npz", arrays)
            sha = files.sha256(record.folder / "transform.npz")
            record.files["transform.npz"] = sha
            record.save(record.folder)
    found = claims.evaluate(results.load_records("slope")).set_index("text")["verdict"]
    judged = {claim.body for claim in claims.of("slope")}
    assert judged == {f"{b}-slope-{deg:g}" for b in ("HC0", "Ant0") for deg in SLOPES_DEG}
    told = found[found.index.str.endswith("HC0-slope-10")]
    assert list(told) == [claims.HOLDS, verdict]  # the returns' and the offset's
    assert (found.drop(told.index) == claims.UNDECIDED).all()
