"""Handing work loops (`silem.study.work`) over to a cluster: SLURM, HTCondor or Dask.

A scheduler only starts loops and starts them again; what there is to do they find in the data
folder, which all machines must share.
"""

import dataclasses
import os
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from silem.study.work import STOPPED, environment
from silem.util import paths
from silem.util.errors import SilemError, choose, reason

_AGAIN = 1000  # times at most


@dataclass(frozen=True)
class Options:
    """What a cluster has to be told, as a TOML file holds it."""

    jobs: int = 4  # loops at a time; each keeps one core busy
    minutes: int = 240  # of a job, after which it queues again
    memory_mb: int = 2000
    margin_s: int = 120  # before the end, in which a loop stops
    setup: tuple[str, ...] = ()  # lines of shell before the loop, say "module load python"
    lines: tuple[str, ...] = ()  # for the scheduler, say "#SBATCH --partition=long"
    scheduler: str = ""  # Dask's address, say "tcp://10.0.0.1:8786"

    @classmethod
    def load(cls, path: Path | None) -> "Options":
        """Read options; None gives the defaults.

        Raises SilemError: the file cannot be read, or a key is unknown or of another type; the
        message names file and key.
        """
        try:
            given = tomllib.loads(path.read_text()) if path else {}
        except (OSError, ValueError) as error:
            raise SilemError(f"cannot read {path}: {reason(error)}") from error
        known = {item.name: item.default for item in dataclasses.fields(cls)}
        try:
            for key, value in given.items():
                default = known[choose("option", key, known)]
                if isinstance(default, tuple) and isinstance(value, list):
                    given[key] = value = tuple(value)
                    if not all(isinstance(row, str) and "\n" not in row for row in value):
                        raise SilemError(f"{key} must be a list of lines, not {value!r}")
                if type(value) is not type(default) or (isinstance(value, int) and value < 1):
                    raise SilemError(f"{key} must be like {default!r} (no number below 1)")
        except SilemError as error:
            raise SilemError(f"{path}: {error}") from error
        return cls(**given)


ENGINES = {"slurm": ("sbatch",), "htcondor": ("condor_submit", "-"), "dask": ()}
"""By name: the command into which is piped what the template of that name beside this says."""


def submission(engine: str, words: Sequence[str], options: Options) -> str:
    """Return what is handed over: a script for sbatch or Dask, or what condor_submit reads.

    `words` are what follows ``silem`` on a loop's command line. Raises SilemError: such an engine
    is not known.
    """
    text = Path(__file__).with_name(f"{choose('engine', engine, ENGINES)}.template").read_text()
    minutes = max(1, options.minutes - -(-options.margin_s // 60))
    words = [sys.executable, "-m", "silem", *words, "--minutes", str(minutes), "--quiet"]
    exports = [f"export {name}={shlex.quote(value)}" for name, value in environment().items()]
    setup, loop = "\n".join([*exports, *options.setup]), shlex.join(words)
    # bash takes the lines from its own quotes, $'...'; in HTCondor's, either kind is written twice
    script = f"{setup}\nexec {loop}".replace("\\", r"\\").replace("'", r"\'").replace("\n", r"\n")
    quoted = f"eval $'{script}'".replace("'", "''").replace('"', '""')
    said = dataclasses.asdict(options) | {"lines": "\n".join(options.lines), "setup": setup}
    return text.format(
        **said, loop=loop, quoted=quoted.replace("$", "$(DOLLAR)"), again=_AGAIN, stopped=STOPPED,
        logs=paths.runs_dir() / "log", folder=shlex.quote(os.getcwd()),
    )  # fmt: skip


def submit(engine: str, words: Sequence[str], options: Options) -> str:
    """Hand loops over and return what the scheduler says; Dask is waited for, which has no queue.

    Raises SilemError: there is no such scheduler here, or it refuses.
    """
    text = submission(engine, words, options)
    (paths.runs_dir() / "log").mkdir(parents=True, exist_ok=True)
    if not (command := ENGINES[engine]):
        return _to_dask(text, options)
    try:
        done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    except OSError as error:
        told = f"there is no {command[0]} here ({reason(error)}); submit where there is one"
        raise SilemError(f"{told}, or see what would be submitted with --print") from error
    if done.returncode:
        raise SilemError(f"{command[0]} refuses: {reason(ValueError(done.stderr))}")
    return done.stdout.strip()


def _to_dask(script: str, options: Options) -> str:
    try:
        import distributed
    except ModuleNotFoundError as error:
        raise SilemError("Dask needs distributed: pip install 'silem[dask]'") from error
    if not options.scheduler:
        raise SilemError("Dask needs the option scheduler, its address")
    try:
        client = distributed.Client(options.scheduler, timeout=10)
    except (OSError, ValueError) as error:
        raise SilemError(f"no Dask scheduler at {options.scheduler}: {reason(error)}") from error
    codes: list[int] = []
    failed: dict[str, None] = {}
    hand_over = partial(client.submit, loop_on_dask, script, pure=False)
    with client:
        going = distributed.as_completed([hand_over() for _ in range(options.jobs)])
        for future in going:
            lost = future.status != "finished"  # with the worker that it was on
            code, said = (STOPPED, str(future.exception())) if lost else future.result()
            if code == STOPPED and len(codes) < _AGAIN:
                going.add(hand_over())
            elif code:
                failed[f"a loop ended with code {code}: {said}"] = None
            codes.append(code)
    if failed:
        raise SilemError("; ".join(failed))
    return f"{codes.count(0)} loops have ended"


def loop_on_dask(script: str) -> tuple[int, str]:
    """Work on a Dask worker, in a process that ends with it; return code and last words."""
    with subprocess.Popen(
        ["/bin/bash", "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        lines = process.stdout.read().strip().splitlines()
        return process.wait(), lines[-1] if lines else ""
