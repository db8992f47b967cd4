"""The committed evidence: records, demonstrations and what the published figures rest on.

Everything here reads the repository's own data folder, wherever ``SILEM_DATA_DIR`` points.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from silem.bodies import humanoid
from silem.motion.demonstrations import MANIFEST, Demonstrations
from silem.motion.features import FEATURES
from silem.report import results
from silem.study import studies, verify
from silem.study.config import SEARCH
from silem.study.runs import POLICY, RECORD, RunRecord
from silem.study.settings import HUMAN, expert_of
from silem.util import files, paths

DATA = paths.REPO / "data"
RECORDS = sorted((DATA / "results").glob(f"*/*/{RECORD}"))
STUDIES = sorted({path.parent.parent.name for path in RECORDS})
MANIFEST_PATH = DATA / "demonstrations" / MANIFEST
MANIFEST_CONTENT = files.read_json(MANIFEST_PATH) if MANIFEST_PATH.is_file() else {}
MAX_BYTES = 1_000_000  # of one committed file: evidence, not checkpoints

needs_records = pytest.mark.skipif(not RECORDS, reason="no run has been published yet")
needs_demonstrations = pytest.mark.skipif(
    not MANIFEST_CONTENT, reason="no demonstrations have been published yet"
)


def planned_as(folder: str) -> str:
    """The study of a folder's runs: of a search STUDY/BODY/METHOD."""
    if not folder.startswith(SEARCH):
        return folder
    return folder.removeprefix(SEARCH).replace("-", "/", 2)


@pytest.fixture(autouse=True)
def committed_data(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SILEM_DATA_DIR", raising=False)


@needs_records
@pytest.mark.parametrize("path", RECORDS, ids=lambda path: path.parent.name)
def test_record_is_sound_and_whole(path: Path) -> None:
    record = verify.check(path.parent)
    verify.check_source(record)
    config = record.run_config
    assert config.study == path.parent.parent.name
    assert config.is_published
    assert config.seed in studies.study_of(planned_as(config.study)).seeds
    present = {file.name: file.stat().st_size for file in path.parent.iterdir()}
    assert set(present) == {*record.files, RECORD}
    assert max(present.values()) <= MAX_BYTES
    if record.files:
        curve = results.load_curve(record.run_id)
        assert curve["return_mean"].notna().any()
        assert curve["disc_reward"].notna().any() == bool(config.demonstrations)


@needs_records
@pytest.mark.parametrize("study", STUDIES)
def test_one_policy_of_each_study_does_what_its_record_says(study: str) -> None:
    """Exact where the record's processor is this one, else within `verify.TOLERANCE`."""
    trained = [path.parent for path in RECORDS if path.parent.parent.name == study]
    chosen = next(folder for folder in trained if (folder / POLICY).exists())
    verdict = verify.verify(chosen)
    assert verdict.outcome in (verify.EXACT, verify.WITHIN), verdict


@needs_records
@pytest.mark.parametrize("study", STUDIES)
def test_no_published_run_is_left_out_of_the_figures(study: str) -> None:
    """A run of other settings or seeds in a study's folder would be evidence that nobody sees.

    A shorter run gives way to a longer one of its cell and seed.
    """
    for budget in {RunRecord.load(path).run_config.budget.base_name for path in RECORDS}:
        frame = results.load_records(planned_as(study), budget)
        for run_id in frame.attrs["set_aside"]:
            config = results.find(run_id).run_config
            same = [frame[name] == getattr(config, name) for name in ("method", "body", "seed")]
            longest = frame.loc[same[0] & same[1] & same[2], "n_iterations"].max()
            assert config.budget.n_iterations < longest, run_id


@needs_demonstrations
def test_manifest_lists_every_file_and_no_other() -> None:
    assert {path.stem for path in MANIFEST_PATH.parent.glob("*.npz")} == set(MANIFEST_CONTENT)


@needs_demonstrations
@pytest.mark.parametrize("name", MANIFEST_CONTENT)
def test_manifest_describes_the_demonstrations(name: str) -> None:
    entry = MANIFEST_CONTENT[name]
    path = MANIFEST_PATH.parent / f"{name}.npz"
    assert files.sha256(path) == entry["sha256"]
    demonstrations = Demonstrations.load(path)
    assert len(demonstrations.features) == entry["n_trajectories"]
    assert demonstrations.n_features == entry["n_features"]
    assert demonstrations.body == entry["body"]
    assert demonstrations.expert_run_id == entry["expert_run_id"]
    if demonstrations.expert_run_id:
        assert demonstrations.body == expert_of(name)[0]
        assert np.mean(demonstrations.returns) == pytest.approx(entry["return_mean"])
        assert np.std(demonstrations.returns) == pytest.approx(entry["return_std"])
    else:
        assert demonstrations.returns == ()
        assert entry["source"].startswith("http://mocap.cs.cmu.edu/")
        assert "mocap.cs.cmu.edu" in entry["acknowledgement"]


@needs_demonstrations
@pytest.mark.parametrize("name", [name for name, e in MANIFEST_CONTENT.items() if "clip" in e])
def test_a_clips_entry_says_where_it_is_from(name: str) -> None:
    entry = MANIFEST_CONTENT[name]
    assert entry["expert_run_id"] == "" and entry["n_features"] == len(FEATURES)
    assert entry["source"].startswith("http://mocap.cs.cmu.edu/") and entry["licence"]
    assert "NSF EIA-0196217" in entry["acknowledgement"]
    if original := entry.get("retargeted_from"):
        assert entry["retargeted_from_sha256"] == MANIFEST_CONTENT[original]["sha256"]


def test_the_rewards_speed_is_the_demonstrators() -> None:
    speed_m_s = MANIFEST_CONTENT[HUMAN]["speed_m_s"]
    assert humanoid.DEMONSTRATOR_SPEED_M_S == pytest.approx(speed_m_s, abs=5e-4)


@needs_demonstrations
@pytest.mark.parametrize("name", [name for name, e in MANIFEST_CONTENT.items() if "clip" not in e])
def test_demonstrations_come_from_a_published_expert(name: str) -> None:
    entry = MANIFEST_CONTENT[name]
    record = results.find(entry["expert_run_id"])
    config = record.run_config
    assert (config.method, config.body) == ("ppo", expert_of(name)[0])
    # The same stochastic policy: its demonstrations are worth what its evaluation was.
    spread = max(entry["return_std"], record.evaluation["return_std"])
    error = spread * (1 / entry["n_trajectories"] + 1 / record.evaluation["n_episodes"]) ** 0.5
    assert abs(entry["return_mean"] - record.evaluation["return_mean"]) <= 5 * error
