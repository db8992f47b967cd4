"""Reading and writing files so that nothing is ever half written, unnoticed or pickled.

Writes go to a temporary file in the same folder, reach the disk, and then take the final name in
one step: a reader, or a process that starts after a crash, sees the old file or the new one.
Whatever goes wrong with a file, or with what is to be written, becomes a `SilemError` that names
the file: every function here raises it.
"""

import csv
import errno
import fcntl
import hashlib
import io
import json
import os
import secrets
import socket
import time
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy

from silem.util.errors import SilemError, reason

MAX_UNFOLDED_BYTES = 1 << 29
"""What the arrays of one npz file may take in memory; a small file can claim to hold any amount."""


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically, in its folder or a new one; SilemError leaves the file before."""
    path = Path(path)
    # processes on several machines, or in containers, may share a number
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(temporary, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(temporary, path)
        # A rename is only safe against power loss once the folder's own entry is on the disk.
        with _opened(path.parent, os.O_RDONLY) as folder:
            os.fsync(folder)
    except OSError as error:
        raise SilemError(f"cannot write {path}: {reason(error)}") from error
    finally:
        with suppress(OSError):
            temporary.unlink()


@contextmanager
def _opened(path: Path, flags: int) -> Iterator[int]:
    """Give the descriptor of a file or folder, which is closed in the end."""
    descriptor = os.open(path, flags, 0o644)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def remove_leftovers(folder: Path) -> None:
    """Delete what killed writers left in a folder; only for who holds the lock of its writers."""
    for leftover in Path(folder).glob(".*.tmp"):
        try:
            leftover.unlink(missing_ok=True)
        except OSError as error:
            raise SilemError(f"cannot remove {leftover}: {reason(error)}") from error


@contextmanager
def _content(path: Path, what: str) -> Iterator[bytes]:
    """Give a file to a parser; whatever that raises becomes one line that names the file."""
    try:
        data = Path(path).read_bytes()
    except (OSError, ValueError, MemoryError) as error:  # ValueError: a NUL in the path
        raise SilemError(f"cannot read {path}: {reason(error)}") from error
    try:
        yield data
    except Exception as error:  # zlib, lzma, struct, memory, overflow, recursion, ...: no list ends
        raise SilemError(f"{path} is {what} ({reason(error)})") from error


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text atomically."""
    write_bytes(path, text.encode())


def write_json(path: Path, obj: Any) -> None:
    """Write an object as indented JSON, atomically; NaN and infinity are none."""
    try:
        text = json.dumps(obj, indent=2, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise SilemError(f"cannot write {path}: {error}") from error
    write_text(path, text + "\n")


def read_json(path: Path) -> Any:
    """Read a JSON file; NaN and Infinity are no JSON, although Python reads them."""

    def refuse(constant: str) -> float:
        raise ValueError(f"it holds {constant}")

    with _content(path, "no valid JSON") as data:
        return json.loads(data, parse_constant=refuse)


def read_csv(path: Path) -> dict[str, np.ndarray]:
    """Read a CSV file of numbers below one line of names: columns by name, NaN where blank."""
    with _content(path, "no table of numbers") as data:
        names, *rows = csv.reader(io.StringIO(data.decode()), strict=True)
        if len(set(names)) != len(names) or any(len(row) != len(names) for row in rows):
            raise ValueError("its rows and its line of names do not match")
        values = np.array([[float(cell or "nan") for cell in row] for row in rows])
        return dict(zip(names, values.reshape(len(rows), len(names)).T, strict=True))


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays as an uncompressed npz file; the same arrays always give the same bytes."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name in sorted(arrays):
            entry = io.BytesIO()
            try:
                np.lib.format.write_array(entry, np.asarray(arrays[name]), allow_pickle=False)
            except ValueError as error:
                raise SilemError(f"cannot write {path}: array {name!r}: {error}") from error
            # A ZipInfo made from a name alone carries the fixed date 1980-01-01.
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), entry.getvalue())
    write_bytes(path, buffer.getvalue())


def read_npz(path: Path) -> dict[str, np.ndarray]:
    """Read every array of an npz file: none a pickle, and up to `MAX_UNFOLDED_BYTES` in all."""
    with (
        _content(path, "no readable npz file of plain arrays") as data,
        zipfile.ZipFile(io.BytesIO(data)) as archive,
    ):
        names = [entry.filename.removesuffix(".npy") for entry in archive.infolist()]
        if len(set(names)) != len(names):
            raise ValueError("it holds one name twice")
        # zipfile unfolds no more of an entry than the size that it states
        if sum(entry.file_size for entry in archive.infolist()) > MAX_UNFOLDED_BYTES:
            raise ValueError(f"unfolded it takes more than {MAX_UNFOLDED_BYTES >> 20} MiB")
        return {
            name: np.lib.format.read_array(io.BytesIO(archive.read(entry)), allow_pickle=False)
            for name, entry in zip(names, archive.infolist(), strict=True)
        }


def write_tensors(
    path: Path, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str] | None = None
) -> None:
    """Write named arrays and text metadata as a safetensors file; the same ones, the same bytes."""
    # asarray with order="C" keeps 0-d arrays as they are, unlike ascontiguousarray.
    contiguous = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    # One JSON text, because safetensors does not keep the order of several.
    text = json.dumps(dict(metadata or {}), sort_keys=True)
    try:
        data = safetensors.numpy.save(contiguous, metadata={"silem": text})
    except (safetensors.SafetensorError, KeyError, TypeError, ValueError) as error:
        raise SilemError(f"cannot write {path}: {error}") from error
    write_bytes(path, data)


def read_tensors(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Read the arrays and the metadata of a file made by `write_tensors`, and of no other."""
    with _content(path, "damaged or no safetensors file of this project") as data:
        # safetensors.numpy.load drops the metadata; they stand in the header, whose length
        # is the first 8 bytes.
        arrays = safetensors.numpy.load(data)
        header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
        metadata = json.loads(header["__metadata__"]["silem"])
        if not all(isinstance(value, str) for value in metadata.values()):
            raise ValueError("its metadata are no texts")
        return {name: np.array(array) for name, array in arrays.items()}, metadata


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal; raises SilemError if it cannot be read."""
    with _content(path, "") as data:
        return hashlib.sha256(data).hexdigest()


class Held(SilemError):
    """Another process holds a lock."""


@contextmanager
def lock(path: Path, wait_s: float = 1.0) -> Iterator[None]:
    """Hold a lock file while the ``with`` block runs, after waiting `wait_s` for another process.

    The kernel releases the lock when its process ends, even by ``kill -9``, so no stale lock can
    stay behind. The file's text is the holder's ``pid@host``, for messages only. Where another
    process holds the lock, the error is `Held`.
    """
    path = Path(path)
    until = time.monotonic() + wait_s
    with ExitStack() as stack:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            descriptor = stack.enter_context(_opened(path, os.O_RDWR | os.O_CREAT))
            while not _lock_now(descriptor, fcntl.LOCK_EX):
                if time.monotonic() >= until:
                    raise Held(f"{path} is held by {holder(path)}, which is at work there")
                time.sleep(0.02)
        except OSError as error:
            raise SilemError(f"cannot lock {path}: {reason(error)}") from error
        with suppress(OSError):  # a full disk is no reason not to work
            os.ftruncate(descriptor, 0)
            os.pwrite(descriptor, f"{os.getpid()}@{socket.gethostname()}".encode(), 0)
        yield


def is_locked(path: Path) -> bool:
    """Return whether some process holds a `lock`: another user's, too, which cannot be opened.

    Where the file system has no locks none is held, because `lock` refuses to work there.
    """
    try:
        with _opened(path, os.O_RDONLY) as descriptor:
            return not _lock_now(descriptor, fcntl.LOCK_SH)
    except OSError as error:
        return isinstance(error, PermissionError)


def holder(path: Path) -> str:
    """Return who holds a `lock`, or held it last: ``pid@host``."""
    with suppress(OSError), open(path, "rb") as stream:
        return stream.read(100).decode(errors="replace").strip() or "another process"
    return "another process"


def check_locks(folder: Path) -> None:
    """Raise SilemError where the file system of a folder lets a lock be taken twice."""
    path = Path(folder) / "locks.lock"
    with lock(path, wait_s=60.0), suppress(Held), lock(path, wait_s=0.0):
        told = f"the file system of {folder} does not honour locks: two workers could make one run"
        raise SilemError(f"{told}; set SILEM_DATA_DIR to one that does")


def _lock_now(descriptor: int, kind: int) -> bool:
    """Lock an open file, or return False where another process holds it."""
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES):  # some file systems say EACCES
            return False
        raise
    return True
