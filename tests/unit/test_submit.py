"""Work loops on clusters: SLURM and Dask for real where they can start, HTCondor by its file."""

from __future__ import annotations

import getpass
import os
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest

from silem.cli import main
from silem.study import runs, work
from silem.study.config import RunConfig
from silem.study.runs import CHECKPOINT, RECORD
from silem.study.submit import ENGINES, Options, submission, submit
from silem.util import files, paths
from silem.util.errors import SilemError

# Eight runs: experts and random policies of two bodies, two trials each.
STUDY = "halfcheetah --budget tiny --iterations 12 --trials 2".split()
STUDY += "--body HC0 HC1 --method ppo random".split()


@pytest.fixture(autouse=True)
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path / "data"))
    return tmp_path / "data"


def records() -> list[Path]:
    return sorted(paths.runs_dir().rglob(RECORD))


def wait_for(what: str, happened: object, seconds: float = 240.0) -> None:
    until = time.monotonic() + seconds
    while not happened():  # type: ignore[operator]
        assert time.monotonic() < until, f"no {what} within {seconds:.0f} s"
        time.sleep(0.2)


# ---------------------------------------------------------------- options and files


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("jobs = 3\nqueue = 'long'", r"toml: unknown option 'queue'; allowed: jobs, minutes"),
        ("jobs = 3\n\nminutes = 0", r"toml: minutes must be like 240 \(no number below 1"),
        ("jobs = '3'", "toml: jobs must be like 4"),
        ("jobs = true", "toml: jobs must be like 4"),
        ("setup = 'module load python'", "toml: setup must be like"),
        ("lines = ['#SBATCH -p x', 3]", "toml: lines must be a list of lines"),
        ("jobs = 3\nx y", r"cannot read .*at line 2"),
    ],
)
def test_bad_options_are_told_by_file_and_key(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "cluster.toml"
    path.write_text(text)
    with pytest.raises(SilemError, match=message):
        Options.load(path)


def test_what_slurm_is_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "cluster.toml"
    path.write_text(
        "jobs = 12\nminutes = 60\nmargin_s = 90\nmemory_mb = 3000\n"
        'setup = ["module load python"]\nlines = ["#SBATCH --partition=long"]\n'
    )
    words = ["submit", *STUDY, "--on", "slurm", "--options", str(path), "--print"]
    assert main(words) == 0
    lines = capsys.readouterr().out.splitlines()
    for option in ("array=1-12", "time=60", "signal=B:USR1@90", "requeue", "mem=3000M"):
        assert f"#SBATCH --{option}" in lines
    first_command = next(i for i, line in enumerate(lines) if line and line[0] != "#")
    assert lines.index("#SBATCH --partition=long") < first_command  # SLURM reads no further
    loop = next(i for i, line in enumerate(lines) if line.endswith("&"))
    assert lines.index("module load python") < loop
    asked = shlex.split(lines[loop].removesuffix("&"))
    assert asked == [sys.executable, "-m", "silem", "work", *STUDY, "--minutes", "58", "--quiet"]
    assert f"export SILEM_DATA_DIR={paths.data_dir()}" in lines
    assert not paths.data_dir().exists()  # nothing was started
    assert subprocess.run(["bash", "-n"], input="\n".join(lines), text=True).returncode == 0


def test_what_htcondor_is_given() -> None:
    options = Options(jobs=7, setup=('export A="it\'s $HOME"',), lines=("+Long = true",))
    text = submission("htcondor", ["work", *STUDY], options)
    given = dict(line.split(" = ", 1) for line in text.splitlines() if " = " in line)
    assert text.splitlines()[-1] == "queue 7"
    assert given["request_cpus"] == "1"
    assert given["request_memory"] == "2000 MB"
    # retried as long as a loop says that there is more to do, and for nothing else
    assert (given["max_retries"], given["retry_until"]) == ("1000", "ExitCode =!= 130")
    assert given["kill_sig"] == "SIGTERM"
    assert given["+Long"] == "true"
    # HTCondor's quoting: one pair of double quotes around all, single ones group, both are doubled
    whole = given["arguments"]
    assert r"it\''s $(DOLLAR)HOME" in whole  # not a macro of HTCondor's
    assert whole[:5] + whole[-2:] == "\"-c ''\""
    command = whole[5:-2].replace("''", "'").replace('""', '"').replace("$(DOLLAR)", "$")
    said = subprocess.run(
        ["bash", "-c", command.replace(f"exec {sys.executable}", 'echo "$A" "$SILEM_DATA_DIR"')],
        capture_output=True, text=True, env=os.environ | {"HOME": "home"}, check=True,
    )  # fmt: skip
    assert said.stdout.startswith(f"it's home {paths.data_dir()} -m silem work halfcheetah ")


def test_setup_lines_mean_the_same_to_every_engine() -> None:
    """Remarks, blocks and backslashes: none swallows what follows it."""
    lines = ("true  # a remark", "if true; then", r"  export A='a\tb'", "fi", "set -eu")
    for engine in ENGINES:
        text = submission(engine, ["work", *STUDY], Options(setup=lines))
        if engine == "htcondor":
            (whole,) = (line for line in text.splitlines() if line.startswith("arguments"))
            text = whole.partition("'")[2].rpartition("'")[0]
            text = text.replace("''", "'").replace('""', '"').replace("$(DOLLAR)", "$")
        text = text.replace(f"{sys.executable} -m silem", 'printf "%s\\n" "$A"', 1)
        done = subprocess.run(
            ["bash"], input=text.replace(r'\\n', r'\\\\n') if engine == "htcondor" else text,
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.stdout.splitlines()[0] == r"a\tb", (engine, done)


@pytest.mark.parametrize(("code", "said"), [(130, "requeue 7_3\n"), (2, ""), (0, "")])
def test_a_task_of_an_array_queues_itself_again_and_no_other(
    code: int, said: str, tmp_path: Path
) -> None:
    scontrol = tmp_path / "scontrol"
    scontrol.write_text('#!/bin/bash\necho "$@"\n')
    scontrol.chmod(0o755)
    text = submission("slurm", ["work", *STUDY], Options(setup=("set -eu",)))
    text = text.replace(f"\n{sys.executable} -m silem", f"\nbash -c 'exit {code}' loop", 1)
    place = {"SLURM_JOB_ID": "7", "SLURM_ARRAY_JOB_ID": "7", "SLURM_ARRAY_TASK_ID": "3"}
    env = os.environ | place | {"PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(["bash"], input=text, capture_output=True, text=True, env=env)
    assert (done.returncode, done.stdout) == (code, said), done.stderr


def test_dask_goes_on_when_one_loop_has_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    class Future:
        status = "finished"

        def __init__(self, outcome: tuple[int, str]) -> None:
            self.outcome = outcome

        def result(self) -> tuple[int, str]:
            return self.outcome

    class Client:
        """Its loops end one after another: failed, out of time, out of time, done, done."""

        left: ClassVar[list[int]] = [2, 130, 130, 0, 0]

        def __init__(self, *args: Any, **kwargs: Any) -> None: ...
        def __enter__(self) -> Client:
            return self

        def __exit__(self, *args: Any) -> None: ...
        def submit(self, *args: Any, **kwargs: Any) -> Future:
            return Future((self.left[0], f"said {self.left.pop(0)}"))

    class Ending(list[Future]):
        add = list.append

    fake = types.SimpleNamespace(Client=Client, as_completed=Ending)
    monkeypatch.setitem(sys.modules, "distributed", fake)
    with pytest.raises(SilemError, match=r"^a loop ended with code 2: said 2$"):
        submit("dask", ["work", *STUDY], Options(jobs=3, scheduler="tcp://anywhere:1"))
    assert Client.left == []


def test_retry_is_handed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sbatch = tmp_path / "sbatch"
    sbatch.write_text("#!/bin/bash\necho submitted\n")
    sbatch.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    config = RunConfig.create("HC0", "ppo", budget="tiny")
    runs.fail(config, "its disk was full")
    words = "submit halfcheetah --budget tiny --on slurm --retry".split()
    assert main([*words, "--print"]) == 0 and runs.state(config) == "failed"
    assert main(words) == 0 and runs.state(config) == "missing"


def test_what_a_loop_elsewhere_finds_its_modules_by(monkeypatch: pytest.MonkeyPatch) -> None:
    root = str(paths.REPO)
    for there, then in (("", root), (root, root), (f"/a:{root}:/b", f"{root}:/a:/b")):
        monkeypatch.setenv("PYTHONPATH", there)
        assert work.environment()["PYTHONPATH"] == then


def test_no_scheduler_here_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    for engine, program in (("slurm", "sbatch"), ("htcondor", "condor_submit")):
        with pytest.raises(SilemError, match=f"there is no {program} here .*--print"):
            submit(engine, ["work", *STUDY], Options())
    assert sorted(ENGINES) == ["dask", "htcondor", "slurm"]


# ---------------------------------------------------------------- SLURM

SLURM_CONF = """\
ClusterName=one
SlurmctldHost=localhost(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
CommunicationParameters=NoInAddrAny,NoCtldInAddrAny
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
MpiDefault=none
SwitchType=switch/none
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
JobRequeue=1
KillWait=10
ReturnToService=2
SchedulerParameters=sched_interval=1,bf_interval=1
NodeName=localhost NodeAddr=127.0.0.1 CPUs=2 RealMemory=4000
PartitionName=all Nodes=localhost Default=YES MaxTime=INFINITE State=UP
"""


def free_ports(n: int) -> list[int]:
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(n)]
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


def slurm(command: str) -> str:
    return subprocess.run(shlex.split(command), capture_output=True, text=True, check=True).stdout


@pytest.fixture
def one_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A SLURM of one node on the loopback interface, or a skip where it cannot start."""
    monkeypatch.setenv("PATH", f"{os.environ['PATH']}:/usr/sbin:/sbin")
    needed = ("munged", "slurmctld", "slurmd", "sbatch")
    if missing := [name for name in needed if not shutil.which(name)]:
        pytest.skip(f"no {', '.join(missing)} here (Debian: slurm-wlm and munge)")
    if os.getuid():
        pytest.skip("slurmd starts jobs as root alone")
    folder = tmp_path / "s"
    for name in ("state", "spool"):
        (folder / name).mkdir(parents=True)
    key = folder / "munge.key"
    key.write_bytes(os.urandom(128))
    key.chmod(0o400)
    conf = folder / "slurm.conf"
    text = SLURM_CONF.format(folder=folder, user=getpass.getuser(), ports=free_ports(2))
    conf.write_text(text)
    monkeypatch.setenv("SLURM_CONF", str(conf))
    munge = ["munged", "--foreground", "--force", "--key-file", str(key)]
    for name in ("socket", "pid-file", "log-file", "seed-file"):
        munge += [f"--{name}", str(folder / name.replace("socket", "munge.socket"))]
    daemons: list[subprocess.Popen[bytes]] = []
    try:
        for command in (munge, ["slurmctld", "-D", "-i"], ["slurmd", "-D", "-N", "localhost"]):
            output = open(folder / f"{command[0]}.out", "wb")
            daemons.append(subprocess.Popen(command, stdout=output, stderr=output))
            output.close()
            if command is munge:
                time.sleep(1)
        for _ in range(100):
            done = subprocess.run(["sinfo", "-h", "-o", "%T"], capture_output=True, text=True)
            if done.stdout.strip() == "idle":
                break
            time.sleep(0.3)
        else:
            said = "".join(path.read_text()[-600:] for path in folder.glob("*.out"))
            pytest.skip(f"SLURM does not start here: {done.stderr} {said}")
        yield
    finally:
        subprocess.run(["scancel", "--full", "-u", getpass.getuser()], check=False)
        for daemon in reversed(daemons):
            daemon.terminate()
            daemon.wait(30)


def test_slurm_works_through_a_study_and_requeues(
    one_node: None, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "options.toml").write_text("jobs = 3\nminutes = 30\n")
    words = ["--on", "slurm", "--options", str(tmp_path / "options.toml")]
    assert main(["submit", *STUDY, *words]) == 0
    assert "Submitted batch job" in capsys.readouterr().out

    def running() -> list[str]:
        return slurm("squeue -h -t R -o %A").split()

    def requeued() -> list[str]:
        """Jobs that have begun before; they would wait for two minutes."""
        jobs = [
            j
            for j in slurm("squeue -h -o %A").split()
            if "Restarts=0" not in slurm(f"scontrol show job {j}")
        ]
        for job in slurm("squeue -h -t PD -o %A").split():
            subprocess.run(["scontrol", "update", f"JobId={job}", "StartTime=now"], check=False)
        return jobs

    wait_for("checkpoint", lambda: list(paths.runs_dir().rglob(CHECKPOINT)))
    preempted, late = running()
    slurm(f"scontrol requeue {preempted}")
    slurm(f"scancel --batch --signal=USR1 {late}")  # as SLURM does before the limit
    wait_for("requeue of both", lambda: len(requeued()) == 2)
    wait_for("end", lambda: not (requeued(), slurm("squeue -h"))[1])
    assert len(records()) == 8
    assert not list(paths.runs_dir().rglob(runs.ATTEMPT))
    assert not [path for path in paths.runs_dir().rglob(runs.LOCK) if files.is_locked(path)]
    told = "".join(p.read_text() for p in sorted((paths.runs_dir() / "log").glob("slurm-*.txt")))
    assert told.count("the same command goes on") == 2
    assert "Traceback" not in told


# ---------------------------------------------------------------- Dask


def test_dask_works_through_a_study_and_its_workers_may_die(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="the extra 'dask'")
    config = {
        "distributed.scheduler.allowed-failures": 0,
        "distributed.worker.memory.terminate": False,
    }
    config |= {"distributed.nanny.pre-spawn-environ.PYTHONPATH": str(paths.REPO)}
    import dask

    with (
        dask.config.set(config),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
        ) as cluster,
    ):
        (tmp_path / "options.toml").write_text(
            f"jobs = 2\nscheduler = '{cluster.scheduler_address}'\n"
        )
        options = ["--on", "dask", "--options", str(tmp_path / "options.toml")]
        submitted = subprocess.Popen(
            [sys.executable, "-m", "silem", "submit", *STUDY, *options], cwd=paths.REPO,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        for _ in range(2):
            wait_for(
                "loop at work",
                lambda: [p for p in paths.runs_dir().rglob(runs.LOCK) if files.is_locked(p)],
            )
            victim = next(iter(cluster.workers.values())).pid
            os.kill(victim, signal.SIGKILL)
            time.sleep(2)
        said, _ = submitted.communicate(timeout=300)
        assert submitted.returncode == 0, said
    assert "loops have ended" in said
    assert len(records()) == 8
    assert not [path for path in paths.runs_dir().rglob(runs.LOCK) if files.is_locked(path)]


def test_dask_without_an_address_or_a_scheduler_is_one_line() -> None:
    pytest.importorskip("distributed", reason="the extra 'dask'")
    with pytest.raises(SilemError, match="needs the option scheduler"):
        submit("dask", ["work", *STUDY], Options())
    with pytest.raises(SilemError, match=r"no Dask scheduler at tcp://127\.0\.0\.1:1"):
        submit("dask", ["work", *STUDY], Options(scheduler="tcp://127.0.0.1:1"))
