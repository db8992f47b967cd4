"""The notebooks with parameters, on a made-up study: what the pages show.

nbmake runs them with their defaults on the repository's own records; here the
parameters differ, the data folder is another one, and the outputs are looked at.
"""

from __future__ import annotations

import base64
import hashlib
import io
import re
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pandas as pd
import pytest
import synthetic_records as synthetic
from conftest import MISSING, Execute, glue_roles, output, said, words
from PIL import Image

from silem import bodies, paper
from silem.bodies import describe
from silem.report import claims, results, style
from silem.report.transforms import feature_names
from silem.study import runs
from silem.study.config import RunConfig

PAGES = ("05_halfcheetah", "06_affine_or_mlp", "07_scorecard")


@pytest.fixture(autouse=True)
def data_folder(data_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the tests' own look-ups read the folder that the notebooks read."""
    monkeypatch.setenv("SILEM_DATA_DIR", str(data_dir))


def hashes(folder: Path) -> dict[str, str]:
    """The content of everything that is committed as evidence, to see whether it changes."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for name in ("results", "demonstrations")
        for path in sorted((folder / name).rglob("*"))
        if path.is_file()
    }


def video(html: str, folder: Path) -> tuple[dict, int]:
    """The one video that a cell embeds: its properties and how many frames it has."""
    assert "http" not in html  # nothing is fetched from anywhere
    (data,) = re.findall(r'src="data:video/mp4;base64,([^"]+)"', html)
    assert 'poster="data:image/png;base64,' in html
    path = folder / "video.mp4"
    path.write_bytes(base64.b64decode(data))
    frames, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    reader.close()
    assert (meta["codec"], meta["pix_fmt"][:7]) == ("h264", "yuv420p")
    return meta, frames


def in_words(value: float) -> str:
    """A number as sentences write it."""
    return style.number(value) if abs(value) >= 100 else f"{value:.2f}".replace("-", "−")


def test_bodies(execute: Execute, tmp_path: Path) -> None:
    page = execute("01_bodies", body="Ant6", seed=3, video_s=0.2)
    pictures = {
        cell.id: cell.outputs for cell in page.cells if cell.id in ("fig-2a", "fig-2c", "strip")
    }
    for name, size in (("fig-2a", (1456, 300)), ("fig-2c", (1944, 608))):
        picture = base64.b64decode(pictures[name][0].data["image/png"])
        assert Image.open(io.BytesIO(picture)).size == size
    table = words(output(page, "differs"))
    assert "Atlas" not in table  # the humanoids have a page of their own
    for name in bodies.names("halfcheetah") + bodies.names("ant"):
        length_m = bodies.get(name).length[1]
        assert re.search(rf"{name} \D+ {length_m:.2f} {describe(name)['total_mass_kg']:.2f}", table)
    assert "Ant0 Ant1" in words(output(page, "lengths"))  # the family of the body asked for
    joints = words(output(page, "joints"))
    assert joints.startswith("joint of Ant6")
    assert re.search(r"ankle_4 0\.52 1\.75 250\.00", joints)
    meta, frames = video(output(page, "clip"), tmp_path)
    assert meta["size"] == (640, 480)
    assert frames == 6
    strip = base64.b64decode(pictures["strip"][0].data["image/png"])
    assert Image.open(io.BytesIO(strip)).width == 1500


def test_experts(execute: Execute, data_dir: Path, tmp_path: Path) -> None:
    before = hashes(data_dir)
    page = execute("02_experts", body="HC1", seed=7, n_trajectories=1, video_s=0.2)
    assert hashes(data_dir) == before  # a tiny budget touches nothing that is committed
    config = RunConfig.create("HC1", "ppo", budget="tiny", seed=7)
    record = runs.find(config.run_id)
    assert record is not None
    assert record.folder == data_dir / "runs" / "halfcheetah" / config.run_id
    spoken = said(page)
    assert spoken["return_here"] == in_words(record.evaluation["return_mean"])
    frame = results.load_records("halfcheetah", "book")
    expert = results.scores(frame, "ppo", "HC0", "return_mean").mean()
    assert spoken["expert_return"] == in_words(expert)
    assert spoken["random_return"] == in_words(
        results.scores(frame, "random", "HC0", "return_mean").mean()
    )
    assert glue_roles(page) <= spoken.keys()
    assert config.run_id in words(output(page, "settings"))
    for cell_id in ("curve", "experts", "curves"):
        assert output(page, cell_id).startswith("<svg")
    assert "18 runs" in words(output(page, "experts-runs"))
    assert re.search(r"HC1 800 5 [\d,]+ .* HC1 2,000 1 1,2\d\d ", words(output(page, "longer")))
    unlike = words(output(page, "unlike-ppo1"))
    assert re.search(r"as in this book 5 [\d,]+ .*clipping of actions off 0", unlike)
    _, frames = video(output(page, "video"), tmp_path)
    assert frames == 6
    demonstrator = find_demonstrator(frame)
    assert f"trial {demonstrator}: of the 5 experts" in spoken["demonstrator_rule"]
    table = words(output(page, "gaits"))
    assert len(re.findall(r"\d (?:\(chosen\) )?[\d,]+ ± \d+", table)) == 5
    assert f" {demonstrator} (chosen) " in f" {table}"


def find_demonstrator(frame: pd.DataFrame) -> int:
    """The trial of HC0's expert with the highest return."""
    return int(results.cell(frame, "ppo", "HC0").set_index("seed")["return_mean"].idxmax())


def test_demonstrations(execute: Execute, data_dir: Path) -> None:
    before = hashes(data_dir)
    page = execute("03_demonstrations", n_trajectories=1, window_s=0.5)
    assert hashes(data_dir) == before
    expert = RunConfig.create("HC0", "ppo", budget="book", seed=1).run_id
    assert output(page, "expert") == repr(expert)
    path = data_dir / "runs" / "notebooks" / f"demonstrations_{expert}.npz"
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert f"HC0 26 features, 1 episodes, SHA-256 {digest[:12]}" in output(page, "save")
    assert re.search(r"0 1,001 26 −?[\d,]+", words(output(page, "record")))
    distribution = words(output(page, "distribution"))
    assert all(f"{name} " in distribution for name in feature_names("HC0"))
    assert "HC0 a random policy 20" in words(output(page, "manifest"))
    assert output(page, "strides").startswith("<svg")
    assert glue_roles(page) <= said(page).keys()


def test_demonstrations_without_an_expert(execute: Execute) -> None:
    page = execute("03_demonstrations", body="HC1", budget="paper", n_trajectories=1)
    assert re.fullmatch(r"'ppo_HC1_tiny-2_s1_\w+'", output(page, "expert"))


def test_imitation(execute: Execute, data_dir: Path, tmp_path: Path) -> None:
    before = hashes(data_dir)
    page = execute("04_imitate", body="HC1", method="silem", seed=3, video_s=0.2)
    assert hashes(data_dir) == before
    config = RunConfig.create("HC1", "silem", "HC0", "tiny", 3)
    record = runs.find(config.run_id)
    assert record is not None
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    assert spoken["disc_reward"] == in_words(record.evaluation["disc_reward_mean"])
    best = paper.best_combination("HC1", "silem", "HC0")[0]
    settings = words(output(page, "config"))
    assert config.run_id in settings
    assert f"n_trajectories {best['n_trajectories']} supplement" in settings
    assert output(page, "curve").startswith("<svg")
    assert output(page, "transform").startswith("<svg")
    _, frames = video(output(page, "video"), tmp_path)
    assert frames == 6


def found_on(body: str, frame: pd.DataFrame) -> float:
    rows = claims.evaluate(frame).set_index("text")
    return rows.loc[f"SILEM beats SILEM⁻ on {body}", "findings"][0].detectable


def test_halfcheetah(execute: Execute, tmp_path: Path) -> None:
    page = execute("05_halfcheetah", video_s=0.2)
    frame = results.load_records("halfcheetah", "book")
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    for method in ("silem", "silem-minus", "silem-minus-own"):
        for body in ("HC0", "HC1", "HC2"):
            score = results.scores(frame, method, body).mean()
            assert spoken[f"{method.replace('-', '_')}_{body}"] == in_words(score)
    for cell_id in ("fig-2b", "curves", "transforms"):
        assert output(page, cell_id).startswith("<svg")
        assert "commit 0123456" in words(output(page, f"{cell_id}-runs"))
    speeds = results.scores(frame, "ppo", "HC2", "speed_m_s")
    assert spoken["expert_speed_HC2"] == in_words(speeds.mean())
    assert spoken["found_HC1"] == in_words(found_on("HC1", frame))
    assert "−1,555" in words(output(page, "random"))
    assert "bootstrap" in words(output(page, "coverage"))
    missing = words(output(page, "missing")).partition("not made yet (")[2]
    absent = 5 * len(MISSING) - sum(MISSING.values())
    assert missing.count("silem run") == absent == int(spoken["n_missing"])
    meta, _ = video(output(page, "video"), tmp_path)
    assert meta["size"] == (2 * 640 + 8, 480)
    assert "SILEM | SILEM⁻" in words(output(page, "video"))


def test_affine_or_mlp(execute: Execute) -> None:
    page = execute("06_affine_or_mlp", budget="book")
    rows = {row["f"]: row for row in paper.table("tab1").rows}
    table = words(output(page, "table"))
    for name, row in rows.items():
        printed = [style.number(row[key]) for key in row if key != "f"]
        assert re.search(rf"{name} \d {printed[0]} {printed[1]} ", table)
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    frame = results.load_records("halfcheetah", "book")
    affine = results.scores(frame, "silem", "HC0", "return_mean")
    assert spoken["silem_return"] == in_words(float(affine.mean()))
    assert spoken["mlp_return"] == "–"  # its trials are among the missing ones
    assert np.isclose(affine.mean(), synthetic.EXPERT_RETURNS["HC0"] * 0.93, rtol=0.1)


def test_scorecard(execute: Execute) -> None:
    page = execute("07_scorecard", budget="book")
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    verdicts = claims.counts(results.load_records("halfcheetah", "book"))
    told = [int(spoken[key]) for key in ("n_hold", "n_fail", "n_undecided")]
    assert told == [verdicts[name] for name in (claims.HOLDS, claims.FAILS, claims.UNDECIDED)]
    assert sum(told) == int(spoken["n_claims"]) == len(claims.of("halfcheetah"))
    table = words(output(page, "scorecard"))
    assert all(claim.text in table for claim in claims.of("halfcheetah"))


def test_which_gait_can_be_imitated(execute: Execute) -> None:
    page = execute("13_demonstrators", n_trajectories=1, video_s=0.1)
    assert output(page, "imitated").startswith("<svg")
    assert "20 of the planned runs not made yet" in words(output(page, "imitated-runs"))
    assert words(output(page, "decided")).count("not to be told yet") == 2
    assert "No video" in output(page, "video")


def test_any_body_in_one_page(execute: Execute, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bodies, "_BODIES", dict(bodies._BODIES))
    monkeypatch.setattr(bodies, "_OWN", {})
    page = execute("16_any_body", video_s=0.1, steps=512)
    assert "hip angle" in words(output(page, "features"))
    assert "silem_Quadruped_from_HC0_tiny_s0_" in words(output(page, "run"))
    assert output(page, "transform").startswith("<svg")
    assert "first actions" in output(page, "share")
    assert "height" in words(output(page, "any-run"))


def test_beyond_the_paper(execute: Execute) -> None:
    page = execute("17_beyond")
    assert glue_roles(page) <= said(page).keys()
    for cell_id in ("ladder", "ladder-T", "ladder-ant", "slope", "slope-T", "slope-humanoid"):
        assert output(page, cell_id).startswith("<svg")
    assert words(output(page, "half")).count("–") == 18  # not every torso has been run
    assert "planned runs that are not made yet (82)" in words(output(page, "ladder-runs"))
    verdicts = words(output(page, "slope-verdict"))
    assert all(claim.text in verdicts for claim in claims.of("slope"))
    assert verdicts.count("undecided") == len(claims.of("slope"))
    assert "HC0 affine, K = 1 5" in words(output(page, "ensembles"))
    assert "no run" in words(output(page, "arms"))
    for part in ("ladder", "ladder-ant", "slope", "ensembles", "arms"):
        assert "is finished; " in words(output(page, f"{part}-load")), part


def test_open_settings(execute: Execute) -> None:
    page = execute("08_open_settings")
    spoken = said(page)
    assert glue_roles(page) <= spoken.keys()
    assert spoken["near_best"] == "2"
    assert "in the study now" in words(output(page, "search"))
    assert "How far the transforms went" in words(output(page, "travel"))
    for cell_id in ("humanoid-ppo-curves", "humanoid-silem-curves"):
        assert output(page, cell_id).startswith("<svg")
    assert "hc2_gp1_1000" in words(output(page, "open-91"))


@pytest.mark.parametrize("name", PAGES)
def test_without_records_a_page_says_so(execute: Execute, name: str) -> None:
    page = execute(name, budget="paper")  # no run of the made-up study has this budget
    text = words("".join(output(page, cell.id) for cell in page.cells if cell.cell_type == "code"))
    assert "budget paper" in text
    assert "0 runs" in text
    if name == "05_halfcheetah":
        spoken = said(page)
        listed = words(output(page, "missing")).count("silem run")
        assert int(spoken.pop("n_missing")) == listed > 0
        assert spoken.pop("power") == "80"
        assert set(spoken.values()) == {"–", "undecided"}
        assert "HC2, first trials, in real time: SILEM: no run yet" in text
    if name == "07_scorecard":
        assert said(page)["n_undecided"] == str(len(claims.of("halfcheetah")))
