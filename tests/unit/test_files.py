from __future__ import annotations

import multiprocessing
import os
import pickle
import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy

from silem.util import files
from silem.util.errors import SilemError

ARRAYS = {
    "weights": np.arange(12, dtype=np.float32).reshape(3, 4).T,  # not contiguous
    "step": np.float64(0.1) * np.ones(()),
    "done": np.array([True, False]),
    "none": np.empty((0, 3)),
}


@contextmanager
def disk_full_after(n_bytes: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "file.bin"
    files.write_bytes(path, b"old")
    with disk_full_after(1000), pytest.raises(SilemError, match=r"cannot write .*file\.bin"):
        files.write_bytes(path, bytes(5000))
    assert path.read_bytes() == b"old"
    assert os.listdir(path.parent) == ["file.bin"]


def test_an_impossible_path_is_named(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("a file where a folder is needed")
    with pytest.raises(SilemError, match="cannot write"):
        files.write_text(tmp_path / "a" / "b", "x")
    with pytest.raises(SilemError, match=r"cannot read .*missing"):
        files.sha256(tmp_path / "missing")


def test_leftovers_of_a_killed_writer_are_removed_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / ".checkpoint.safetensors.123.tmp").write_bytes(b"half")
    (tmp_path / "checkpoint.safetensors").write_bytes(b"whole")
    files.remove_leftovers(tmp_path)
    assert os.listdir(tmp_path) == ["checkpoint.safetensors"]


def test_json_round_trip_and_refusals(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    files.write_json(path, {"a": [1, 0.1, None]})
    assert files.read_json(path) == {"a": [1, 0.1, None]}
    for bad in ({"a": float("nan")}, {"a": np.zeros(2)}):
        with pytest.raises(SilemError, match=r"x\.json"):
            files.write_json(path, bad)
    assert files.read_json(path) == {"a": [1, 0.1, None]}
    path.write_text('{"a": [1, ')
    with pytest.raises(SilemError, match="no valid JSON"):
        files.read_json(path)


@pytest.mark.parametrize("kind", ["npz", "safetensors"])
def test_arrays_round_trip_with_the_same_bytes_each_time(kind: str, tmp_path: Path) -> None:
    paths = [tmp_path / f"{i}.{kind}" for i in range(2)]
    reordered = dict(reversed(ARRAYS.items()))
    metadata = {f"key {i}": str(i) for i in range(10)}
    for path, arrays in zip(paths, (ARRAYS, reordered), strict=True):
        if kind == "npz":
            files.write_npz(path, arrays)
            back = files.read_npz(path)
        else:
            files.write_tensors(path, arrays, metadata)
            back, found = files.read_tensors(path)
            assert found == metadata
        assert back.keys() == ARRAYS.keys()
        for name, array in ARRAYS.items():
            assert back[name].dtype == array.dtype
            assert back[name].shape == array.shape
            np.testing.assert_array_equal(back[name], array)
    assert files.sha256(paths[0]) == files.sha256(paths[1])


@pytest.mark.parametrize("kind", ["npz", "safetensors"])
def test_every_truncation_is_noticed(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"x.{kind}"
    read = files.read_npz if kind == "npz" else files.read_tensors
    if kind == "npz":
        files.write_npz(path, ARRAYS)
    else:
        files.write_tensors(path, ARRAYS)
    data = path.read_bytes()
    for length in range(0, len(data), 7):
        path.write_bytes(data[:length])
        with pytest.raises(SilemError, match=path.name):
            read(path)


def test_a_flipped_bit_in_an_npz_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    files.write_npz(path, {"a": np.zeros(1000)})
    data = bytearray(path.read_bytes())
    data[4000] ^= 1
    path.write_bytes(data)
    with pytest.raises(SilemError, match=r"x\.npz"):
        files.read_npz(path)


class Trap:
    """Unpickling this makes a file."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.target,)


def test_pickles_are_neither_written_nor_read(tmp_path: Path) -> None:
    trap, target = Trap(tmp_path / "sprung"), tmp_path / "sprung"
    path = tmp_path / "x.npz"
    with pytest.raises(SilemError, match="'a'"):
        files.write_npz(path, {"a": np.array([trap])})
    assert not path.exists()
    path.write_bytes(pickle.dumps(trap))
    with pytest.raises(SilemError):
        files.read_npz(path)
    np.savez(path, a=np.array([trap], dtype=object))
    with pytest.raises(SilemError):
        files.read_npz(path)
    assert not target.exists()
    np.load(path, allow_pickle=True)["a"]  # the trap does work
    assert target.exists()


def test_foreign_safetensors_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.safetensors"
    safetensors.numpy.save_file({"a": np.zeros(2)}, path)
    with pytest.raises(SilemError, match="no safetensors file of this project"):
        files.read_tensors(path)


def _hold(path: Path, ready: multiprocessing.synchronize.Event) -> None:
    with files.lock(path):
        ready.set()
        signal.pause()


def test_a_lock_names_its_holder_and_dies_with_it(tmp_path: Path) -> None:
    path = tmp_path / "runs" / "x.lock"
    context = multiprocessing.get_context("fork")
    ready = context.Event()
    other = context.Process(target=_hold, args=(path, ready))
    other.start()
    assert ready.wait(30)
    assert other.pid is not None
    with pytest.raises(SilemError, match=rf"held by {other.pid}@"), files.lock(path, wait_s=0):
        pass
    assert files.is_locked(path)
    os.kill(other.pid, signal.SIGKILL)
    other.join(30)
    assert not files.is_locked(path)
    with files.lock(path, wait_s=0):
        assert files.is_locked(path)
    assert not files.is_locked(path)


def _write_for_ever(path: Path) -> None:
    version = 0
    while True:
        version += 1
        files.write_tensors(path, {"a": np.full(50_000, version)}, {"version": str(version)})


def test_kill_9_in_the_middle_of_writing_leaves_a_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "x.safetensors"
    context = multiprocessing.get_context("fork")
    rng = np.random.default_rng()
    interrupted_writes = 0
    for _ in range(20):
        writer = context.Process(target=_write_for_ever, args=(path,))
        writer.start()
        while not path.exists():
            pass
        writer.join(rng.uniform(0.0, 0.05))
        writer.kill()
        writer.join()
        arrays, metadata = files.read_tensors(path)
        assert set(arrays["a"].tolist()) == {int(metadata["version"])}
        interrupted_writes += len(list(tmp_path.glob(".*.tmp")))
        files.remove_leftovers(tmp_path)
    assert interrupted_writes > 0  # else no kill came in the middle of a write
