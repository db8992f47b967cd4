from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from silem import bodies
from silem.__main__ import main
from silem.study import runs
from silem.study.config import RunConfig
from silem.study.settings import BUDGETS
from silem.util import files, paths


@pytest.fixture(autouse=True)
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("run --body HC9 --method ppo", "unknown body 'HC9'; allowed: HC0"),
        ("run --body HC0", "needs --body and --method"),
        ("run --body HC0 --method ppo --budget big", "unknown budget 'big'; allowed: tiny"),
        ("run --body HC0 --method ppo --set gamma", "NAME=VALUE"),
        ("run --body HC0 --method ppo --set gamma=high", "must be a number"),
        ("run --body HC0 --method ppo --set gama=0.9", "unknown hyper-parameter of ppo 'gama'"),
        ("run --body HC0 --method silem --quiet", "python -m silem demonstrations --body HC0"),
        ("run --config nowhere.json", "cannot read nowhere.json"),
        ("campaign --trials 9", "trials of halfcheetah must be 1 to 5"),
        ("campaign --workers 0 --method random", "workers must be 1 or more"),
        ("campaign --method silem --budget tiny", "needs demonstrations of HC0"),
        ("campaign --body HC9", "unknown body 'HC9'"),
        ("status --study chess", "unknown study 'chess'"),
        ("evaluate ppo_HC0", "no finished run 'ppo_HC0'"),
        ("render ppo_HC0 --out x.mp4", "no finished run"),
        ("demonstrations", "needs either --body or --run"),
        (
            "demonstrations --body HC0 --budget tiny",
            "are not finished; next: python -m silem run --body HC0",
        ),
    ],
)
def test_a_bad_request_is_one_line_and_exit_code_2(
    words: str, message: str, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words.split()) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("silem: ")
    assert captured.err.count("\n") == 1
    assert message in captured.err
    assert captured.out == ""
    left = [path for path in data.rglob("*") if path.is_file() and path.name != runs.LOCK]
    assert left == []


def test_run_evaluate_and_status(capsys: pytest.CaptureFixture[str]) -> None:
    command = "run --quiet --body HC1 --method random --budget tiny".split()
    assert main(command) == 0
    first = capsys.readouterr().out
    config = RunConfig.create("HC1", "random")
    assert first.startswith(f"{config.run_id}: return -")
    assert main(command) == 0
    assert capsys.readouterr().out == first
    assert main(["evaluate", config.run_id, "--episodes", "2"]) == 0
    assert capsys.readouterr().out == first
    assert main(["status", "--budget", "tiny"]) == 0
    table = capsys.readouterr().out.splitlines()
    assert [line for line in table if "finished" in line] == [
        line for line in table if line.startswith("random HC1")
    ]
    assert sum("missing" in line for line in table) == 15


def test_bodies_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bodies"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == bodies.names()


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_stopping_keeps_the_checkpoint_and_exits_with_130(sent: signal.Signals) -> None:
    config = RunConfig.create("HC0", "ppo", budget=BUDGETS["tiny"].with_iterations(5000))
    process = subprocess.Popen(
        [sys.executable, *config.command.split()[1:]],
        cwd=paths.REPO, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    checkpoint = runs.run_folder(config) / "checkpoint.safetensors"
    while process.poll() is None and not checkpoint.exists():
        time.sleep(0.05)
    process.send_signal(sent)
    try:
        _, errors = process.communicate(timeout=60)
    finally:  # a run deaf to Ctrl-C must not train on behind the failed test
        process.kill()
    assert process.returncode == 130
    assert f"its checkpoint is kept); to go on: {config.command}" in errors
    assert "Traceback" not in errors
    assert runs.state(config) == "part"
    files.read_tensors(checkpoint)
    assert not [name for name in os.listdir(checkpoint.parent) if name.endswith(".tmp")]
