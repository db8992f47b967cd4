"""Fabricated records: each is sound but for one lie, which must be told."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic_records as synthetic

from silem.cli import main
from silem.motion import demonstrations as demos
from silem.study import runs, verify
from silem.study.config import RunConfig
from silem.study.runs import CURVE, POLICY, RECORD, TRANSFORM, git
from silem.study.settings import Budget
from silem.util import files
from silem.util.errors import SilemError

Content = dict[str, Any]
OTHER_MACHINE = {"processor": "another", "cores": 1, "kernels": {}}


def config(seed: int) -> RunConfig:
    budget = Budget("small", 2, 128, 4, 1, 2, 2)
    return RunConfig.create("HC0", "ppo", None, budget, seed, minibatch_size=32, n_epochs=2)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with two finished runs."""
    folder = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SILEM_DATA_DIR", str(folder))
        for seed in (0, 1):
            runs.run(config(seed), progress=False)
    return folder


@pytest.fixture
def folders(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The folders of copies of the two runs."""
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path / "data"))
    shutil.copytree(made, tmp_path / "data")
    return [runs.run_folder(config(seed)) for seed in (0, 1)]


def rewrite(folder: Path, change: Callable[[Content], object]) -> None:
    content = files.read_json(folder / RECORD)
    change(content)
    files.write_json(folder / RECORD, content)


def shifted(content: Content, by: float, *, mean: bool = True) -> None:
    """Raise every return, and their mean with them."""
    evaluation = content["evaluation"]
    evaluation["returns"] = [value + by for value in evaluation["returns"]]
    evaluation["return_mean"] += by if mean else 0


def few_episodes(content: Content) -> None:
    evaluation = content["evaluation"]
    returns = evaluation["returns"][:1]
    evaluation |= {
        "n_episodes": 1,
        "returns": returns,
        "return_mean": returns[0],
        "return_std": 0.0,
    }


def put(*keys: str, to: Any) -> Callable[[Content], None]:
    def change(content: Content) -> None:
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = to

    return change


def test_an_honest_record_is_exact_here_and_from_another_processor(folders: list[Path]) -> None:
    assert verify.verify(folders[0]).outcome == verify.EXACT
    assert verify.verify(folders[0], 1).outcome == verify.EXACT
    assert verify.verify(folders[0], 0).outcome == verify.SOUND
    rewrite(folders[0], put("provenance", "machine", to=OTHER_MACHINE))
    assert verify.verify(folders[0]).outcome == verify.EXACT


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda content: shifted(content, 5000, mean=False), "return_mean is not the mean"),
        (lambda content: shifted(content, 5000), "return_mean is"),
        (few_episodes, "1 returns of 1 episodes; its budget has 2"),
        (put("evaluation", "return_std", to=-3.0), "return_std is not the std"),
        (put("evaluation", "upright", to=7.5), r"upright is 7\.5"),
        (put("evaluation", "speed_m_s", to=1e6), "speed_m_s is"),
        (put("evaluation", "steps_mean", to=0.5), r"steps_mean is 0\.5; it can be 1 to 1000"),
        (put("wall_time_s", to=-5.0), "wall_time_s is -5"),
        (put("processor_time_s", to=-5.0), "processor_time_s is -5"),
        (put("wall_time_s", to="long"), "lacks or misstates"),
        (put("training", "n_steps", to=10**6), "1000000 steps"),
        (put("training", "steps_per_s", to=-1.0), "steps_per_s is -1"),
        (put("status", to="running"), "status is 'running'"),
        (put("demonstrations_sha256", to="0" * 64), "demonstrations_sha256"),
        (put("evaluation", "returns", to=None), "lacks or misstates"),
        (lambda content: content["files"].pop(POLICY), "expected:"),
        (put("files", "../x", to="0" * 64), "expected:"),
        (put("evaluation", "speed_m_s", to=None), "it does not say speed_m_s"),
        (put("evaluation", "upright", to=None), "it does not say upright"),
        (put("training", "steps_per_s", to=None), "it does not say steps_per_s"),
        (put("evaluation", "disc_reward_mean", to=9.0), "ppo has no discriminator"),
        (put("training", "disc_reward_last", to=9.0), "ppo has no discriminator"),
        (put("training", "disc_reward_last", to=-7.0), "disc_reward_last is -7"),
    ],
)
def test_a_fabricated_record_is_told(
    folders: list[Path], change: Callable[[Content], object], message: str
) -> None:
    rewrite(folders[0], change)
    with pytest.raises(SilemError, match=message):
        verify.check(folders[0])
    assert verify.verify(folders[0]).outcome == verify.NOT


def test_another_runs_policy_is_told_by_its_id_or_by_what_it_does(folders: list[Path]) -> None:
    mine, other = folders
    shutil.copy(other / POLICY, mine / POLICY)
    rewrite(mine, put("files", POLICY, to=files.sha256(mine / POLICY)))
    with pytest.raises(SilemError, match=rf"is the policy of '{other.name}'"):
        verify.check(mine)
    arrays, _ = files.read_tensors(other / POLICY)
    files.write_tensors(mine / POLICY, arrays, {"run_id": mine.name})
    rewrite(mine, put("files", POLICY, to=files.sha256(mine / POLICY)))
    verify.check(mine)  # nothing in the files tells it now
    verdict = verify.verify(mine)
    assert verdict.outcome == verify.NOT and "0 of 2 returns equal" in verdict.why


def test_another_bodys_policy_is_told_before_it_acts(folders: list[Path], capsys) -> None:
    ant = RunConfig.create("Ant0", "ppo", None, config(0).budget, 0, minibatch_size=32, n_epochs=2)
    other = runs.run(ant, progress=False).folder
    arrays, _ = files.read_tensors(other / POLICY)
    files.write_tensors(folders[0] / POLICY, arrays, {"run_id": folders[0].name})
    rewrite(folders[0], put("files", POLICY, to=files.sha256(folders[0] / POLICY)))
    assert "of another body" in verify.verify(folders[0]).why
    assert main(["evaluate", folders[0].name, "--quiet"]) == 2
    assert "its observation_space is (28,), not (26,)" in capsys.readouterr().err


@pytest.mark.parametrize("lost", ["packages", "machine"])
@pytest.mark.parametrize("to", [None, 3])
def test_a_record_of_other_form_is_told_and_no_traceback(
    folders: list[Path], lost: str, to: object
) -> None:
    rewrite(folders[0], lambda content: shifted(content, 0.5))
    rewrite(folders[0], put("provenance", lost, to=to))
    assert verify.verify(folders[0]).outcome in (verify.NOT, verify.WITHIN)
    rewrite(folders[0], put("evaluation", "n_episodes", to=2.0))
    assert verify.verify(folders[0]).outcome in (verify.NOT, verify.WITHIN)


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("return_mean", "inf"), ("speed_m_s", "1e6"), ("disc_reward", "-5"), ("disc_reward", "1e4"),
        ("disc_acc_expert", "7.5"), ("disc_acc_learner", "-0.1"), ("policy_std", "-3"),
    ],
)  # fmt: skip
def test_a_curve_that_no_run_leaves_is_told(folders: list[Path], column: str, value: str) -> None:
    path = folders[0] / CURVE
    names, first, *rest = (line.split(",") for line in path.read_text().splitlines())
    first[names.index(column)] = value
    for kept in (slice(None), slice(2)):  # the second lacks columns
        files.write_text(path, "".join(f"{','.join(r[kept])}\n" for r in (names, first, *rest)))
        rewrite(folders[0], put("files", CURVE, to=files.sha256(path)))
        with pytest.raises(SilemError, match=rf"{column} is .* it can|has the columns iteration"):
            verify.check(folders[0])


def test_another_runs_curve_is_told(folders: list[Path]) -> None:
    text = (folders[0] / CURVE).read_text().splitlines()
    files.write_text(folders[0] / CURVE, "\n".join(text[:-1]) + "\n")
    rewrite(folders[0], put("files", CURVE, to=files.sha256(folders[0] / CURVE)))
    with pytest.raises(SilemError, match="no curve of 4 iterations"):
        verify.check(folders[0])


@pytest.mark.parametrize(("by", "outcome"), [(0.5, verify.WITHIN), (1500.0, verify.NOT)])
def test_on_another_processor_only_the_mean_must_agree(
    folders: list[Path], by: float, outcome: str
) -> None:
    rewrite(folders[0], lambda content: shifted(content, by))
    assert verify.verify(folders[0]).outcome == verify.NOT  # exact or not at all on this one
    rewrite(folders[0], put("provenance", "machine", to=OTHER_MACHINE))
    assert verify.verify(folders[0]).outcome == outcome
    rewrite(folders[0], lambda content: content["provenance"].pop("machine"))  # an older record
    assert verify.verify(folders[0]).outcome == outcome


def test_all_episodes_also_tell_a_false_length(folders: list[Path]) -> None:
    evaluation = files.read_json(folders[0] / RECORD)["evaluation"]
    assert evaluation["steps_mean"] == 1000  # a HalfCheetah's episodes never end early
    rewrite(folders[0], put("evaluation", "steps_mean", to=900.0))
    assert verify.verify(folders[0]).outcome == verify.NOT
    rewrite(folders[0], lambda content: content["evaluation"].pop("steps_mean"))  # an older record
    assert verify.verify(folders[0]).outcome == verify.EXACT


def test_all_episodes_also_tell_a_false_speed(folders: list[Path]) -> None:
    rewrite(folders[0], put("evaluation", "speed_m_s", to=2.5))
    assert verify.verify(folders[0], 1).outcome == verify.EXACT
    assert verify.verify(folders[0], 2).outcome == verify.NOT


def test_evidence_names_commits_of_the_history(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    head = git("rev-parse", "HEAD")
    if head is None:
        pytest.skip("there is no git here")
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    expert = RunConfig.create("HC1", "ppo", budget="book")
    verify.check_source(synthetic.write_record(expert, commit=head))
    with pytest.raises(SilemError, match=r"commit 0123456789ab.*not in history"):
        verify.check_source(synthetic.write_record(expert))
    for commits in ({"git_commit": []}, {"earlier_commits": 5}, {"earlier_commits": [[]]}):
        record = synthetic.write_record(expert, commit=head)
        rewrite(record.folder, lambda content, c=commits: content["provenance"].update(c))
        assert verify.verify(record.folder, 0).outcome == verify.NOT
    smaller = RunConfig.create("HC1", "ppo", budget="quick")
    verify.check_source(synthetic.write_record(smaller))  # no evidence


@pytest.mark.parametrize("name", ["scale", "gate.bias", "shares", None])
def test_an_ensemble_without_one_of_its_parts_is_told(
    name: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    config = RunConfig.create("HC0", "silem", budget="book", transform_components=4)
    record = synthetic.write_record(config, 900.0)
    path = record.folder / TRANSFORM
    arrays = files.read_npz(path)
    if name:
        arrays[name] = arrays[name][:3]
        files.write_npz(path, arrays)
        rewrite(record.folder, put("files", TRANSFORM, to=files.sha256(path)))
        with pytest.raises(SilemError, match=r"expected: A and b, \(F,\) each, 4 map\(s\)"):
            verify.check(record.folder)
    else:
        verify.check(record.folder)


def test_a_transform_of_other_width_than_the_demonstrations_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    record = synthetic.write_record(RunConfig.create("Humanoid", "silem", budget="tiny"))
    _, sha = demos.load_published("cmu_08_01")
    assert "made with other demonstrations" in verify.verify(record.folder, 0).why
    rewrite(record.folder, put("demonstrations_sha256", to=sha))
    assert verify.verify(record.folder, 0).outcome == verify.SOUND
    files.write_npz(record.folder / TRANSFORM, {"A": np.ones(3), "b": np.ones(3)})
    rewrite(record.folder, put("files", TRANSFORM, to=files.sha256(record.folder / TRANSFORM)))
    assert verify.verify(record.folder, 0).why == "transform.npz is of 3 features, not 23"


def test_the_command_names_what_is_not_so(
    folders: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    name = folders[0].name
    assert main(["verify", name]) == 0
    assert f"{name}: exact (2 of 2 returns equal" in capsys.readouterr().out
    rewrite(folders[0], put("evaluation", "upright", to=7.5))
    assert main(["verify", name, "--episodes", "0"]) == 2
    assert "1 of 1 are not what they say" in capsys.readouterr().err
    for unknown in ("nothing", "*", "../runs", "x" * 300):
        assert main(["verify", unknown]) == 2
        assert "run" in capsys.readouterr().err
