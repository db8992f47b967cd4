from __future__ import annotations

import errno
import fcntl
import io
import multiprocessing
import os
import pickle
import resource
import signal
import tracemalloc
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
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


def zipped(path: Path, kind: int, data: bytes, names: tuple[str, ...] = ("a.npy",)) -> Path:
    with zipfile.ZipFile(path, "w", kind) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # zipfile warns of one name twice
        for name in names:
            archive.writestr(name, data)
    return path


def npy() -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.zeros(4000))
    return stream.getvalue()


@pytest.mark.parametrize("kind", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_damage_within_a_compressed_npz_is_one_line(kind: int, tmp_path: Path) -> None:
    path = zipped(tmp_path / "x.npz", kind, npy())
    assert files.read_npz(path)["a"].shape == (4000,)
    whole = path.read_bytes()
    for i in range(len(whole)):
        path.write_bytes(whole[:i] + bytes([whole[i] ^ 0x55]) + whole[i + 1 :])
        with suppress(SilemError):  # a date or an attribute is nothing that is read
            assert files.read_npz(path)["a"].shape == (4000,)


def test_an_npz_that_is_encrypted_or_names_an_array_twice_is_refused(tmp_path: Path) -> None:
    path = zipped(tmp_path / "x.npz", zipfile.ZIP_STORED, npy(), ("a.npy", "a.npy"))
    with pytest.raises(SilemError, match="one name twice"):
        files.read_npz(path)
    data = bytearray(zipped(path, zipfile.ZIP_STORED, npy()).read_bytes())
    for start in (data.index(b"PK\x03\x04") + 6, data.index(b"PK\x01\x02") + 8):
        data[start] |= 1  # "encrypted"
    path.write_bytes(data)
    with pytest.raises(SilemError, match=r"x\.npz .*encrypted"):
        files.read_npz(path)


def test_a_small_npz_that_unfolds_to_gigabytes_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("a.npy", "w", force_zip64=True) as entry,
    ):
        for _ in range(33):
            entry.write(bytes(1 << 24))
    assert path.stat().st_size < 4e6
    tracemalloc.start()
    with pytest.raises(SilemError, match="more than 512 MiB"):
        files.read_npz(path)
    assert tracemalloc.get_traced_memory()[1] < 1e8
    tracemalloc.stop()


@pytest.mark.parametrize("shape", [(2**62,), (2**40, 2**40), (-1,), (2**31, 2**31, 2**2)])
def test_an_array_that_claims_to_be_huge_is_refused(shape: tuple[int, ...], tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    stream = io.BytesIO()
    header = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, header)
    zipped(path, zipfile.ZIP_STORED, stream.getvalue() + bytes(64))
    with pytest.raises(SilemError, match=r"x\.npz is no readable npz"):
        files.read_npz(path)


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a": ' * 100_000, "1" * 5000, "\udcff", "{} {}", ""]
)
def test_json_that_is_none_is_refused_in_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(SilemError, match=r"x\.json is no valid JSON") as caught:
        files.read_json(path)
    assert "\n" not in str(caught.value)


def test_csv_round_trip_and_refusals(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("a,b\n1,\n2,3.5\n")
    table = files.read_csv(path)
    np.testing.assert_array_equal(table["a"], [1, 2])
    np.testing.assert_array_equal(table["b"], [np.nan, 3.5])
    for bad in ("", "a,b\n1\n", "a,a\n1,2\n", "a\nx\n", "a\n\udcff\n", 'a\n"1\n', "a\n1\0\n"):
        path.write_bytes(bad.encode(errors="surrogateescape"))
        with pytest.raises(SilemError, match=r"x\.csv is no table of numbers"):
            files.read_csv(path)


@pytest.mark.parametrize("metadata", ["[]", "3", "null", '{"a": 1}'])
def test_safetensors_with_strange_metadata_are_refused(metadata: str, tmp_path: Path) -> None:
    path = tmp_path / "x.safetensors"
    safetensors.numpy.save_file({"a": np.zeros(2)}, path, metadata={"silem": metadata})
    with pytest.raises(SilemError, match="no safetensors file of this project"):
        files.read_tensors(path)


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


def test_a_lock_that_is_no_text_names_nobody(tmp_path: Path) -> None:
    path = tmp_path / "x.lock"
    with files.lock(path):
        path.write_bytes(b"\xff\xfe")
        with pytest.raises(SilemError, match="is held by"), files.lock(path, wait_s=0):
            pass


def test_another_users_lock_counts_as_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.lock"
    path.touch()

    def refused(*arguments: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refused)  # root may open anything
    assert files.is_locked(path)
    with pytest.raises(SilemError, match=r"cannot lock .*Permission denied"), files.lock(path):
        pass


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_a_file_system_without_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    path = tmp_path / "x.lock"
    path.touch()

    def unsupported(*arguments: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", unsupported)
    assert not files.is_locked(path)
    with pytest.raises(SilemError, match="cannot lock"), files.lock(path):
        pass


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


def test_writers_of_several_machines_may_have_one_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in containers: their temporary files are not each other's."""
    monkeypatch.setattr(files.os, "getpid", lambda: 7)
    written, move = [], files.os.replace

    def replace(temporary: Path, path: Path) -> None:
        if not written:  # the other one writes in between
            written.append(temporary)
            files.write_text(path, "other")
        move(temporary, path)

    monkeypatch.setattr(files.os, "replace", replace)
    files.write_text(tmp_path / "note.txt", "one")
    assert (tmp_path / "note.txt").read_text() == "one"
