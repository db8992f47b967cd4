"""Reading and writing files so that nothing is ever half written, unnoticed or pickled.

Writes go to a temporary file in the same folder, reach the disk, and then take the final name in
one step: a reader, or a process that starts after a crash, sees the old file or the new one.
Whatever goes wrong with a file becomes a `SilemError` that names it.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import socket
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import filelock
import numpy as np
import safetensors
import safetensors.numpy

from silem.util.errors import SilemError

Arrays = dict[str, np.ndarray]


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically, creating its folder where needed.

    Raises:
        SilemError: The disk is full or read-only, or the path cannot be written; the file that was
            there before is untouched.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with open(temporary, "wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        _sync_folder(path.parent)
    except OSError as error:
        raise SilemError(f"cannot write {path}: {error.strerror or error}") from error


def _sync_folder(folder: Path) -> None:
    # A rename is only safe against power loss once the folder's own entry is on the disk.
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_leftovers(folder: Path) -> None:
    """Delete the temporary files that a killed writer left in a folder."""
    for leftover in Path(folder).glob(".*.tmp"):
        leftover.unlink(missing_ok=True)


def _read_bytes(path: Path) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise SilemError(f"cannot read {path}: {error.strerror or error}") from error


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text atomically. Raises as `write_bytes`."""
    write_bytes(path, text.encode())


def write_json(path: Path, obj: Any) -> None:
    """Write an object as indented JSON, atomically.

    Raises:
        SilemError: As `write_bytes`, or the object holds NaN, infinity, or what JSON cannot say.
    """
    try:
        text = json.dumps(obj, indent=2, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise SilemError(f"cannot write {path}: {error}") from error
    write_text(path, text + "\n")


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        SilemError: The file is missing, truncated or no JSON.
    """
    try:
        return json.loads(_read_bytes(path))
    except ValueError as error:  # includes bytes that are no UTF-8
        raise SilemError(f"{path} is no valid JSON ({error})") from error


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays as an uncompressed npz file; the same arrays always give the same bytes.

    Raises:
        SilemError: As `write_bytes`, or an array would need a pickle (dtype object).
    """
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


def read_npz(path: Path) -> Arrays:
    """Read every array of an npz file.

    Raises:
        SilemError: The file is missing, truncated, damaged, no npz, or holds a pickle.
    """
    data = _read_bytes(path)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return {
                name.removesuffix(".npy"): np.lib.format.read_array(
                    io.BytesIO(archive.read(name)), allow_pickle=False
                )
                for name in archive.namelist()
            }
    except (zipfile.BadZipFile, ValueError, EOFError, NotImplementedError) as error:
        raise SilemError(f"{path} is no readable npz file of plain arrays ({error})") from error


def write_tensors(
    path: Path, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str] | None = None
) -> None:
    """Write named arrays and text metadata as a safetensors file, atomically.

    The same content always gives the same bytes: the metadata travel as one JSON text, because
    safetensors does not keep the order of several.

    Raises:
        SilemError: As `write_bytes`, or an array's dtype is none of safetensors'.
    """
    # asarray with order="C" keeps 0-d arrays as they are, unlike ascontiguousarray.
    contiguous = {name: np.asarray(array, order="C") for name, array in arrays.items()}
    text = json.dumps(dict(metadata or {}), sort_keys=True)
    try:
        data = safetensors.numpy.save(contiguous, metadata={"silem": text})
    except (safetensors.SafetensorError, KeyError, TypeError, ValueError) as error:
        raise SilemError(f"cannot write {path}: {error}") from error
    write_bytes(path, data)


def read_tensors(path: Path) -> tuple[Arrays, dict[str, str]]:
    """Read the arrays and the metadata of a file made by `write_tensors`.

    Raises:
        SilemError: The file is missing, truncated, damaged or not of this project.
    """
    data = _read_bytes(path)
    try:
        # safetensors.numpy.load drops the metadata; they stand in the header, whose length
        # is the first 8 bytes.
        arrays = safetensors.numpy.load(data)
        header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
        metadata = json.loads(header["__metadata__"]["silem"])
    except (safetensors.SafetensorError, KeyError, ValueError) as error:
        raise SilemError(
            f"{path} is damaged or no safetensors file of this project ({error})"
        ) from error
    return {name: np.array(array) for name, array in arrays.items()}, metadata


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal.

    Raises:
        SilemError: The file cannot be read.
    """
    return hashlib.sha256(_read_bytes(path)).hexdigest()


@contextmanager
def lock(path: Path, wait_s: float = 1.0) -> Iterator[None]:
    """Hold a lock file while the ``with`` block runs.

    The kernel releases the lock when its process ends, even by ``kill -9``, so no stale lock can
    stay behind. The holder's ``pid@host`` stands beside it in ``<path>.holder``, for messages only.

    Args:
        path: The lock file, whose folder is made where needed.
        wait_s: How long to wait for another process to let go, seconds.

    Raises:
        SilemError: Another process holds the lock (the message names it), or the file cannot be
            made.
    """
    path = Path(path)
    holder = path.with_name(path.name + ".holder")
    guard = filelock.FileLock(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        guard.acquire(timeout=wait_s)
    except filelock.Timeout:
        name = holder.read_text() if holder.is_file() else "another process"
        raise SilemError(f"{path} is held by {name}, which is at work there") from None
    except OSError as error:
        raise SilemError(f"cannot lock {path}: {error.strerror or error}") from error
    try:
        write_text(holder, f"{os.getpid()}@{socket.gethostname()}")
        yield
    finally:
        holder.unlink(missing_ok=True)
        guard.release()


def is_locked(path: Path) -> bool:
    """Return whether some process holds a `lock` at this moment."""
    if not Path(path).exists():
        return False
    guard = filelock.FileLock(path)
    try:
        guard.acquire(timeout=0)
    except filelock.Timeout:
        return True
    guard.release()
    return False
