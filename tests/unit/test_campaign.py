from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from silem.motion import demonstrations
from silem.study import campaign, runs
from silem.study.config import RunConfig
from silem.study.settings import BUDGETS
from silem.study.studies import cells, study_configs
from silem.util import files, paths
from silem.util.errors import SilemError

TINY = BUDGETS["tiny"]


@pytest.fixture(autouse=True)
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    return tmp_path


def test_the_studys_cells_are_those_of_figure_2b_and_table_1() -> None:
    found = [(cell.method, cell.body, cell.demonstrations) for cell in cells("halfcheetah")]
    assert len(found) == len(set(found)) == 16
    assert found.count(("silem-minus-own", "HC2", "HC2")) == 1
    assert found.count(("silem-minus", "HC2", "HC0")) == 1
    assert [row for row in found if row[0] == "silem-mlp"] == [("silem-mlp", "HC0", "HC0")]


def test_the_first_trial_of_every_cell_comes_before_any_second() -> None:
    configs = study_configs("halfcheetah", "book", 2)
    assert [config.seed for config in configs] == [0] * 16 + [1] * 16
    assert len({config.run_id for config in configs}) == 32
    assert len(study_configs("halfcheetah", "book")) == 80
    only = study_configs("halfcheetah", "tiny", 1, body=["HC1"], method=["ppo", "silem"])
    assert [(config.method, config.body) for config in only] == [("ppo", "HC1"), ("silem", "HC1")]


def publish(content: bytes) -> None:
    """Write a file of HC0's demonstrations, and a manifest that describes it."""
    path = demonstrations.file_of("HC0")
    files.write_bytes(path, content)
    files.write_json(
        path.with_name(demonstrations.MANIFEST), {"HC0": {"sha256": files.sha256(path)}}
    )


def test_imitators_wait_for_their_experts_demonstrations(data: Path) -> None:
    expert, imitator, other = study_configs(
        "halfcheetah", TINY, 1, body=["HC0"], method=["ppo", "silem", "random"]
    )
    tasks = {task.name: task for task in campaign.plan([imitator, other, expert])}
    recording = tasks["demonstrations HC0"]
    assert tasks[imitator.run_id].needs == {recording.name}
    assert recording.needs == {expert.run_id}
    assert tasks[other.run_id].needs == tasks[expert.run_id].needs == set()
    publish(b"")
    tasks = {task.name: task for task in campaign.plan([imitator, other, expert])}
    assert "demonstrations HC0" not in tasks
    assert tasks[imitator.run_id].needs == set()


def test_an_imitator_without_an_expert_is_refused_before_anything_starts(data: Path) -> None:
    with pytest.raises(SilemError, match=r"needs demonstrations of HC0.*--method ppo"):
        campaign.campaign(study_configs("halfcheetah", TINY, 1, method=["random", "silem"]))
    assert list(data.iterdir()) == []


def killing_popen(monkeypatch: pytest.MonkeyPatch, when: Path) -> list[int]:
    """Kill -9 the first worker as soon as a file exists; return the workers' exit codes."""
    started: list[Any] = []

    class Popen(subprocess.Popen):  # type: ignore[type-arg]
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            started.append(self)
            if len(started) == 1:
                threading.Thread(target=self._kill, daemon=True).start()

        def _kill(self) -> None:
            while not when.exists():
                time.sleep(0.01)
            os.kill(self.pid, signal.SIGKILL)

    monkeypatch.setattr(campaign.subprocess, "Popen", Popen)
    return started


def test_a_killed_worker_goes_on_and_a_second_campaign_has_nothing_to_do(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    config = RunConfig.create("HC0", "ppo", budget=TINY.with_iterations(30))
    checkpoint = runs.run_folder(config) / "checkpoint.safetensors"
    started = killing_popen(monkeypatch, checkpoint)
    records = campaign.campaign([config], n_workers=1, progress=False)
    assert [record.run_id for record in records] == [config.run_id]
    assert [process.returncode for process in started] == [-signal.SIGKILL, 0]
    assert campaign.campaign([config], n_workers=1, progress=False) == records
    assert len(started) == 2


def test_a_worker_fails_that_is_killed_again_and_again_without_getting_on(
    monkeypatch: pytest.MonkeyPatch, data: Path
) -> None:
    """What is killed by a signal starts anew; only a checkpoint that advances starts the count."""
    config, started = RunConfig.create("HC0", "ppo"), []
    checkpoint = runs.run_folder(config) / "checkpoint.safetensors"

    class Killed:
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            started.append(self)

        def poll(self) -> int:
            if len(started) <= 20:
                checkpoint.write_bytes(b"")
                os.utime(checkpoint, ns=(len(started), len(started)))
            return -signal.SIGKILL

    monkeypatch.setattr(campaign, "_POLL_S", 0)
    monkeypatch.setattr(campaign.subprocess, "Popen", Killed)
    with pytest.raises(SilemError, match=f"killed {campaign.MAX_KILLS} times without getting on"):
        campaign.campaign([config], n_workers=1, progress=False)
    assert len(started) == 20 + campaign.MAX_KILLS


def test_a_failure_is_reported_after_all_others_were_made(data: Path) -> None:
    publish(b"no npz")
    bad, good = study_configs("halfcheetah", TINY, 1, body=["HC0"], method=["silem", "random"])
    with pytest.raises(SilemError, match=rf"{bad.run_id} failed: silem: .*HC0\.npz"):
        campaign.campaign([bad, good], n_workers=1, progress=False)
    assert runs.state(good) == "finished"


def started_campaign(data: Path) -> subprocess.Popen[str]:
    """Start a campaign and wait until two of its workers are in training."""
    words = "campaign --method ppo --budget tiny --iterations 5000 --workers 2 --quiet"
    process = subprocess.Popen(
        [sys.executable, "-m", "silem", *words.split()],
        cwd=paths.REPO, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while process.poll() is None and len(list(data.rglob("checkpoint.safetensors"))) < 2:
        time.sleep(0.05)
    return process


def test_ctrl_c_stops_every_worker(data: Path) -> None:
    process = started_campaign(data)
    process.send_signal(signal.SIGINT)
    try:
        _, errors = process.communicate(timeout=60)
    finally:  # a campaign deaf to Ctrl-C must not train on behind the failed test
        process.terminate()
        process.wait(timeout=60)
    assert process.returncode == 130
    assert "the same command goes on" in errors
    assert "Traceback" not in errors
    assert not any(files.is_locked(path) for path in data.rglob(runs.LOCK))


def test_the_workers_of_a_killed_campaign_end_with_it(data: Path) -> None:
    process = started_campaign(data)
    locks = list(data.rglob(runs.LOCK))
    workers = [int(path.read_text().partition("@")[0]) for path in locks]
    assert len(workers) == 2
    process.kill()
    process.wait()
    deadline = time.monotonic() + 60
    try:
        while any(files.is_locked(path) for path in locks) and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not any(files.is_locked(path) for path in locks)
    finally:
        for path, pid in zip(locks, workers, strict=True):
            if files.is_locked(path):
                os.kill(pid, signal.SIGKILL)
    for path in locks:  # they were stopped, not cut off
        assert "its checkpoint is kept" in (path.parent / "log.txt").read_text()
