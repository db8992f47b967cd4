"""Whatever a reader is given, it ends in success or in one line of SilemError."""

from __future__ import annotations

import argparse
import json
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic_records as synthetic

pytest.importorskip("hypothesis", reason="hypothesis is in environment.txt")
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from silem import cli
from silem.motion import demonstrations as demos
from silem.motion import demonstrator, retargeting
from silem.motion.demonstrations import Demonstrations
from silem.study import runs, submit, verify, work
from silem.study.config import RunConfig
from silem.study.runs import CURVE_COLUMNS, RECORD, RunRecord, curve_csv, curve_row
from silem.study.training import Checkpoint
from silem.util import files
from silem.util.errors import SilemError

CONFIG = RunConfig.create("HC0", "silem")
NAMES = (
    st.text(max_size=300) | st.none() | st.integers() | st.sampled_from(["*", "..", "a/b", "HC0"])
)
SCALARS = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.just(10**400) | NAMES
)
JSON = st.recursive(
    SCALARS, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=8
)
ARRAYS = hnp.arrays(
    hnp.scalar_dtypes() | hnp.unicode_string_dtypes(),
    hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)
many = settings(
    max_examples=int(os.environ.get("SILEM_EXAMPLES", "40")),
    derandomize="SILEM_EXAMPLES" not in os.environ,  # the same inputs each time, or a hunt
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def ends_well(read: Callable[[], object]) -> None:
    """Call a reader; anything but success or one line of SilemError fails the test."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read()
        except SilemError as error:
            assert "\n" not in str(error)


@st.composite
def damaged(draw: st.DrawFn, whole: bytes) -> bytes:
    """A file with some bytes changed, cut out or put in."""
    data = bytearray(whole)
    for _ in range(draw(st.integers(0, 4))):
        start = draw(st.integers(0, len(data)))
        length = draw(st.integers(0, 8))
        data[start : start + length] = draw(st.binary(max_size=8))
    return bytes(data[: draw(st.integers(0, len(data)) | st.just(len(data)))])


@st.composite
def with_changes(draw: st.DrawFn, whole: dict[str, Any]) -> dict[str, Any]:
    """A nested dictionary of which some entries are others, gone or new."""
    changed = dict(whole)
    for key in draw(st.lists(st.sampled_from(sorted(whole)) | st.text(), max_size=2)):
        inner = changed.get(key)
        if isinstance(inner, dict) and inner and draw(st.booleans()):
            changed[key] = draw(with_changes(inner))
        elif draw(st.booleans()):
            changed[key] = draw(JSON)
        else:
            changed.pop(key, None)
    return changed


def whole_files(folder: Path) -> dict[str, bytes]:
    """One sound file of each kind."""
    files.write_json(folder / "json", CONFIG.to_dict())
    files.write_text(folder / "csv", curve_csv(np.ones((3, len(CURVE_COLUMNS)))))
    Demonstrations((np.zeros((3, 2), np.float32),), (1.0,), "HC0").save(folder / "npz")
    steps = CONFIG.budget.steps_per_iteration
    rows = np.array([curve_row(i, i * steps, {}) for i in (1, 2)])
    Checkpoint(CONFIG.run_id, 2, 1.0, 0.5, (), (), "", rows, {"w": np.ones(3)}).save(
        folder / "tensors"
    )
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


READERS: dict[str, Callable[[Path], object]] = {
    "json": files.read_json,
    "csv": files.read_csv,
    "npz": Demonstrations.load,
    "tensors": lambda path: Checkpoint.load(path, CONFIG, ""),
}


@pytest.mark.parametrize("kind", READERS)
@many
@given(data=st.data())
def test_a_file_of_any_bytes(kind: str, tmp_path: Path, data: st.DataObject) -> None:
    whole = whole_files(tmp_path / "whole")[kind]
    path = tmp_path / "file"
    path.write_bytes(data.draw(damaged(whole) | st.binary()))
    ends_well(lambda: READERS[kind](path))
    path.write_bytes(whole)
    READERS[kind](path)


@many
@given(arrays=st.dictionaries(st.sampled_from([*demos._OWN, "points"]), ARRAYS))
def test_demonstrations_of_any_arrays(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    path = tmp_path / "d.npz"
    sound = Demonstrations((np.zeros((3, 2), np.float32),), (1.0,), "HC0")
    sound.save(path)
    files.write_npz(path, files.read_npz(path) | arrays)
    ends_well(lambda: Demonstrations.load(path))
    ends_well(lambda: Demonstrations.of(list(arrays.values())))


@many
@given(content=with_changes(CONFIG.to_dict()) | JSON)
def test_a_configuration_of_any_json(content: Any) -> None:
    ends_well(lambda: RunConfig.from_dict(content))


@many
@given(data=st.data())
def test_a_record_of_any_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, data: st.DataObject
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    record = synthetic.write_record(CONFIG)
    path = record.folder / RECORD
    content = data.draw(with_changes(files.read_json(path)) | JSON)
    path.write_text(json.dumps(content))
    ends_well(lambda: RunRecord.load(path))
    ends_well(lambda: verify.check(record.folder))
    ends_well(lambda: verify.verify(record.folder, 0))


@many
@given(name=NAMES, content=JSON)
def test_any_name_and_any_manifest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: Any, content: Any
) -> None:
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path))
    for ask in (runs.find, demos.file_of, demos.entry, demos.load_published, verify.verify_all):
        ends_well(lambda ask=ask: list(ask(name)) if ask is verify.verify_all else ask(name))
    assert not list(tmp_path.iterdir())
    manifest = demos.file_of("x").with_name(demos.MANIFEST)
    files.write_bytes(manifest, json.dumps(content).encode())
    ends_well(lambda: demos.load_published(name))
    manifest.unlink()
    manifest.parent.rmdir()


# ---------------------------------------------------------------- the command line

COMMANDS: dict[str, argparse.ArgumentParser] = next(
    action.choices
    for action in cli.parser()._actions
    if isinstance(action, argparse._SubParsersAction)
)
SOME = [
    "HC0", "ant", "silem", "tiny", "quick", "book", "0", "1", "-1", "1e3", "nan", "a=b", "=", "-",
    "halfcheetah/HC2/silem", "halfcheetah//", "../x", "/", "", "\0", "x.mp4", "slurm", "dask", "--",
    "no_such_module", "policy_hidden=[8]", "policy_hidden=\"\\d\"", "window=9999999999",
    "gamma=0.9", "٣", "{}", "9" * 400,
]  # fmt: skip


@st.composite
def lines(draw: st.DrawFn) -> list[str]:
    """A command with some of its options, or others', and any words after each."""
    name = draw(st.sampled_from(sorted(COMMANDS)))
    known = [word for action in COMMANDS[name]._actions for word in action.option_strings]
    options = st.sampled_from(
        [word for word in known if word not in ("-h", "--help", "--with-input")]
    )
    words = st.sampled_from(SOME) | st.text(max_size=8)
    drawn = draw(st.lists(st.one_of(options, words, words, options), max_size=8))
    cell = ["--body", "HC0", "--method", "silem"]
    changed = [*cell, "--set", f"gamma={draw(words)}"]
    sound = draw(st.sampled_from([[], ["ant"], cell, changed]))
    return [name, *sound, *drawn]


@many
@given(words=lines())
def test_any_command_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    words: list[str],
) -> None:
    """Nothing is trained, drawn, submitted or fetched; what leads there is the real thing."""
    record = synthetic.write_record(CONFIG, folder=tmp_path / "record")
    monkeypatch.setenv("SILEM_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setattr(runs, "run", lambda *args, **kwargs: record)
    monkeypatch.setattr(work, "work", lambda configs, *args: work.check(configs))
    monkeypatch.setattr(work, "crew", lambda words, configs, *args: work.check(configs))
    monkeypatch.setattr(submit, "submit", submit.submission)
    for name in ("publish_clips", "publish_own"):
        monkeypatch.setattr(demonstrator, name, lambda *args, **kwargs: [])
    monkeypatch.setattr(retargeting, "publish_retargeted", lambda *args, **kwargs: [])
    try:
        code = cli.main(words)
    except SystemExit as end:  # argparse's own help and version
        code = end.code or 0
    said = capfd.readouterr().err
    assert code in (0, 1, 2), (words, said)
    assert bool(code) == said.startswith("silem: "), (words, said)
    assert said.count("\n") <= 1, (words, said)
