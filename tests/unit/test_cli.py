from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import silem
from silem import bodies, cli
from silem.cli import main, parser
from silem.report import film
from silem.study import runs
from silem.study.config import RunConfig
from silem.study.evaluate import load_policy
from silem.study.settings import BUDGETS
from silem.util import files, paths
from silem.util.errors import SilemError


@pytest.fixture(autouse=True)
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("run --body HC9 --method ppo", "unknown body 'HC9'; allowed: HC0"),
        ("run --body HC0", "--body and --method are needed"),
        ("run --body HC0 --method ppo --budget big", "unknown budget 'big'; allowed: tiny"),
        ("run --body HC0 --method ppo --budget=", "unknown budget ''; allowed: tiny"),
        ("run --body HC0 --method silem --demonstrations=", "--demonstrations needs a name"),
        ("run --body HC0 --method ppo --set gamma", "NAME=VALUE"),
        ("run --body HC0 --method ppo --set gamma=high", "must be a number"),
        ("run --body HC0 --method ppo --set gama=0.9", "unknown setting of ppo on HC0 'gama'"),
        ("run --body HC0 --method silem --quiet", "silem demonstrations --body HC0"),
        ("work halfcheetah --trials 9", "trials of halfcheetah must be 1 to 5"),
        ("work halfcheetah --workers 0 --method random", "'0' is no whole number from 1"),
        ("work halfcheetah --method silem --budget tiny", "needs demonstrations of HC0"),
        ("work", "arguments are required: STUDY"),
        ("work chess", "unknown study 'chess'"),
        ("work ant --minutes 0", "--minutes: '0' is no whole number from 1"),
        ("work ant --method silem --budget tiny", "needs demonstrations of Ant0"),
        ("work ant/Ant3/ppo", "unknown search in ant 'Ant3/ppo'; allowed: Ant0/silem, "),
        ("show ppo_HC0 --seed 99 --body HC2", "not both: --body, --seed"),
        ("search ant/Ant3/silem --winner --sample 4", "is not known yet: 0 of 4 configurations"),
        ("status ant/Ant3/silem/x", "unknown search in ant 'Ant3/silem/x'"),
        ("submit ant --on pbs --print", "unknown engine 'pbs'; allowed: slurm, htcondor, dask"),
        ("submit ant --on slurm --jobs 0", "--jobs: '0' is no whole number from 1"),
        ("submit ant --on slurm --options nowhere.toml", "cannot read nowhere.toml"),
        ("work halfcheetah --body HC9", "unknown body 'HC9'"),
        ("status chess", "unknown study 'chess'"),
        ("evaluate ppo_HC0", "no finished run 'ppo_HC0'"),
        ("render ppo_HC0 --out x.mp4", "no finished run"),
        ("demonstrations", "needs either --body or --run"),
        ("", "arguments are required: COMMAND (see `silem --help`)"),
        ("fly", "invalid choice: 'fly'"),
        ("run --body HC0 --method ppo --iterations 0", "'0' is no whole number from 1"),
        ("run --body HC0 --method ppo --iterations 1e3", "'1e3' is no whole number"),
        (f"run --body HC0 --method ppo --iterations {'9' * 400}", "999...' is no whole number"),
        ("run --body HC0 --method ppo --seed -1", "--seed: '-1' is no whole number from 0"),
        (f"run --body HC0 --method ppo --seed {2**31}", "to 2147483647"),
        ("run --body HC0 --method ppo --set body=", "setting of ppo on HC0 'body'; allowed: lea"),
        ("run --body HC0 --method ppo --set seed=3", "unknown setting of ppo on HC0 'seed'"),
        ("run --body HC0 --method ppo --set =3", "unknown setting of ppo on HC0 ''"),
        ("run --body HC0 --method ppo --set gamma=", "gamma: '' is no number"),
        (
            f"run --body HC0 --method ppo --set learning_rate={'9' * 400}",
            "above 0, not 99",
        ),
        (
            f"run --body HC0 --method ppo --set n_epochs={'9' * 400}",
            "from 1 to 1000000000, not 99",
        ),
        (f"run --body HC0 --method ppo --set n_epochs={'9' * 5000}", "999...' is no number"),
        (f"run --body HC0 --method ppo --set policy_hidden={'[' * 5000}", "[[[...' is no number"),
        ("evaluate ppo_HC0 --episodes 0", "'0' is no whole number from 1"),
        ("render ppo_HC0 --out x.xyz", "'x.xyz' is a folder, or ends in none of .mp4, .webp"),
        ("render ppo_HC0 --out x.mp4 --seconds 1e12", "'1e12' is no number of seconds above 0"),
        ("render ppo_HC0 --out x.mp4 --seconds nan", "'nan' is no number of seconds"),
        ("render ppo_HC0 --out x.mp4 --seed -1", "'-1' is no whole number from 0"),
        ("bodies --import no_such_module", "cannot import no_such_module: ModuleNotFoundError"),
        (
            "demonstrations --body HC0 --budget tiny",
            "are not finished; next: silem run --body HC0",
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
    evaluation, record = first.splitlines()
    assert evaluation.startswith(f"{config.run_id}: return -")
    assert files.read_json(Path(record))["run_id"] == config.run_id
    assert main(command) == 0
    assert capsys.readouterr().out == first
    assert main(["evaluate", config.run_id, "--episodes", "2", "--quiet"]) == 0
    again = capsys.readouterr()
    assert (again.out, again.err) == (f"{evaluation}\n", "")
    assert main(["status", "--budget", "tiny"]) == 0
    table = capsys.readouterr().out.splitlines()
    assert [line for line in table if "finished" in line] == [
        line for line in table if line.startswith("random HC1")
    ]
    assert sum("missing" in line for line in table) == 15


def test_an_environment_that_says_no_speed_is_run_and_printed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main("run --quiet --env Pendulum-v1 --method random --budget tiny".split()) == 0
    assert "over 2 episodes\n" in capsys.readouterr().out


def test_a_published_policy_is_exported_and_acts_alike(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main("run --quiet --body HC0 --method ppo --budget tiny".split()) == 0
    config, out = RunConfig.create("HC0", "ppo"), tmp_path / "policy.safetensors"
    assert main(["export", config.run_id, "--out", str(out)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(out)
    record = runs.find(config.run_id)
    assert record is not None
    observations = np.random.default_rng(0).standard_normal((5, 26)).astype(np.float32)
    exported, own = (
        policy.predict(observations, deterministic=True)[0]
        for policy in (silem.load_policy(out), load_policy(record))
    )
    np.testing.assert_array_equal(exported, own)
    assert main(["export", config.run_id, "--out", str(tmp_path / "policy.zip")]) == 2
    assert "exported as .safetensors" in capsys.readouterr().err
    assert main("run --quiet --body HC0 --method random --budget tiny".split()) == 0
    random = RunConfig.create("HC0", "random").run_id
    assert main(["export", random, "--out", str(tmp_path / "no.safetensors")]) == 2
    assert not (tmp_path / "no.safetensors").exists()


def test_a_quiet_film_says_its_file_alone(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main("run --quiet --body HC0 --method random --budget tiny".split()) == 0
    capfd.readouterr()
    run_id, out = RunConfig.create("HC0", "random").run_id, tmp_path / "film.webp"
    words = ["render", run_id, "--out", str(out), "--seconds", "0.1", "--quiet"]
    assert main(words) == 0
    assert capfd.readouterr() == (f"{out}\n", "")
    assert out.stat().st_size > 0


def test_a_campaign_is_work_on_one_study_by_two() -> None:
    asked = "--budget book --workers 1 --method tpil ppo --trials 1 --quiet".split()
    campaign = parser().parse_args(["campaign", "--study", "humanoids", *asked])
    work = parser().parse_args(["work", "humanoids", *asked])
    assert vars(campaign) | {"command": None} == vars(work) | {"command": None}


def test_bodies_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bodies"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == bodies.names()


def test_the_run_of_a_modules_body_is_no_run_of_anothers(data: Path) -> None:
    """Neither the paper's body nor another module's content passes for it, by name or from disk."""
    ids = {}
    for torso in ("1.0", "1.5", "1.6"):
        own = OWN.replace("HC1p5", "HC1").replace("1.5)", f"{torso}), True")
        (data / "longer.py").write_text(own)
        words = "--import longer --body HC1 --method random"
        shown = python("-m", "silem", "show", *words.split(), cwd=data)
        assert shown.returncode == 0, shown.stderr
        ids[torso] = shown.stdout.splitlines()[0]
    assert len({*ids.values(), RunConfig.create("HC1", "random").run_id}) == 4
    command = ["-m", "silem", "run", "--quiet", *words.split()]
    assert python(*command, cwd=data).returncode == 0
    shown = python("-m", "silem", "show", ids["1.6"], cwd=data)
    assert shown.returncode == 2
    assert "HC1 is not the body that this run is of; --import longer loads that" in shown.stderr
    record = files.read_json(next(data.glob("runs/*/*/record.json")))
    assert record["config"]["own_body"]["module"] == "longer"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"body": None}, "unknown body None"),
        ({"body": ["HC0"]}, "unknown body ['HC0']"),
        ({"method": None}, "unknown method None"),
        ({"study": 7}, "study must be a name"),
        ({"budget": None}, "no valid run configuration"),
        ({"budget": {"name": None}}, "budget must be a name"),
        ({"hyper": None}, "no valid run configuration"),
        ({"hyper": {"body": "HC0"}}, "no valid run configuration"),
        ({"seed": None}, "seed must be a whole number"),
    ],
)
def test_a_configuration_of_the_wrong_kind_is_one_line(
    content: dict[str, Any], message: str
) -> None:
    whole = RunConfig.create("HC1", "random").to_dict()
    if isinstance(content.get("budget"), dict):
        content["budget"] = whole["budget"] | content["budget"]
    with pytest.raises(SilemError, match=re.escape(message)) as error:
        RunConfig.from_dict(whole | content)
    assert "\n" not in str(error.value)


def test_the_endings_of_films_are_those_that_can_be_written() -> None:
    for ending in cli.FILM_ENDINGS:
        assert parser().parse_args(["render", "run", "--out", f"x{ending}"]).out.suffix == ending
    assert sorted(cli.FILM_ENDINGS) == sorted(film._ENCODERS)


OWN = """
import silem
from silem.bodies import half_cheetah

silem.bodies.register(half_cheetah.body("HC1p5", torso_length_m=1.5))
"""


def test_a_body_of_ones_own_by_import(data: Path) -> None:
    (data / "my_bodies.py").write_text(OWN)
    words = "run --import my_bodies --body HC1p5 --method random --study mine --quiet"
    code = f"""
import sys
from silem import bodies, cli
from silem.study import work
from silem.study.config import RunConfig
from silem.study.evaluate import load_policy

assert cli.main({words.split()!r}) == 0
config = RunConfig.create("HC1p5", "random", seed=1, study="mine")
print(config.command)
work.work([config], progress=False, made=lambda record: print(record.run_id == config.run_id))
"""
    done = python("-c", code, cwd=data)
    assert done.returncode == 0, done.stderr
    command, made = done.stdout.splitlines()[-2:]
    assert "run --import my_bodies --body HC1p5" in command
    assert made == "True"
    assert python("-m", *shlex.split(command), cwd=data).returncode == 0
    without = python("-m", *shlex.split(command.replace("--import my_bodies ", "")), cwd=data)
    assert "unknown body 'HC1p5'" in without.stderr


def test_bodies_of_installed_packages(data: Path) -> None:
    (data / "plugin.py").write_text(OWN)
    for name, target in (("good", "plugin"), ("bad", "no_such_plugin")):
        info = data / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[silem.bodies]\n{name} = {target}\n")
    code = "import gymnasium, silem; print(gymnasium.make('silem/HC1p5-v0').unwrapped.body.length)"
    done = python("-c", code, cwd=data, PYTHONPATH=f"{paths.REPO}:{data}")
    assert "('length of the torso', 1.5)" in done.stdout, done.stderr
    assert "the bodies of no_such_plugin are left out: ModuleNotFoundError" in done.stderr


def test_recording_never_advises_to_replace_what_is_committed(tmp_path: Path) -> None:
    committed = paths.REPO / "data"
    for kept in ("demonstrations/HC0.npz", "results/halfcheetah/ppo_HC0"):
        assert "SILEM_DATA_DIR" in runs.instead_of(committed / kept)
        assert "--force" not in runs.instead_of(committed / kept)
    for own in (tmp_path / "HC0.npz", committed / "runs" / "halfcheetah" / "ppo_HC0"):
        assert runs.instead_of(own) == "replace it with --force"


HEAVY = ("torch", "stable_baselines3", "pybullet", "scipy", "pandas", "matplotlib", "imageio")


@pytest.mark.parametrize("words", ["--help", "--version", "run --help", "bodies", "status", "run"])
def test_what_needs_no_learning_loads_none(words: str, data: Path) -> None:
    code = f"""
import sys
from silem.cli import main
try:
    main({words.split()!r})
finally:
    print([name for name in {HEAVY} if name in sys.modules])
"""
    done = python("-c", code, cwd=data)
    assert done.stdout.splitlines()[-1] == "[]"
    assert "build time" not in done.stdout  # PyBullet's greeting


def test_pybullets_greeting_is_not_heard(data: Path) -> None:
    done = python("-c", "import silem.envs.bullet, sys; assert 'pybullet' in sys.modules", cwd=data)
    assert (done.stdout, done.stderr) == ("", "")


def test_the_package_loads_lazily_and_knows_what_it_offers(data: Path) -> None:
    code = f"""
import sys, silem, gymnasium
print([name for name in {HEAVY} if name in sys.modules])
print(sorted(set(silem.__all__) - set(dir(silem))), "silem/Atlas-v0" in gymnasium.registry)
print([name for name in silem.__all__ if getattr(silem, name) is None], silem.SILEM.__name__)
"""
    done = python("-c", code, cwd=data)
    assert done.stdout.splitlines()[0] == "[]"
    assert done.stdout.splitlines()[1] == "[] True"
    assert done.stdout.splitlines()[-1] == "[] SILEM"
    with pytest.raises(AttributeError, match="no attribute 'SILLEM'"):
        _ = silem.SILLEM


def test_pages_that_read_records_alone_load_neither_pytorch_nor_simulators(data: Path) -> None:
    code = """
import sys
from silem.report import claims, curves, notebook, results, scores, statistics, tables
from silem.report.pages import cost, reviewers, search
results.trace(results.load_records("halfcheetah"))
print([name for name in ("torch", "mujoco", "pybullet", "imageio") if name in sys.modules])
"""
    assert python("-c", code, cwd=data).stdout == "[]\n"


def test_simulators_are_loaded_without_a_word(data: Path) -> None:
    code = "import silem, sys; silem.make_vec('HC0', 1); sys.stderr.write('heard')"
    done = python("-c", code, cwd=data)
    assert (done.stdout, done.stderr) == ("", "heard")


def python(*arguments: str, cwd: Path, **env: str) -> subprocess.CompletedProcess[str]:
    env = {"PYTHONPATH": str(paths.REPO)} | env
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd, env=os.environ | env, capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_a_closed_pipe_and_a_full_disk_are_no_traceback(data: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    for words, code in ((["bodies"], 141), (["--help"], 0)):  # argparse's own help lets it go
        done = subprocess.run(
            [sys.executable, "-m", "silem", *words],
            cwd=paths.REPO, stdout=writer, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
        assert (done.returncode, done.stderr) == (code, "")
    os.close(writer)
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "silem", "bodies"],
            cwd=paths.REPO, stdout=full, stderr=subprocess.PIPE, text=True, check=False,
        )  # fmt: skip
    assert (done.returncode, done.stderr) == (1, "silem: No space left on device\n")


@pytest.mark.parametrize("sent", ["SIGINT", "SIGTERM"])
def test_stopping_while_options_are_parsed_is_one_line(sent: str, data: Path) -> None:
    (data / "slow.py").write_text(f"import os, signal\nos.kill(os.getpid(), signal.{sent})\n")
    done = python("-m", "silem", "bodies", "--import", "slow", cwd=data)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "silem: stopped\n")


@pytest.mark.parametrize("sent", ["SIGINT", "SIGTERM"])
def test_stopping_while_the_package_loads_is_silent(sent: str, data: Path) -> None:
    """As soon as the package's first line has run; what Python does before is its own."""
    (data / "numpy.py").write_text(f"import os, signal\nos.kill(os.getpid(), signal.{sent})\n")
    done = python("-m", "silem", "bodies", cwd=data)
    assert (done.returncode, done.stdout, done.stderr) == (-getattr(signal, sent), "", "")
    script = data / "silem"  # as pip writes it
    script.write_text("import sys\nfrom silem.cli import main\nsys.exit(main())\n")
    done = python(str(script), "bodies", cwd=data)
    assert (done.returncode, done.stdout, done.stderr) == (-getattr(signal, sent), "", "")


def test_a_program_that_imports_the_package_keeps_its_ctrl_c(data: Path) -> None:
    (data / "program.py").write_text(
        "import os, signal\nimport silem\ntry:\n    os.kill(os.getpid(), signal.SIGINT)\n"
        "except KeyboardInterrupt:\n    print('caught')\n"
    )
    assert python("program.py", cwd=data).stdout == "caught\n"


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_stopping_keeps_the_checkpoint_and_exits_with_130(sent: signal.Signals) -> None:
    config = RunConfig.create("HC0", "ppo", budget=BUDGETS["tiny"].with_iterations(5000))
    process = subprocess.Popen(
        [sys.executable, "-m", *config.command.split()],
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
