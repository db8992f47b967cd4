from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import signal
import socket
import subprocess
import sys
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic_records as synthetic

from silem import cli, paper
from silem.cli import main
from silem.motion import demonstrations
from silem.report import results
from silem.report.pages.open_settings import travel_allowed
from silem.study import evaluate as recording
from silem.study import runs, work
from silem.study.config import RunConfig
from silem.study.evaluate import RandomPolicy, evaluate
from silem.study.runs import CHECKPOINT, PROGRESS, RECORD
from silem.study.settings import BUDGETS
from silem.study.studies import (
    SEARCH_SEEDS,
    SLOPES_DEG,
    STUDIES,
    TORSOS,
    TRIAL_SEEDS,
    Study,
    cells,
    experts,
    fresh_configs,
    ranking,
    study_configs,
)
from silem.util import files, paths
from silem.util.errors import SilemError

TINY = BUDGETS["tiny"]
HC0 = {"body": ["HC0"]}


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


def test_the_ant_studys_cells_are_those_of_figure_2d() -> None:
    configs = study_configs("ant", "book")
    assert len(configs) == 35 * 5
    for config in configs:
        assert config.budget.n_iterations == paper.number("ant_expert_iterations") == 1000
        own = config.method == "silem-minus-own"
        if config.method not in ("ppo", "random"):
            assert config.demonstrations == (config.body if own else "Ant0")
            best = paper.best_combination(config.body, config.method, config.demonstrations)[0]
            assert {name: getattr(config.hyper, name) for name in best} == best
    small = study_configs("ant-absorbing", "book", 1)
    assert {(c.method, c.body) for c in small} == {
        (m, b) for m in ("silem", "silem-minus") for b in ("Ant0", "Ant6")
    }
    plain = {config.run_id for config in configs}
    assert all(c.hyper.absorbing_states and c.run_id not in plain for c in small)


def test_a_ladder_has_experts_of_its_own_and_one_combination() -> None:
    configs = study_configs("ladder", "book")
    assert len(configs) == (8 * 5 + 1) * 2
    for body in TORSOS:
        own = [c for c in configs if c.body == body and c.method == "ppo"]
        assert experts(body, "book") == own and {c.seed for c in own} == {0, 1}
        assert [c.run_id for c in experts(body, "book", 1)] == [own[1].run_id]
        needs = next(c for c in configs if c.demonstrations == body)
        assert work.experts_of(needs) == own
    assert {c.study for c in experts("HC2", "book")} == {"halfcheetah"}
    assert {c.study for c in experts("HC0-slope-5", "book")} == {"halfcheetah"}
    # the paper has other combinations for HC1 and HC2, which are as long as two of these
    hyper = {c.hyper for c in study_configs("halfcheetah", "book") if c.method == "silem"}
    ladder = {c.hyper for c in configs if c.method == "silem"}
    assert len(ladder) == 1 and ladder < hyper and len(hyper) > 1


def test_what_goes_beyond_the_paper_repeats_none_of_its_runs() -> None:
    beyond = ("ladder", "ladder-ant", "slope", "slope-humanoid", "ensembles", "arm-lengths")
    papers = {
        (c.method, c.body, c.hyper)
        for study in ("halfcheetah", "ant", "humanoids")
        for c in study_configs(study, "book", 1)
    }
    for study in beyond:
        found = [(c.method, c.body, c.hyper) for c in study_configs(study, "book", 1)]
        flat = {cell for cell in found if study == "slope" and cell[1] in ("HC0", "Ant0")}
        assert not papers & {*found} - flat and len({*found}) == len(found)
    slopes = study_configs("slope", "book", 1, method=["silem"])
    reach = [travel_allowed(c.hyper, c.budget.n_iterations) for c in slopes]
    assert min(reach) > math.radians(max(SLOPES_DEG))  # T can make up for the steepest
    counts = [c.hyper.transform_components for c in study_configs("ensembles", "book", 1)]
    assert counts == [2, 4, 8] * 3


def test_the_first_trial_of_every_cell_comes_before_any_second() -> None:
    configs = study_configs("halfcheetah", "book", 2)
    assert [config.seed for config in configs] == [0] * 16 + [1] * 16
    assert len({config.run_id for config in configs}) == 32
    assert len(study_configs("halfcheetah", "book")) == 80
    only = study_configs("halfcheetah", "tiny", 1, body=["HC1"], method=["ppo", "silem"])
    assert [(config.method, config.body) for config in only] == [("ppo", "HC1"), ("silem", "HC1")]


def test_a_search_runs_the_supplements_grid_its_best_first() -> None:
    whole = study_configs("halfcheetah/HC2/silem", "quick", 1)
    grid = paper.grid_values("tab4")
    assert len({c.run_id for c in whole}) == math.prod(len(values) for values in grid.values())
    best = paper.best_combination("HC2", "silem", "HC0")[0]
    assert {name: getattr(whole[0].hyper, name) for name in best} == best
    sample = study_configs("halfcheetah/HC2/silem", "quick", 2, 24)
    assert sample[:24] == whole[:24]
    assert [c.seed for c in sample] == [100] * 24 + [101] * 24
    assert not {*SEARCH_SEEDS} & {*TRIAL_SEEDS}
    # a fair sample: both values of each symbol, not one corner of the grid
    assert {c.hyper.n_epochs for c in sample[:8]} == {5, 10}
    assert {c.hyper.n_trajectories for c in sample[:8]} == {10, 20}
    for none in ("halfcheetah/HC0/ppo", "humanoids/Atlas/random"):
        with pytest.raises(SilemError, match="unknown search in ") as error:
            study_configs(none, "quick")
        told = str(error.value).partition("allowed: ")[2]
        for cell in told.split(", "):  # each has a grid
            assert study_configs(f"{none.partition('/')[0]}/{cell}", "quick", 1, 1)
    with pytest.raises(SilemError, match="unknown search in halfcheetah 'HC9/silem'"):
        study_configs("halfcheetah/HC9/silem", "quick")


def test_a_search_is_ranked_by_the_mean_over_its_trials() -> None:
    search = "halfcheetah/HC2/silem-minus"
    configs = study_configs(search, "quick", 2, 4)
    returns = [100, 500, 300, 900, 700, 200, 300]  # the fourth has one trial
    for config, value in zip(configs, returns, strict=False):
        synthetic.write_record(config, value)
    found = ranking(search, "quick", 2)
    means = [np.mean(np.round(entry.returns, -2)) for entry in found]
    assert means == [400, 350, 300]
    assert [entry.is_papers for entry in found] == [True, False, False]
    assert [entry.score for entry in found] == sorted([e.score for e in found], reverse=True)


def test_a_searchs_winner_is_run_again_on_seeds_that_have_not_chosen_it() -> None:
    search, budget = "halfcheetah/HC2/silem-minus", "quick"
    configs = study_configs(search, budget, 2, 3)
    for config, value in zip(configs, [100, 500, 300, 900, 700, 200], strict=True):
        with pytest.raises(SilemError, match=r"the winner of .* is not known yet: "):
            fresh_configs(search, budget, 2, 3)
        synthetic.write_record(config, value)
    fresh = fresh_configs(search, budget, 2, 3)  # the second has the highest mean
    assert [c.seed for c in fresh] == [102, 102, 103, 103, 104, 104]
    assert {c.hyper for c in fresh} == {configs[0].hyper, configs[1].hyper}
    assert not {c.run_id for c in fresh} & {c.run_id for c in configs}
    for config in fresh:
        synthetic.write_record(config, 0 if config.hyper == configs[1].hyper else 400)
    winner, supplements, _ = ranking(search, budget, 2, 3)
    assert [round(value, -2) for value in (*winner.returns, *winner.fresh)] == [500, 700, 0, 0, 0]
    assert supplements.is_papers and len(supplements.fresh) == 3
    with pytest.raises(SilemError, match="has no fresh seeds: its 5 trials have used all"):
        for config in study_configs(search, budget, 5, 1):
            synthetic.write_record(config, 1.0)
        fresh_configs(search, budget, 5, 1)
    everything = fresh_configs(search, budget, 2, 1)  # the winner is the supplement's
    assert len(everything) == 3


def test_a_searchs_records_are_published_and_no_other_of_a_small_budget() -> None:
    (searched,) = study_configs("ant/Ant3/silem", "quick", 1, 1)
    assert searched.is_published and RunConfig.create("HC0", "ppo", budget="book").is_published
    for config in (
        RunConfig.create("HC0", "ppo", budget="quick"),
        study_configs("ant/Ant3/silem", "tiny", 1, 1)[0],
    ):
        assert not config.is_published


def publish(content: bytes) -> None:
    """Write a file of HC0's demonstrations, and a manifest that describes it."""
    path = demonstrations.file_of("HC0")
    files.write_bytes(path, content)
    files.write_json(
        path.with_name(demonstrations.MANIFEST), {"HC0": {"sha256": files.sha256(path)}}
    )


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What loops make, at once and without any learning."""
    order: list[str] = []

    def run(config: RunConfig, *args: Any, **kwargs: Any) -> Any:
        order.append(config.run_id)
        return synthetic.write_record(config, 100.0, folder=runs.run_folder(config))

    def demonstrate(record: Any, **kwargs: Any) -> None:
        order.append(f"demonstrations of {record.run_id}")
        publish(b"")

    monkeypatch.setattr(work.runs, "run", run)
    monkeypatch.setattr(recording, "demonstrate", demonstrate)
    monkeypatch.setattr(work, "_POLL_S", 0.0)
    return order


def test_the_command_runs_the_winner_and_says_what_it_is_worth(
    made: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    publish(b"")
    words = "search halfcheetah/HC2/silem --budget tiny --sample 2 --trials 1 --quiet".split()
    assert main(words) == 0 and len(made) == 2
    assert "fresh seeds" not in capsys.readouterr().out
    assert main([*words, "--winner"]) == 0
    assert len(made) in (2 + 4, 2 + 8)  # the winner and the supplement's best may be the same
    assert "(on fresh seeds: " in capsys.readouterr().out


def test_a_searchs_run_is_published_with_the_length_of_its_episodes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(BUDGETS, "quick", dataclasses.replace(BUDGETS["quick"], n_eval_episodes=1))
    budget = BUDGETS["quick"].with_iterations(1)
    for study, n in (("search-x", 1), ("x", 0)):
        record = runs.run(RunConfig.create("Ant0", "random", None, budget, study=study), False)
        assert len(list(paths.results_dir(study).glob(f"*/{RECORD}"))) == n
        assert 1 <= record.evaluation["steps_mean"] <= 1000
    short = evaluate(RandomPolicy("Ant0"), "Ant0", 3, max_steps=20)
    assert short.steps_mean == 20


def test_imitators_wait_for_every_expert_that_the_rule_chooses_from(made: list[str]) -> None:
    expert, imitator, other = study_configs(
        "halfcheetah", TINY, 1, body=["HC0"], method=["ppo", "silem", "random"]
    )
    work.work([imitator, other, expert])
    ids = [other.run_id, expert.run_id, f"demonstrations of {expert.run_id}", imitator.run_id]
    assert made == ids
    work.work([other, expert])
    assert made == ids


def test_a_loop_leaves_alone_what_others_are_at_and_ends(made: list[str]) -> None:
    expert, imitator, other = study_configs(
        "halfcheetah", TINY, 1, body=["HC0"], method=["ppo", "silem", "random"]
    )
    publish(b"")
    with files.lock(runs.run_folder(imitator) / runs.LOCK):
        work.work([imitator, other, expert])
    assert made == [other.run_id, expert.run_id]


def test_an_imitator_without_an_expert_is_refused_before_anything_starts(data: Path) -> None:
    with pytest.raises(SilemError, match=r"needs demonstrations of HC0.*--method ppo"):
        work.work(study_configs("halfcheetah", TINY, 1, method=["random", "silem"]))
    assert list(data.iterdir()) == []


@pytest.mark.parametrize(
    ("study", "budget", "commands"),
    [
        ("halfcheetah", "book", 1),
        ("slope", "book", 2),  # of HC0 and of Ant0, whose experts are two studies'
        ("ensembles", "quick", 2),
        ("demonstrators", "quick", 1),  # of all five trials, where the budget has one
    ],
)
def test_a_command_is_named_that_makes_a_studys_experts_who_are_not_asked_for(
    study: str, budget: str, commands: int, data: Path
) -> None:
    configs = study_configs(study, budget, 1)
    for _ in range(commands):
        with pytest.raises(SilemError, match="neither finished nor asked for; first:") as error:
            work.check(configs)
        advised = cli.parser().parse_args(str(error.value).partition("first: silem ")[2].split())
        configs = [*cli._configs(advised), *configs]
    work.check(configs)


def test_no_run_is_started_that_cannot_reach_its_next_checkpoint(made: list[str]) -> None:
    configs = study_configs("halfcheetah", TINY, 1, method=["ppo"])
    with pytest.raises(KeyboardInterrupt, match=r"time is up: 3 of 3 runs are left; the same"):
        work.work(configs, minutes=-1)
    for config in configs[:2]:  # an hour for half a run
        said = {"iteration": 2, "return": 1.0, "wall_time_s": 3600.0}
        files.write_json(runs.run_folder(config) / PROGRESS, said)
    with pytest.raises(KeyboardInterrupt, match="3 of 3 runs are left"):
        work.work(configs, minutes=59)
    assert made == []
    work.work(configs, minutes=61)
    assert len(made) == 3


def test_time_is_up_at_a_checkpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    config = RunConfig.create("HC0", "ppo", budget=TINY.with_iterations(5000))
    with pytest.raises(KeyboardInterrupt, match=r"time is up: stopped ppo_HC0.*is kept.*the same"):
        work.work([config], minutes=0.02, progress=False)
    said = work.progress_of(config)["iteration"]
    assert said > 0
    assert said % 2 == 0
    _, about = files.read_tensors(runs.run_folder(config) / CHECKPOINT)
    assert int(about["iteration"]) == said  # nothing that was done is lost


def killed(folder: Path) -> None:
    """Begin a run and be killed."""
    if not (child := os.fork()):
        with runs._attempt(folder):
            os._exit(9)
    os.waitpid(child, 0)


def test_a_run_fails_that_is_killed_again_and_again_without_getting_on() -> None:
    """Only a checkpoint that advances starts the count anew; asked for again it has all tries."""
    config, other = study_configs("halfcheetah", TINY, 1, body=["HC0", "HC1"], method=["random"])
    folder = runs.run_folder(config)
    for i in range(3 * runs.STARTS):
        files.write_bytes(folder / CHECKPOINT, b"")
        os.utime(folder / CHECKPOINT, ns=(i, i))
        killed(folder)
    (folder / CHECKPOINT).unlink()
    for _ in range(runs.STARTS):
        killed(folder)
    for _ in range(2):  # the second loop leaves it alone
        with pytest.raises(SilemError, match=rf"{config.run_id} failed: it was killed 5 times"):
            work.work([config, other], progress=False)
        assert (runs.state(config), runs.state(other)) == ("failed", "finished")
    runs.forgive(config)
    work.work([config, other], progress=False)
    assert runs.state(config) == "finished"


def test_a_run_that_is_asked_for_by_itself_goes_on_however_often_it_was_killed() -> None:
    config = RunConfig.create("HC0", "random")
    for _ in range(2 * runs.STARTS):
        killed(runs.run_folder(config))
    assert runs.run(config, progress=False).run_id == config.run_id


def test_a_failure_is_reported_after_all_others_were_made(
    data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    publish(b"no npz")
    bad, good = study_configs("halfcheetah", TINY, 1, body=["HC0"], method=["silem", "random"])
    with pytest.raises(SilemError, match=rf"{bad.run_id} failed: .*HC0\.npz"):
        work.work([bad, good], progress=False)
    assert runs.state(good) == "finished"
    assert runs.state(bad) == "failed"
    assert main("status halfcheetah --budget tiny".split()) == 0
    told = capsys.readouterr().out
    assert "silem HC0 from HC0            failed\n" in told
    assert f"failed: {bad.run_id}: " in told
    assert "HC0.npz" in told.splitlines()[-2]


def test_what_needs_a_failed_expert_is_left_and_nothing_waits_forever(made: list[str]) -> None:
    expert, imitator = study_configs("halfcheetah", TINY, 1, **HC0, method=["ppo", "silem"])
    runs.fail(expert, "diverged")
    with pytest.raises(SilemError, match=f"^{expert.run_id} failed: diverged"):
        work.work([expert, imitator])
    assert made == [] and runs.state(imitator) == "missing"
    runs.forgive(expert)  # which is enough for both
    work.work([expert, imitator])
    assert made[0] == expert.run_id and made[-1] == imitator.run_id


def test_a_machine_on_which_run_after_run_fails_is_left_before_all_have(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(*args: Any, **kwargs: Any) -> None:
        raise ImportError("libtorch.so: no such file")

    monkeypatch.setattr(work.runs, "run", fail)
    configs = study_configs("halfcheetah", TINY, 3, method=["ppo"])
    with pytest.raises(SilemError, match=r"5 runs in a row .*its own fault: libtorch.*--retry"):
        work.work(configs)
    assert [runs.state(config) for config in configs] == ["failed"] * 5 + ["missing"] * 4
    assert f"(on {socket.gethostname()})" in work.failed(configs)[configs[0].run_id]


def test_what_is_finished_has_not_failed(made: list[str]) -> None:
    """A loop that lost a race may have left its note."""
    (config,) = study_configs("halfcheetah", TINY, 1, **HC0, method=["ppo"])
    work.work([config])
    runs.fail(config, "too late")
    work.work([config])
    assert work.failed([config]) == {}


def test_a_loop_that_waits_looks_ever_more_seldom(
    made: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    expert, imitator = study_configs("halfcheetah", TINY, 1, **HC0, method=["ppo", "silem"])
    waits: list[float] = []

    def sleep(seconds: float) -> None:
        waits.append(seconds)
        if len(waits) == 7:
            publish(b"")

    monkeypatch.setattr(work, "_POLL_S", 1.0)
    monkeypatch.setattr(work.time, "sleep", sleep)
    with files.lock(runs.run_folder(expert) / runs.LOCK):
        work.work([imitator, expert])
    assert waits[:7] == [2.0, 4.0, 8.0, 16.0, 30.0, 30.0, 30.0] and made == [imitator.run_id]


def test_status_tells_who_works_where_and_how_long_the_rest_takes() -> None:
    configs = study_configs("halfcheetah", "book", 1, method=["ppo"])
    synthetic.write_record(configs[0], 2000.0)  # 420 s
    said = {"iteration": 200, "return": 512.4, "wall_time_s": 105.0}
    files.write_json(runs.run_folder(configs[1]) / PROGRESS, said)
    with files.lock(runs.run_folder(configs[1]) / runs.LOCK):
        told = work.status("halfcheetah", BUDGETS["book"], 1).splitlines()
    assert told[2:5] == [
        "ppo HC0                       finished",
        "ppo HC1                       running",
        "ppo HC2                       missing",
    ]
    (line,) = [line for line in told if line.startswith("at work: ")]
    assert f"{configs[1].run_id} 200/800, return 512 ({os.getpid()}@" in line
    # 420 s for each of 12 that are missing and learn, and what the one at work still needs
    assert told[-1] == "left: 15 of 16 runs, 1.4 hours for one worker at the speed measured"


def test_a_study_without_cells_has_nothing_to_do(
    made: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As long as what its cells are is not decided."""
    monkeypatch.setitem(STUDIES, "open", Study((), TRIAL_SEEDS, "to be decided"))
    assert main(["status", "open"]) == 0
    assert "left: 0 of 0 runs" in capsys.readouterr().out
    assert main(["work", "open", "--quiet"]) == 0 and made == []
    assert main(["submit", "open", "--on", "slurm", "--print"]) == 0
    for request in ("search open/HC0/silem", "work open --body HC0"):
        assert main(request.split()) == 2
        assert "allowed: none" in capsys.readouterr().err
    frame = results.load_records("open", "tiny")
    assert len(frame) == 0 and "0 runs" in results.trace(frame).data


def test_locks_that_do_not_hold_are_told(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files.check_locks(data)
    monkeypatch.setattr(files, "_lock_now", lambda *_: True)
    with pytest.raises(SilemError, match=r"does not honour locks.*set SILEM_DATA_DIR to one that"):
        work.work(study_configs("halfcheetah", TINY, 1, method=["random"]))


WORK = [sys.executable, "-m", "silem", "work", "halfcheetah", "--budget", "tiny", "--quiet"]


def workers() -> dict[Path, int]:
    """Return who is at work, by the run's folder."""
    locks = [path for path in paths.runs_dir().rglob(runs.LOCK) if files.is_locked(path)]
    return {path.parent: int(files.holder(path).partition("@")[0]) for path in locks}


def started(data: Path, *words: str, n: int = 2) -> subprocess.Popen[str]:
    """Start two loops and wait until so many runs have a checkpoint."""
    process = subprocess.Popen(
        [*WORK, "--method", "ppo", "--workers", "2", *words],
        cwd=paths.REPO, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while process.poll() is None and len(list(data.rglob(CHECKPOINT))) < n:
        time.sleep(0.05)
    return process


def test_a_killed_worker_goes_on_and_there_is_nothing_to_do_then(data: Path) -> None:
    process = started(data, "--iterations", "30", "--body", "HC0", n=1)
    victims = workers()
    for pid in victims.values():
        os.kill(pid, signal.SIGKILL)
    _, errors = process.communicate(timeout=120)
    assert (process.returncode, errors, len(victims)) == (0, "", 1)
    (record,) = data.rglob(RECORD)
    before = record.stat().st_mtime_ns
    assert main([*WORK[3:], "--method", "ppo", "--iterations", "30", "--body", "HC0"]) == 0
    assert record.stat().st_mtime_ns == before


def test_a_worker_that_was_killed_has_the_time_that_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It was started again with the whole of it, and a job's worker outlived its job."""
    now, asked = 0.0, []

    class Loop:
        """Killed at once, twice."""

        def __init__(self, command: list[str], **kwargs: Any) -> None:
            asked.append(int(command[command.index("--minutes") + 1]))
            self.returncode = -signal.SIGKILL if len(asked) < 3 else work.STOPPED

        def poll(self) -> int:
            return self.returncode

        wait = terminate = poll

    def sleep(seconds: float) -> None:
        nonlocal now
        now += 1490.0

    monkeypatch.setattr(work.subprocess, "Popen", Loop)
    monkeypatch.setattr(work.time, "monotonic", lambda: now)
    monkeypatch.setattr(work.time, "sleep", sleep)
    words = "work halfcheetah --method random --budget tiny --workers 1 --minutes 60 --quiet"
    assert main(words.split()) == work.STOPPED
    assert asked == [60, 60, 36]  # the first is started again before any time has passed


def test_ctrl_c_stops_every_worker(data: Path) -> None:
    process = started(data, "--iterations", "5000")
    process.send_signal(signal.SIGINT)
    try:
        _, errors = process.communicate(timeout=60)
    finally:  # loops deaf to Ctrl-C must not train on behind the failed test
        process.terminate()
        process.wait(timeout=60)
    assert process.returncode == 130
    assert "the same command goes on" in errors
    assert "Traceback" not in errors
    assert not workers()


def test_the_workers_of_a_killed_crew_end_with_it(data: Path) -> None:
    process = started(data, "--iterations", "5000")
    at_work = workers()
    assert len(at_work) == 2
    process.kill()
    process.communicate()
    deadline = time.monotonic() + 60
    try:
        while workers() and time.monotonic() < deadline:
            time.sleep(0.05)
        assert not workers()
    finally:
        for pid in workers().values():
            os.kill(pid, signal.SIGKILL)
    # they were stopped, not cut off
    assert (paths.runs_dir() / "work.log").read_text().count("its checkpoint is kept") == 2
    assert not list(data.rglob(runs.ATTEMPT))


def content() -> dict[str, Any]:
    """What finished runs hold, by run, whoever made them and however often they were killed."""
    found: dict[str, Any] = {}
    for path in sorted(paths.runs_dir().rglob(RECORD)):
        record = files.read_json(path)
        arrays = files.read_tensors(path.parent / CHECKPOINT)[0] if record["files"] else {}
        state = {name: array.tobytes() for name, array in arrays.items()}
        found[record["run_id"]] = [record["evaluation"], record["files"], state]
    return found


def test_kills_of_a_crew_and_its_workers_change_no_bit(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The whole of it, fifty kills and more, is `python -m benchmarks.kills --work`."""
    words = [*WORK, "--body", "HC0", "HC1", "--method", "ppo", "random", "--iterations", "12"]
    for body, method in product(("HC0", "HC1"), ("ppo", "random")):  # each in its own process
        alone = ["run", "--body", body, "--method", method, *words[5:8], "--iterations", "12"]
        subprocess.run([*WORK[:3], *alone], cwd=paths.REPO, check=True, stdout=subprocess.DEVNULL)
    reference = content()
    assert len(reference) == 4
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path / "killed"))
    rng, kills = np.random.default_rng(), 0
    while True:
        process = subprocess.Popen([*words, "--workers", "2"], cwd=paths.REPO)
        while kills < 6 and process.poll() is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(rng.uniform(1.0, 4.0))
            victim = rng.choice([process.pid, *workers().values()])
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(victim), signal.SIGKILL)
                kills += 1
        if process.wait() == 0:
            break
        assert process.returncode == -signal.SIGKILL
    assert content() == reference
    assert not list(paths.runs_dir().rglob(runs.ATTEMPT))
