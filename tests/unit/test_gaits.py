"""The gaits of a body's experts: tables, strides, films, and what decided about their imitators."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import synthetic_records as synthetic
from drawn import assert_readable, lines_at, texts
from scipy import stats

from silem import bodies
from silem.motion import demonstrations as demos
from silem.motion.demonstrations import Demonstrations
from silem.report import results, style
from silem.report.pages import gaits
from silem.report.transforms import feature_names
from silem.study import evaluate as recording
from silem.study import runs
from silem.study.config import RunConfig
from silem.study.evaluate import demonstrate, describe
from silem.study.studies import experts, study_configs

PITCHES = {"HC0_s0": 0.4, "HC0_s1": 0.0, "HC0_s2": 0.3, "HC0_s3": 0.2, "HC0_s4": 0.1}


def galloping(pitch: float, n_states: int = 300) -> np.ndarray:
    """Features of HC0 that pitches around a mean, twenty states to a stride."""
    names = feature_names("HC0")
    features = np.zeros((n_states, len(names)), np.float32)
    features[:, names.index("pitch")] = pitch + 0.1 * np.cos(2 * np.pi * np.arange(n_states) / 20)
    features[:, names.index("forward velocity")] = 0.6
    return features


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data folder with HC0's five experts, each with published demonstrations."""
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    for config, (name, pitch) in zip(experts("HC0", "book"), PITCHES.items(), strict=True):
        record = synthetic.with_policy(
            synthetic.write_record(config, 2000 + 100 * (config.seed == 3))
        )
        states = galloping(pitch)
        demos.publish(name, Demonstrations((states,), (2000.0,), "HC0", record.run_id))
    return tmp_path


def imitators(score: dict[str, dict[str, float]], learners: tuple[str, ...] = ("HC1",)) -> None:
    """Write the study's runs: score of a method by the trial of the demonstrator."""
    for body in learners:
        synthetic.write_record(RunConfig.create(body, "ppo", budget="book"), 1000.0)
    for config in study_configs("demonstrators", "book"):
        value = score.get(config.method, {}).get(config.demonstrations)
        if value is not None and config.body in learners:
            synthetic.write_record(config, 1000 * value)


def test_every_trial_is_there_even_without_a_run(data: Path) -> None:
    (gone,) = [c for c in experts("HC0", "book") if c.seed == 2]
    record = runs.find(gone.run_id)
    assert record is not None
    (record.folder / "record.json").unlink()
    shown = gaits.load("HC0", "book", 1)
    assert list(shown) == list(PITCHES)
    assert shown["HC0_s2"] is None
    name, why = gaits.chosen("HC0", "book")
    assert name == ""
    assert gone.command in why
    table = gaits.table(shown, name).data
    assert list(table["return"])[2] == "no run"
    figure = gaits.draw_strides(shown, name)
    assert "no run" in texts(figure)
    assert_readable(figure)


def test_the_demonstrator_is_the_best_of_all_and_marked(data: Path) -> None:
    shown = gaits.load("HC0", "book", 1)
    name, why = gaits.chosen("HC0", "book")
    assert name == "HC0_s3"
    assert "trial 3: of the 5 experts it has the highest evaluation return" in why
    table = gaits.table(shown, name).data
    assert list(table["trial"]) == ["0", "1", "2", "3 (chosen)", "4"]
    assert list(table["pitch (rad)"])[:2] == ["0.40 ± 0.07", "0.00 ± 0.07"]
    assert set(table["speed (m/s)"]) == {
        f"{synthetic_speed(2000):.2f}",
        f"{synthetic_speed(2100):.2f}",
    }
    assert set(table["failed"]) == {"0 of 100"}
    assert set(table["failed, recorded"]) == {"0 of 1"}
    assert_readable(gaits.draw_strides(shown, name))


def synthetic_speed(value: float) -> float:
    return 2.4 * (value + 200) / 2600


def test_published_episodes_of_another_run_are_not_taken_for_this_ones(data: Path) -> None:
    strange = Demonstrations((galloping(0.9),), (2000.0,), "HC0", "another run")
    demos.publish("HC0_s1", strange)
    found = gaits.load("HC0", "book", 1)["HC0_s1"]
    assert found is not None
    assert found.demonstrations.expert_run_id == found.record.run_id
    assert len(found.demonstrations.features[0]) == 1001  # recorded here


def test_recording_writes_the_gait_into_the_manifest(data: Path) -> None:
    record = runs.find(experts("HC0", "book")[0].run_id)
    assert record is not None
    demonstrate(record, 1, name="HC0_s0", force=True)
    measured = recording.gait(Demonstrations.load("HC0_s0"))
    entry = demos.entry("HC0_s0")
    assert {key: entry[key] for key in measured._fields} == measured._asdict()
    said = describe("HC0_s0")
    assert f"1 trajectories of {record.run_id}, return {measured.return_worst:.0f} ± 0" in said
    assert f"pitch {measured.pitch_rad:.2f} ±" in said


def test_strides_are_cut_at_the_peaks_and_resampled() -> None:
    cut = gaits.strides(recording.pitch_rad(galloping(0.2)))
    assert len(cut) == 13  # 14 peaks inside 300 states, the first is at the edge
    expected = 0.2 + 0.1 * np.cos(2 * np.pi * np.linspace(0, 1, 50))
    assert np.abs(cut - expected).max() < 0.01
    assert len(gaits.strides(np.zeros(300))) == 0  # stands


def test_experts_are_filmed_side_by_side(data: Path) -> None:
    shown = gaits.load("HC0", "book", 1) | {"HC0_s4": None}
    clip = gaits.side_by_side(gaits.by_trial(shown), 0.1)
    assert clip is not None
    assert clip.frames.shape[1:3] == (2 * 240 + 8, 3 * 320 + 16)
    assert gaits.side_by_side(gaits.by_trial({"HC0_s0": None}), 0.1) is None


# ---------------------------------------------------------------- what decided


def test_effects_of_a_table_worked_out_by_hand() -> None:
    # rows differ by 4, columns by 2, with one entry off
    values = np.array([[0.0, 2.0], [4.0, 6.0], [8.0, 13.0]])
    rows, columns, rows_p, columns_p = gaits.effects(values)
    total = ((values - 5.5) ** 2).sum()
    assert rows == pytest.approx(2 * (4.5**2 + 0.5**2 + 5**2) / total)
    assert columns == pytest.approx(3 * 2 * 1.5**2 / total)
    error = (1 - rows - columns) * total / 2
    assert rows_p == pytest.approx(stats.f.sf(rows * total / 2 / error, 2, 2))
    assert columns_p == pytest.approx(stats.f.sf(columns * total / error, 1, 2))
    assert gaits.effects(np.ones((3, 2))) == (0, 0, 1, 1)


def test_chance_is_not_called_a_cause() -> None:
    rng = np.random.default_rng(0)
    wrong = np.array([gaits.effects(rng.normal(size=(5, 2))) for _ in range(400)])
    for shares in (wrong[:, 2:] < 0.05).mean(axis=0):
        assert 0.02 < shares < 0.09


@pytest.mark.parametrize(
    ("teacher", "transform", "words"),
    [
        (1.0, 0.0, "teacher"),
        (0.0, 0.5, "transform"),
        (1.0, 0.5, "teacher and transform"),
        (0.0, 0.0, "chance, as far as these runs tell"),
    ],
)
def test_what_decided_is_told_from_the_records(
    data: Path, teacher: float, transform: float, words: str
) -> None:
    chance = dict(zip(PITCHES, (0.02, -0.03, 0.03, -0.02, 0.01), strict=True))
    plain = {name: 0.2 + teacher * pitch + chance[name] for name, pitch in PITCHES.items()}
    helped = {
        name: 0.2 + teacher * pitch + transform - chance[name] for name, pitch in PITCHES.items()
    }
    imitators({"silem": helped, "silem-minus": plain})
    records, shown = results.load_records("demonstrators", "book"), gaits.load("HC0", "book", 1)
    one, two = gaits.decided(records, shown).data.to_dict("records")
    assert (one["body"], one["both scores"], one["decided by"]) == (
        "HC1", "5 of 5 demonstrators", words,
    )  # fmt: skip
    assert (two["both scores"], two["decided by"]) == ("0 of 5 demonstrators", "not to be told yet")


def test_a_part_of_the_runs_is_shown_as_a_part(data: Path) -> None:
    imitators({"silem": {"HC0_s1": 0.9}, "silem-minus": {"HC0_s0": 0.1, "HC0_s1": 0.8}})
    records, shown = results.load_records("demonstrators", "book"), gaits.load("HC0", "book", 1)
    told = gaits.decided(records, shown).data
    assert (
        told["both scores"][0].startswith("1 of 5")
        and told["decided by"].eq("not to be told yet").all()
    )
    figure = gaits.imitated(records, shown)
    assert texts(figure).count("no run") == 3 + 5
    labels = [label.get_text() for label in figure.axes[2].get_xticklabels()]
    assert [label.splitlines()[0] for label in labels] == [
        "trial 1", "trial 4", "trial 3", "trial 2", "trial 0",
    ]  # fmt: skip
    score = figure.axes[0]
    marks = {line.get_marker(): line.get_xydata() for line in score.lines if len(line.get_xdata())}
    assert marks["o"][0] == pytest.approx([-0.14, records.iloc[0]["normalised"]])
    assert_readable(figure)


def test_a_line_stands_where_the_nose_touches_the_floor(data: Path) -> None:
    records, shown = results.load_records("demonstrators", "book"), gaits.load("HC0", "book", 1)
    pitches = sorted(PITCHES.values())
    for axes, body in zip(gaits.imitated(records, shown).axes[:2], ("HC1", "HC2"), strict=True):
        (line,) = lines_at(axes, style.WARNING)
        pitch, stretched = gaits.nose_touch_pitch_rad(bodies.get(body))
        # HC0_s0 to HC0_s4 pitch by 0.0 to 0.4, a tenth from slot to slot
        assert line.get_xdata()[0] == pytest.approx(np.interp(pitch, pitches, range(5)))
        assert line.get_xdata()[0] == pytest.approx(10 * pitch, abs=0.01)
        assert f"{pitch:.2f} rad" in axes.get_title(loc="left")
        assert pitch < stretched


def test_the_pitch_of_a_nose_on_the_floor_follows_from_the_geometry() -> None:
    at_rest, stretched = (
        [gaits.nose_touch_pitch_rad(bodies.get(name))[index] for name in ("HC0", "HC1", "HC2")]
        for index in (0, 1)
    )
    # A leg of 0.62 m that hangs on the end of 2 m and 3 m of torso: 0.28 and 0.18 rad, about.
    np.testing.assert_allclose(at_rest[1:], [0.28, 0.18], atol=0.02)
    assert at_rest == sorted(at_rest, reverse=True) and stretched == sorted(stretched, reverse=True)
    # No pose that has the foot down pitches further: posed so, the nose is at the foot's height.
    assert 0.79 / 2.0 == pytest.approx(np.sin(stretched[1]), abs=0.04)


def test_without_any_run_the_page_says_so(data: Path) -> None:
    records, shown = results.load_records("demonstrators", "book"), gaits.load("HC0", "book", 1)
    assert gaits.decided(records, shown).data["decided by"].eq("not to be told yet").all()
    assert_readable(gaits.imitated(records, dict.fromkeys(shown)))
    assert gaits.side_by_side(gaits.extremes(records), 0.1) is None


def test_best_and_worst_are_filmed_side_by_side(data: Path) -> None:
    imitators({"silem": {"HC0_s0": 0.1, "HC0_s1": 0.9}, "silem-minus": {"HC0_s4": 0.5}})
    records = results.load_records("demonstrators", "book")
    for row in records.itertuples():
        synthetic.with_policy(results.find(row.run_id))
    best, worst = gaits.extremes(records).items()
    assert best[0] == "best: HC1, SILEM, trial 1"
    assert worst[0] == "worst: HC1, SILEM, trial 0"
    assert best[1].config["demonstrations"] == "HC0_s1"
    clip = gaits.side_by_side(gaits.extremes(records), 0.1)
    assert clip is not None
    assert clip.frames.shape[2] == 2 * 320 + 8
    assert list(gaits.extremes(records[:1])) == ["best: HC1, SILEM, trial 0"]
