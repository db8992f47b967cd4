"""What walks and what does not, in numbers, in words, in curves and on film, from made-up runs."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import synthetic_records as synthetic
from drawn import assert_readable, footer, texts

from silem.bodies import Body
from silem.motion.demonstrator import published_motion
from silem.report import film, results, style
from silem.report.claims import MARGIN
from silem.report.curves import compared_curves
from silem.report.pages import open_settings as search
from silem.report.pages import walking
from silem.study.config import RunConfig
from silem.study.evaluate import EVALUATION_SEED, Episode
from silem.study.runs import RunRecord
from silem.study.studies import cells


def planned(method: str, body: str, seed: int = 0) -> RunConfig:
    (cell,) = [c for c in cells("humanoids") if (c.method, c.body) == (method, body)]
    return cell.config("book", seed)


@pytest.fixture(scope="module")
def frame(tmp_path_factory: pytest.TempPathFactory) -> pd.DataFrame:
    """Two trials of SILEM on Humanoid that walk, one on Atlas that falls, PPO, random."""
    with pytest.MonkeyPatch.context() as patch:
        data = tmp_path_factory.mktemp("data")
        patch.setenv("SILEM_DATA_DIR", str(data))
        for seed, level in enumerate((840.0, 870.0)):
            synthetic.write_record(planned("silem", "Humanoid", seed), level)
        synthetic.write_record(planned("silem", "Atlas"), 60.0)
        synthetic.write_record(planned("ppo", "Humanoid"), 300.0)
        synthetic.write_record(planned("random", "Humanoid"), 4.0)
        loaded = results.load_records("humanoids", "book")
        # what reads the runs' files later still has to find them
        loaded.attrs["folder"] = str(data)
        return loaded


@pytest.fixture(autouse=True)
def data_dir(frame: pd.DataFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", frame.attrs["folder"])


@pytest.fixture
def empty() -> pd.DataFrame:
    return results.load_records("humanoids", "paper")


@pytest.mark.parametrize(
    ("survived", "speed_m_s", "expected"),
    [
        (1.0, 1.6, walking.WALKS),
        (1 - MARGIN, 1.6 * (1 - MARGIN) + 1e-9, walking.WALKS),
        (1.0, 1.0, walking.SLOWER),
        (1.0, 0.5, walking.CREEPS),
        (1.0, 0.1, walking.STANDS),
        (0.89, 1.6, walking.FALLS),  # however fast it was until then
        (0.05, 0.0, walking.FALLS),
    ],
)
def test_a_gait_is_survival_first_and_then_speed(
    survived: float, speed_m_s: float, expected: str
) -> None:
    assert walking.gait(survived, speed_m_s) == expected


def test_gaits_are_means_over_trials(frame: pd.DataFrame) -> None:
    found = walking.gaits(frame).set_index(["body", "method"])
    assert set(found.index) == {("Humanoid", "silem"), ("Humanoid", "ppo"), ("Atlas", "silem")}
    walker = found.loc["Humanoid", "silem"]
    trials = results.scores(frame, "silem", "Humanoid", "speed_m_s")
    assert len(walker["run_ids"]) == len(trials) == 2
    assert walker["speed_m_s"] == pytest.approx(trials.mean())
    assert walker["speed_share"] == pytest.approx(trials.mean() / 1.6)
    assert walker["gait"] == walking.WALKS
    assert walker["survived_s"] == pytest.approx(25 * walker["survived"])  # 1000 steps of 0.025 s
    assert found.loc["Atlas", "silem"]["gait"] == walking.FALLS


def test_the_table_has_the_man_first_and_means_over_a_cells_trials(frame: pd.DataFrame) -> None:
    cell = results.cell(frame, "silem", "Humanoid")
    measures = pd.DataFrame(np.nan, index=frame["run_id"], columns=list(walking.MEASURES))
    measures.loc[cell["run_id"], "step_hz"] = [1.0, 2.0]
    measures.loc[cell["run_id"], "stance"] = [0.5, 0.7]
    one = walking.gait_table({"": frame}, measures)
    two = walking.gait_table({"here": frame, "there": frame}, measures)
    assert "runs" not in one
    n = len(one) - 3
    assert list(two["runs"]) == [style.DASH] * 3 + ["here"] * n + ["there"] * n
    man = one.iloc[0]
    assert (man["body"], man["speed (m/s)"], man["from his movement"]) == (
        "the man",
        "1.60",
        "0.00",
    )
    statue = one.iloc[2]
    assert (statue["speed (m/s)"], statue["steps/s"]) == ("0.00", "0.00")
    assert float(statue["from his movement"]) > 0.5
    row = one[(one["body"] == "Humanoid") & (one["method"] == "SILEM")].iloc[0]
    assert (row["steps/s"], row["trials"]) == ("1.50", "2")
    assert row["stance"] == "0.60"


def test_measures_are_those_of_the_policys_episodes(
    frame: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who does as the man does is at no distance from him; who stands makes no steps."""
    man = published_motion(walking.MAN).features
    shown = {"silem": man, "ppo": np.repeat(man[:1], 80, axis=0)}
    met: list[tuple[str, int, int]] = []

    def episodes(policy: str, body: Body, n: int, seed: int, **task: float) -> list[Episode]:
        met.append((body.name, n, seed))
        return [Episode(shown[policy], 0.0, None, None)] * n

    monkeypatch.setattr(walking, "episodes", episodes)
    monkeypatch.setattr(walking, "load_policy", lambda run: run.config["method"])
    found = walking.measured(frame, 2)
    assert set(met) == {(b, 2, EVALUATION_SEED) for b in ("Humanoid", "Atlas")}
    assert len(found) == len(met) == 4  # the random policy is left out
    of = {name: found.loc[results.select(frame, [name])["run_id"]] for name in shown}
    assert (of["silem"]["features"] == 0).all() and (of["silem"]["step_hz"] > 1.8).all()
    assert (of["ppo"]["step_hz"] == 0).all() and of["ppo"]["symmetry"].isna().all()


def test_why_a_rival_falls_is_asked_only_where_it_falls(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    for body, level in (("Humanoid", 850.0), ("HumanoidR", 60.0), ("Atlas", 60.0)):
        synthetic.write_record(planned("tpil", body), level)
    for method, level in (("silem-minus", 60.0), ("peng20", 60.0)):
        synthetic.write_record(planned(method, "Atlas"), level)
    longer = {(c.method, c.body): c.config("book", 0) for c in cells("rivals-longer")}
    synthetic.write_record(longer["tpil", "HumanoidR"], 850.0)
    synthetic.write_record(longer["peng20", "Atlas"], 60.0)
    frame, of_longer = (results.load_records(s, "book") for s in ("humanoids", "rivals-longer"))
    chosen = results.load_records("humanoids", "book")  # as if the search had chosen what is in use
    for settings, peng in ((results.load_records("rivals-settings", "book"), "open: not run yet"),
                           (chosen, "the method, as far as tried")):  # fmt: skip
        table = walking.verdicts(frame, of_longer, settings).set_index(["body", "rival"])
        answers = table["why it falls"]
        assert answers["Humanoid", "TPIL"] == "does not fall"
        assert answers["HumanoidR", "TPIL"] == "budget"
        assert answers["Atlas", "SILEM⁻"] == "open: not run yet"
        assert answers["Atlas", "Peng20"] == peng
        assert answers["HumanoidR", "Peng20"] == "not run yet"


def test_every_rival_has_as_many_runs_of_a_search_as_silem_had() -> None:
    silem = search.load("humanoids", "silem")
    longest = max(curve["iteration"].max() for curve in silem["curve"])
    tried = Counter(cell.method for cell in cells("rivals-search"))
    assert set(tried) == set(walking.RIVALS) and set(tried.values()) == {len(silem)}
    assert {cell.n_iterations for cell in cells("rivals-search")} == {longest}
    table = walking.search_table(results.load_records("rivals-search", "book"))
    counts = [(table[name] == style.DASH).sum() for name in ("SILEM⁻", "TPIL", "Peng20")]
    assert counts == [len(silem)] * 3
    deeper = table.set_index("setting").loc["layers of the encoder 2"]
    assert deeper.to_dict() == {"Peng20": "not tried", "SILEM⁻": "not tried", "TPIL": style.DASH}


def test_the_toy_of_the_reversal_is_drawn_and_told() -> None:
    figure, told = walking.reversal_figure(), walking.reversal_sentences()
    assert_readable(figure)
    assert len(figure.axes) == 4 and {"SILEM", "SILEM⁻"} <= set(texts(figure))
    assert told["silem_ranking"] > told["minus_ranking"]
    assert all(0 <= told[name] <= 100 for name in told)


def test_sentences_count_gaits_and_name_the_longest(frame: pd.DataFrame) -> None:
    said = walking.sentences(frame)
    assert [said[f"n_{name}"] for name in ("cells", "walk", "fall")] == [3, 1, 2]
    assert said["longest"] == "SILEM on Humanoid"
    assert said["n_curves"] == 4  # every run but the random policy's
    atlas = walking.sentences(results.select(frame, ["silem"], ["Atlas"]))
    assert atlas["longest"] == "SILEM on Atlas"


def test_without_runs_everything_says_so(empty: pd.DataFrame) -> None:
    said = walking.sentences(empty)
    assert (said["n_cells"], said["longest"]) == (0, style.DASH)
    assert np.isnan(walking.cell_sentences(empty, "x", "silem", "Atlas")["x_steps"])
    table = walking.gait_table({"": empty}, walking.measured(empty, 1))
    assert list(table["body"]) == ["the man"] * 3 + ["no run"]
    assert walking.best_run(empty, "silem", "Humanoid") == ""
    assert list(walking.milestones(empty, "silem", "Humanoid")["iterations"]) == ["no run"]
    figure = compared_curves({"these": empty, "those": empty})
    assert "no run" in texts(figure)
    assert_readable(figure)


def test_milestones_follow_one_run_to_its_end(frame: pd.DataFrame) -> None:
    run_id = walking.best_run(frame, "silem", "Humanoid")
    runs = results.cell(frame, "silem", "Humanoid")
    assert run_id == runs.sort_values("return_mean")["run_id"].iloc[-1]
    table = walking.milestones(frame, "silem", "Humanoid")
    total = planned("silem", "Humanoid").budget.n_iterations
    assert table["iterations"].iloc[-1] == style.number(total)
    lengths = table["steps before a fall"].str.replace(",", "").astype(int)
    assert lengths.is_monotonic_increasing  # as the made-up curves are
    last = results.load_curve(run_id).iloc[-4:]
    ratio = (last["disc_reward"].mean()) / last["episode_length"].mean()
    assert float(table["reward of D per step"].iloc[-1]) == pytest.approx(ratio, abs=0.02)


def test_compared_curves_have_a_line_per_run(frame: pd.DataFrame) -> None:
    groups = {
        "silem": results.select(frame, ["silem"], ["Humanoid"]),
        "ppo": results.select(frame, ["ppo"], ["Humanoid"]),
    }
    figure = compared_curves(groups)
    assert [len(axes.lines) for axes in figure.axes[:3]] == [3, 3, 2]  # PPO has no discriminator
    dashes = {line.get_linestyle() for line in figure.axes[0].lines}
    assert len(dashes) == 2
    assert "silem: 2 trials" in texts(figure)
    assert "budget book" in footer(figure)
    assert_readable(figure)


def test_the_man_ppo_and_twelve_cells_are_filmed_on_one_clock(
    frame: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    filmed: dict[str, RunRecord] = {}

    def of_runs(runs: dict[str, RunRecord | None], duration_s: float, size: film.Size) -> dict:
        filmed.update({label: run for label, run in runs.items() if run})
        clip = film.Clip(np.zeros((2, *size[::-1], 3), np.uint8), 20.0)
        return {label if run else f"{label}: no run yet": clip for label, run in runs.items()}

    shown: dict[str, film.Clip] = {}
    monkeypatch.setattr(film, "of_runs", of_runs)
    poses = lambda *_, size: film.Clip(np.zeros((3, *size[::-1], 3), np.uint8), 20.0)  # noqa: E731
    monkeypatch.setattr(film, "motion", poses)
    grid = film.grid
    monkeypatch.setattr(
        film, "grid", lambda clips, **look: shown.update(clips) or grid(clips, **look)
    )
    clip = walking.all_cells(frame, 0.5)
    assert clip.duration_s == 0.5 and len(shown) == 16  # the man begins again
    labels = [label.replace("\n", " ") for label in shown]
    assert labels[0].startswith("the man")
    assert labels[1] == "PPO Humanoid"
    assert labels[4:8] == ["SILEM Humanoid", *(f"{m} Humanoid: no run yet" for m in
                           ("SILEM⁻", "TPIL", "Peng20"))]  # fmt: skip
    assert labels[12] == "SILEM Atlas"
    best = results.cell(frame, "silem", "Humanoid").nlargest(1, "return_mean")
    assert filmed["SILEM\nHumanoid"].run_id == best["run_id"].item()
