from __future__ import annotations

import dataclasses
import gc
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from silem import bodies, cli
from silem.motion import demonstrations
from silem.motion.demonstrations import Demonstrations
from silem.study import runs, settings, training
from silem.study.config import RunConfig
from silem.study.evaluate import RandomPolicy, demonstrate, evaluate, load_policy
from silem.study.runs import (
    CHECKPOINT,
    CURVE,
    CURVE_COLUMNS,
    POLICY,
    RECORD,
    TRANSFORM,
    RunRecord,
    curve_csv,
    curve_row,
    thinned,
)
from silem.study.settings import Budget
from silem.study.training import Checkpoint
from silem.util import files, paths, seeding
from silem.util.errors import SilemError

SMALL = {"minibatch_size": 32, "n_epochs": 2}


def small(method: str, seed: int = 0, n_iterations: int = 6, name: str = "small") -> RunConfig:
    """A configuration that trains in a second."""
    budget = Budget(name, 2, 128, n_iterations, 1, 2, 2)
    hyper = {} if method == "random" else SMALL
    if method.startswith("silem"):
        hyper = hyper | {"n_trajectories": 2}
    return RunConfig.create("HC0", method, None, budget, seed, **hyper)


def write_demonstrations(seed: int = 0, n_features: int | None = None) -> None:
    rng = np.random.default_rng(seed)
    width = n_features or bodies.get("HC0").observation_size
    walks = [np.float32(0.1) * rng.standard_normal((50, width)).cumsum(0) for _ in range(2)]
    made = Demonstrations(tuple(w.astype(np.float32) for w in walks), (1.0, 2.0), "HC0", "walks")
    demonstrations.publish("HC0", made)


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty data folder with demonstrations of HC0."""
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path / "data"))
    write_demonstrations()
    return tmp_path / "data"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> dict[str, RunRecord]:
    """Uninterrupted runs, by method."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SILEM_DATA_DIR", str(tmp_path_factory.mktemp("finished")))
        write_demonstrations()
        methods = ("ppo", "silem", "random")
        return {method: runs.run(small(method), progress=False) for method in methods}


def content(record: RunRecord) -> dict[str, Any]:
    """What must not depend on how often a run was interrupted."""
    state, _ = files.read_tensors(record.folder / CHECKPOINT)
    return {
        "evaluation": record.evaluation,
        "files": {name: (record.folder / name).read_bytes() for name in record.files},
        "state": {name: array.tobytes() for name, array in state.items()},
    }


class StopAt:
    """Raises KeyboardInterrupt at chosen moments of a training."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *calls: int) -> None:
        self.left = set(calls)
        original = training.Segments._on_step
        self.count = 0

        def on_step(segments: training.Segments) -> bool:
            self.count += 1
            if self.count in self.left:
                raise KeyboardInterrupt
            return original(segments)

        monkeypatch.setattr(training.Segments, "_on_step", on_step)


def test_a_finished_run_is_returned_and_not_made_again(
    finished: dict[str, RunRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    record = finished["ppo"]
    monkeypatch.setenv("SILEM_DATA_DIR", str(record.folder.parents[2]))
    before = (record.folder / RECORD).stat().st_mtime_ns
    assert runs.run(small("ppo")) == record
    assert (record.folder / RECORD).stat().st_mtime_ns == before
    assert runs.state(small("ppo")) == "finished"
    assert runs.state(small("ppo", seed=1)) == "missing"


def test_what_a_run_leaves(finished: dict[str, RunRecord]) -> None:
    assert set(finished["ppo"].files) == {CURVE, POLICY}
    assert set(finished["silem"].files) == {CURVE, POLICY, TRANSFORM}
    assert not finished["random"].files
    for record in finished.values():
        assert RunRecord.load(record.folder) == record
        assert record.run_config.run_id == record.run_id
        assert len(record.evaluation["returns"]) == record.evaluation["n_episodes"] == 2
        text = (record.folder / RECORD).read_text()
        for private in (str(paths.REPO), str(record.folder), socket.gethostname()):
            assert private not in text
    silem = finished["silem"]
    # Threads aside, a process cannot work longer than it lives.
    assert 0 < silem.processor_time_s <= silem.wall_time_s + 0.1
    assert silem.provenance["machine"]["cores"] == os.cpu_count()
    assert silem.provenance["machine"]["processor"]
    assert silem.evaluation["disc_reward_mean"] > 0
    assert finished["ppo"].evaluation["disc_reward_mean"] is None
    transform = files.read_npz(silem.file(TRANSFORM))
    assert transform["A"].shape == transform["b"].shape == (bodies.get("HC0").observation_size,)
    assert not np.all(transform["A"] == 1)
    rows = (silem.folder / CURVE).read_text().splitlines()
    assert rows[0].split(",") == list(CURVE_COLUMNS[:10])  # no episode has ended
    assert [int(row.split(",")[1]) for row in rows[1:]] == [128 * i for i in range(1, 7)]


@pytest.mark.parametrize("method", ["ppo", "silem"])
def test_an_interrupted_run_ends_bit_identical(
    method: str, data: Path, finished: dict[str, RunRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    StopAt(monkeypatch, 100, 230, 300, 420)  # 64 steps are one iteration
    messages = []
    for _ in range(5):
        try:
            record = runs.run(small(method), progress=False)
        except KeyboardInterrupt as interrupt:
            messages.append(str(interrupt))
    assert len(messages) == 4
    assert "no checkpoint" in messages[0]
    assert "checkpoint is kept" in messages[1]
    assert all(small(method).command in message for message in messages)
    assert content(record) == content(finished[method])


def test_another_seed_or_another_segment_length_does_change_the_result(
    data: Path, finished: dict[str, RunRecord]
) -> None:
    """The comparison above could fail: what it compares is no constant."""
    reference = content(finished["ppo"])["files"][POLICY]
    other = runs.run(small("ppo", seed=1), progress=False)
    assert content(other)["files"][POLICY] != reference
    longer = Budget("small", 2, 128, 6, 1, 2, 6)
    unbroken = runs.run(RunConfig.create("HC0", "ppo", None, longer, 0, **SMALL), progress=False)
    assert content(unbroken)["files"][POLICY] != reference


def test_kill_9_at_random_moments(data: Path, tmp_path: Path) -> None:
    config = small("silem", n_iterations=20)
    reference = runs.run(config, progress=False)
    killed_data = tmp_path / "killed"
    shutil.copytree(data / "demonstrations", killed_data / "demonstrations")
    files.write_json(tmp_path / "config.json", config.to_dict())
    folder = killed_data / runs.run_folder(config).relative_to(data)
    code = "import json, sys; from silem import RunConfig, run; "
    code += "run(RunConfig.from_dict(json.load(open(sys.argv[1]))), progress=False)"
    rng = seeding.generator(int(time.time()), "kill test")
    kills = 0
    while not (folder / RECORD).exists():
        process = subprocess.Popen(
            [sys.executable, "-c", code, str(tmp_path / "config.json")],
            env=os.environ | {"SILEM_DATA_DIR": str(killed_data)},
            cwd=paths.REPO,
            stdout=subprocess.DEVNULL,
        )
        while process.poll() is None and not files.is_locked(folder / runs.LOCK):
            time.sleep(0.01)
        time.sleep(rng.uniform(0.0, 0.8))
        if kills < 3:
            kills += process.poll() is None
            process.send_signal(signal.SIGKILL)
        assert process.wait() in (0, -signal.SIGKILL)
    assert kills >= 2
    assert content(RunRecord.load(folder)) == content(reference)


def test_a_second_worker_is_refused(data: Path) -> None:
    config = small("ppo")
    with files.lock(runs.run_folder(config) / runs.LOCK):
        assert runs.state(config) == "running"
        with pytest.raises(SilemError, match=f"held by {os.getpid()}@"):
            runs.run(config, progress=False)


def interrupted(config: RunConfig, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Leave a run with a checkpoint behind and return the checkpoint."""
    with monkeypatch.context() as patch:
        StopAt(patch, 200)
        with pytest.raises(KeyboardInterrupt):
            runs.run(config, progress=False)
    assert runs.state(config) == "part"
    return runs.run_folder(config) / CHECKPOINT


def checkpoint(config: RunConfig, iteration: int) -> Checkpoint:
    """A checkpoint of a run that has learned nothing."""
    rows = [
        curve_row(i, i * config.budget.steps_per_iteration, {}) for i in range(1, iteration + 1)
    ]
    weights = {"policy/w": np.ones(3, dtype=np.float32)}
    seen = ("abc",), ("a CPU",)
    return Checkpoint(config.run_id, iteration, 1.0, 0.5, *seen, "", np.array(rows), weights)


def test_any_changed_byte_of_a_checkpoint_is_noticed(tmp_path: Path) -> None:
    path, config = tmp_path / CHECKPOINT, small("ppo")
    checkpoint(config, 4).save(path)
    whole = path.read_bytes()
    for i in range(0, len(whole), 3):
        changed = bytearray(whole)
        changed[i] ^= 1
        path.write_bytes(changed)
        with pytest.raises(SilemError, match=CHECKPOINT):
            Checkpoint.load(path, config, "")


def test_a_checkpoint_that_says_something_else_is_noticed(tmp_path: Path) -> None:
    """Say "finished" of an untrained one."""
    path, config = tmp_path / CHECKPOINT, small("ppo")
    checkpoint(config, 4).save(path)
    arrays, about = files.read_tensors(path)
    for changed in (
        about | {"wall_time_s": "9.0"},
        {k: v for k, v in about.items() if k != "sha256"},
    ):
        files.write_tensors(path, arrays, changed)
        with pytest.raises(SilemError, match=r"unusable checkpoint.*--force"):
            Checkpoint.load(path, config, "")
    dataclasses.replace(checkpoint(config, 4), curve=np.zeros((4, 9))).save(path)
    with pytest.raises(SilemError, match="of another version"):
        Checkpoint.load(path, config, "")


def test_a_checkpoint_of_before_processors_were_kept_is_gone_on_with(tmp_path: Path) -> None:
    path, config = tmp_path / CHECKPOINT, small("ppo")
    checkpoint(config, 4).save(path)
    arrays, about = files.read_tensors(path)
    older = {k: v for k, v in about.items() if k not in ("sha256", "processors")}
    files.write_tensors(path, arrays, older | {"sha256": training._digest(arrays, older)})
    found = Checkpoint.load(path, config, "")
    assert (found.commits, found.processors) == (("abc",), ())


def test_a_run_names_every_machine_that_it_was_on(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, here = small("ppo"), runs.provenance()
    there = here | {"machine": here["machine"] | {"processor": "elsewhere"}, "git_commit": "abc"}
    with monkeypatch.context() as patch:
        patch.setattr(runs, "provenance", lambda: there)
        interrupted(config, monkeypatch)
    found = runs.run(config, progress=False).provenance
    assert (found["earlier_commits"], found["earlier_processors"]) == (["abc"], ["elsewhere"])
    assert found["machine"] == here["machine"]


def test_a_damaged_or_foreign_checkpoint_is_refused_and_kept(
    data: Path, finished: dict[str, RunRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    config = small("silem")
    path = interrupted(config, monkeypatch)
    whole = path.read_bytes()
    foreign = (finished["ppo"].folder / CHECKPOINT).read_bytes()
    for bad, message in ((whole[:-9], "unusable checkpoint"), (foreign, "is a checkpoint of ppo_")):
        path.write_bytes(bad)
        with pytest.raises(SilemError, match=rf"{message}.*--force"):
            runs.run(config, progress=False)
        assert path.read_bytes() == bad
    path.write_bytes(whole)
    assert content(runs.run(config, progress=False)) == content(finished["silem"])


def test_other_demonstrations_are_noticed(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = small("silem")
    interrupted(config, monkeypatch)
    write_demonstrations(seed=1)
    with pytest.raises(SilemError, match="made with other demonstrations"):
        runs.run(config, progress=False)
    write_demonstrations(seed=0)
    record = runs.run(config, progress=False)
    policy = content(record)["files"][POLICY]
    write_demonstrations(seed=1)
    with pytest.raises(SilemError, match="made with other demonstrations"):
        runs.run(config, progress=False)
    with monkeypatch.context() as patch:
        patch.setattr(paths, "checkout", lambda: data.parent)
        with pytest.raises(SilemError, match=f"replace it with {config.command} --force"):
            runs.run(config, progress=False)  # nothing that is committed
        shutil.copytree(record.folder, data / "results" / "halfcheetah" / config.run_id)
        with pytest.raises(SilemError, match="or set SILEM_DATA_DIR to another folder"):
            runs.run(config, progress=False)
        shutil.rmtree(data / "results")
    again = runs.run(config, progress=False, force=True)
    assert again.demonstrations_sha256 == files.sha256(demonstrations.file_of("HC0"))
    assert again.demonstrations_sha256 != record.demonstrations_sha256
    assert content(again)["files"][POLICY] != policy


def test_unusable_demonstrations_stop_a_run_before_it_starts(data: Path) -> None:
    path = demonstrations.file_of("HC0")
    write_demonstrations(n_features=5)
    with pytest.raises(SilemError, match="5 features"):
        runs.run(small("silem"), progress=False)
    write_demonstrations()
    whole = path.read_bytes()
    walks = Demonstrations.load("HC0")
    for other in (lambda: path.write_bytes(whole[:-5]), lambda: walks.first(1).save(path)):
        other()  # the second is sound in itself
        with pytest.raises(SilemError, match=r"HC0\.npz is not the file that manifest\.json"):
            runs.run(small("silem"), progress=False)
    demonstrations.publish("HC0", dataclasses.replace(walks, body="HC1"))
    with pytest.raises(SilemError, match="demonstrations of 'HC1', another body"):
        runs.run(small("silem"), progress=False)
    path.unlink()
    with pytest.raises(SilemError, match=r"no demonstrations of HC0.*silem run"):
        runs.run(small("silem"), progress=False)
    assert runs.state(small("silem")) == "missing"


def test_what_stops_a_run_beforehand_leaves_nothing_and_names_what_helps(data: Path) -> None:
    config = RunConfig.create("HC1", "silem", "HC0", n_trajectories=3)
    with pytest.raises(SilemError, match=r"n_trajectories is 3, and .*HC0\.npz holds 2"):
        runs.run(config, progress=False)
    demonstrations.file_of("HC0").unlink()
    with pytest.raises(SilemError, match="no demonstrations of HC0") as error:
        runs.run(config, progress=False)
    assert not paths.runs_dir().exists()
    for command in re.findall("`silem (.*?)`", str(error.value)):
        fewer = ["--trajectories", "1"] if "demonstrations" in command else []
        assert cli.main([*command.split(), *fewer, "--quiet"]) == cli.OK
    assert demonstrations.entry("HC0")["n_trajectories"] == 1


def test_one_trials_demonstrations_are_made_by_that_trial(data: Path) -> None:
    config = RunConfig.create("HC1", "silem", "HC0_s3", "quick")
    with pytest.raises(SilemError, match="no demonstrations of HC0_s3") as error:
        runs.run(config, progress=False)
    train, record = (
        cli.parser().parse_args(command.split())
        for command in re.findall("`silem (.*?)`", str(error.value))
    )
    assert (train.body, train.method, train.seed, train.budget) == ("HC0", "ppo", 3, "quick")
    assert (record.body, record.trial, record.budget) == ("HC0", 3, "quick")


def test_evidence_is_published_and_found_without_the_working_files(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = small("ppo", n_iterations=2, name="book")
    with pytest.raises(SilemError, match=r"'book' has another n_envs.*give it a name of its own"):
        runs.run(config, progress=False)
    assert not paths.runs_dir().exists()
    monkeypatch.setitem(settings.BUDGETS, "book", config.budget)
    record = runs.run(config, progress=False)
    published = paths.results_dir("halfcheetah") / config.run_id
    assert sorted(os.listdir(published)) == sorted([CURVE, POLICY, RECORD])
    assert sorted(os.listdir(runs.run_folder(config))) == [CHECKPOINT, runs.LOCK]
    shutil.rmtree(paths.runs_dir())
    assert runs.run(config, progress=False) == record
    assert not paths.runs_dir().exists()
    (published / POLICY).write_bytes(b"something else")
    with pytest.raises(SilemError, match="SHA-256 differs"):
        load_policy(RunRecord.load(published))


def test_a_saved_policy_repeats_its_evaluation(finished: dict[str, RunRecord]) -> None:
    for record in finished.values():
        result = evaluate(load_policy(record), "HC0", 2)
        assert result.returns == record.evaluation["returns"]


def test_trials_of_the_random_policy_differ() -> None:
    returns = [evaluate(RandomPolicy("HC0", seed), "HC0", 1).returns for seed in (0, 1, 0)]
    assert returns[0] == returns[2] != returns[1]


def test_demonstrations_of_an_expert(
    data: Path, finished: dict[str, RunRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    command = f"silem demonstrations --run {finished['ppo'].run_id} --trajectories 1 --force"
    with pytest.raises(
        SilemError, match=f"trajectories of walks already; replace it with {command}"
    ):
        demonstrate(finished["ppo"], 1)
    path = demonstrate(finished["ppo"], 1, force=True)
    made = Demonstrations.load("HC0")
    assert made.expert_run_id == finished["ppo"].run_id
    assert [array.shape for array in made.features] == [(1001, bodies.get("HC0").observation_size)]
    before = path.stat().st_mtime_ns
    assert demonstrate(finished["ppo"], 1).stat().st_mtime_ns == before  # nothing to do
    shutil.copy(path, path.with_name("HC0_s3.npz"))
    with pytest.raises(SilemError) as error:
        demonstrate(finished["ppo"], 2, name="HC0_s3")
    advised = cli.parser().parse_args(str(error.value).partition("with silem ")[2].split())
    assert (advised.name, advised.trajectories, advised.force) == ("HC0_s3", 2, True)
    manifest = path.with_name(demonstrations.MANIFEST)
    whole = manifest.read_text()
    manifest.unlink()  # as if killed between the two writes
    (path.parent / ".HC0.npz.1.tmp").touch()
    demonstrate(finished["ppo"], 1)
    assert manifest.read_text() == whole
    assert not list(path.parent.glob(".*.tmp"))
    with pytest.raises(SilemError, match="no expert's run"):
        demonstrate(finished["silem"], 1)


def test_a_diverged_training_does_not_replace_its_checkpoint(tmp_path: Path) -> None:
    path, config = tmp_path / CHECKPOINT, small("ppo")
    good = checkpoint(config, 2)
    good.save(path)
    bad = dataclasses.replace(checkpoint(config, 4), model={"policy/w": np.full(3, np.nan)})
    with pytest.raises(SilemError, match=r"diverged before iteration 4: policy/w"):
        bad.save(path)
    assert Checkpoint.load(path, config, "").iteration == 2


def test_a_published_curve_averages_neighbouring_iterations() -> None:
    stats = [{"return_mean": float(i)} if i % 4 == 0 else {} for i in range(1, 402)]
    rows = np.array([curve_row(i + 1, 10 * (i + 1), s) for i, s in enumerate(stats)])
    thin = thinned(rows)
    assert len(thin) == 134  # blocks of three
    np.testing.assert_array_equal(thin[:3, 0], [3, 6, 9])
    returns = thin[:, CURVE_COLUMNS.index("return_mean")]
    np.testing.assert_array_equal(returns[:4], [np.nan, 4, 8, 12])
    assert curve_csv(rows[:1]).splitlines()[1] == "1,10,,,,,,,,"
    assert curve_csv(np.full((1, 12), 123456.789)).splitlines()[1].endswith(",1.2346e+05")


def test_a_record_that_is_none_is_refused(tmp_path: Path, finished: dict[str, RunRecord]) -> None:
    content = json.loads((finished["ppo"].folder / RECORD).read_text())
    older = {key: value for key, value in content.items() if key != "processor_time_s"}
    (tmp_path / RECORD).write_text(json.dumps(older))
    record = RunRecord.load(tmp_path)
    record.save(tmp_path)
    assert json.loads((tmp_path / RECORD).read_text()) == older
    for bad in ({"run_id": "x"}, [], content | {"files": []}, content | {"extra": 1}):
        (tmp_path / RECORD).write_text(json.dumps(bad))
        with pytest.raises(SilemError, match="is no run record"):
            RunRecord.load(tmp_path)


def test_leftovers_of_a_killed_run_go_with_the_next_call(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = small("random", name="book")
    monkeypatch.setitem(settings.BUDGETS, "book", config.budget)
    folders = (runs.run_folder(config), paths.results_dir(config.study) / config.run_id)
    for folder in folders:
        folder.mkdir(parents=True)
        (folder / ".curve.csv.123.tmp").touch()
    runs.run(config, progress=False)
    assert [os.listdir(folder) for folder in folders] == [[runs.LOCK], [RECORD]]


def test_what_can_be_no_runs_name_is_refused(data: Path) -> None:
    runs.run(small("random"), progress=False)  # which "*" would find
    impossible: list[Any] = ["*", "../*", "", ".", "a/b", "x" * 300, "x\0", None, 5]
    for run_id in impossible:
        with pytest.raises(SilemError, match="run id must be a name"):
            runs.find(run_id)


def test_unclipped_actions_reach_the_environment_as_they_are() -> None:
    config = RunConfig.create("HC0", "ppo", budget="tiny", clip_actions=False)
    env = training.make_env(config)
    try:
        model = training.make_model(config, env, None)
        actions = np.full((2, 6), 7.0, np.float32)
        np.testing.assert_array_equal(model._env_actions(actions), actions)
    finally:
        env.close()


def test_a_run_leaves_no_simulator_behind(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python counts objects, not what they hold: a loop of runs would keep their simulators."""
    made = []
    make_model = training.make_model

    def watched(*given: Any) -> Any:
        made.append(weakref.ref(model := make_model(*given)))
        return model

    monkeypatch.setattr(training, "make_model", watched)
    gc.disable()
    try:
        budget = Budget("small", 2, 128, 1, 1, 1, 2)
        runs.run(RunConfig.create("Humanoid", "ppo", budget=budget, **SMALL), progress=False)
        assert [model() for model in made] == [None]
    finally:
        gc.enable()
