"""Is a committed record what it says it is?"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from silem.study.record import RunRecord
from silem.util.errors import SilemError


def validate(folder: Path) -> RunRecord:
    """Load one record and check that it is whole and agrees with itself.

    Checked are its keys, its configuration (through the one strict door), that the run id is the
    configuration's and the folder's name, that numbers are finite and the mean return is the mean
    of the episodes' returns, and the SHA-256 of every file beside it.

    Args:
        folder: The run's folder.

    Returns:
        The record.

    Raises:
        SilemError: Naming the folder and what is wrong.
    """
    record = RunRecord.load(folder)
    try:
        _check(record, folder)
    except (KeyError, TypeError) as error:
        raise SilemError(f"{folder}: the record lacks or misstates {error}") from error
    except SilemError as error:
        raise SilemError(f"{folder}: {error}") from error
    for name in record.files:
        record.file(name)
    return record


def _check(record: RunRecord, folder: Path) -> None:
    identity = record.run_config().run_id
    if not identity == record.run_id == folder.name:
        raise SilemError(f"run id {record.run_id!r}, but its configuration's is {identity!r}")
    evaluation = record.evaluation
    _check_finite({"evaluation": evaluation, "training": record.training})
    returns = evaluation["returns"]
    if len(returns) != evaluation["n_episodes"]:
        raise SilemError(f"{len(returns)} returns of {evaluation['n_episodes']} episodes")
    # The single returns are rounded to three digits after the point.
    if abs(float(np.mean(returns)) - evaluation["return_mean"]) > 1e-2:
        raise SilemError("return_mean is not the mean of the episodes' returns")


def _check_finite(value: Any, where: str = "record") -> None:
    """Walk through nested JSON; NaN and infinity are not even JSON, but Python reads them."""
    if isinstance(value, float) and not math.isfinite(value):
        raise SilemError(f"{where} is not finite")
    if isinstance(value, list):
        value = dict(enumerate(value))
    if isinstance(value, dict):
        for key, entry in value.items():
            _check_finite(entry, f"{where}.{key}")
