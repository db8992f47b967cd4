"""The page of the slider: all runs' curves, and films of runs while they learned.

A run keeps its last policy alone, so that filming it means to train it again. This is the one place
where the book's code does so: it changes no record, and keeps nothing of a run that ends otherwise
than it is recorded. ``python -m silem.report.build --film RUN_ID`` calls `of_training`.
"""

import gzip
import json
import math
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from silem import bodies
from silem.algorithms import PPO, SILEM
from silem.algorithms.silem import AffineTransform
from silem.report import film, style, tables
from silem.report.transforms import feature_names
from silem.study import runs
from silem.study.runs import CHECKPOINT, CURVE, TRANSFORM, RunRecord, curve_csv, recorded
from silem.study.settings import METHODS
from silem.study.studies import STUDIES
from silem.study.training import Checkpoint, make_env, make_model, train
from silem.util import files
from silem.util.errors import SilemError
from silem.util.paths import REPO

LEARNING = REPO / "book" / "_static" / "films"
"""In a folder of a run's name, films of its policy while it learned: ``<iteration>.mp4``, and in
``transforms.npz`` its T at every checkpoint: ``iteration`` (K,), ``A`` and ``b`` (K, F)."""

_SIZE: film.Size = (400, 300)


def of_training(run_id: str, n_films: int = 6, folder: Path = LEARNING) -> None:
    """Repeat a run and film it: before it learns, and at checkpoints that double up to the last.

    It runs on one thread, as all runs do.

    Raises SilemError: There is no such run, or it ends with another curve than it is recorded with,
    as on processors with other numerical kernels; nothing is written then.
    """
    if (record := runs.find(run_id)) is None:
        raise SilemError(f"there is no finished run {run_id!r}")
    torch.set_num_threads(1)
    budget, clips, transforms = record.run_config.budget, {}, []
    every, last = budget.checkpoint_every, budget.n_iterations
    filmed = {0, *(every * round(last / 2**i / every) for i in range(n_films - 1))}
    for reached, model in tqdm(_checkpoints(record), run_id, last // every + 1, unit="checkpoint"):
        if reached.iteration in filmed:
            clips[reached.iteration] = film.rollout(
                record.run_config.learner, model, duration_s=5.0, size=_SIZE, progress=False
            )
        net = model.transform_net if isinstance(model, SILEM) else None
        if isinstance(net, AffineTransform):
            pair = [array.detach().numpy().copy() for array in (net.scale, net.offset)]
            transforms.append((reached.iteration, *pair))
    if curve_csv(reached.curve) != record.file(CURVE).read_text():
        raise SilemError(f"{run_id} ended here with another curve than it is recorded with")
    for iteration, clip in clips.items():
        film.write(folder / run_id / f"{iteration}.mp4", clip)
    if transforms:
        columns = (np.array(column) for column in zip(*transforms, strict=True))
        arrays = dict(zip(("iteration", "A", "b"), columns, strict=True))
        files.write_npz(folder / run_id / "transforms.npz", arrays)


def _checkpoints(record: RunRecord) -> Iterator[tuple[Checkpoint, PPO]]:
    """Repeat a run; yield its checkpoints and the models they hold, first the untrained one."""
    config = record.run_config
    demonstrations, sha = runs.load_demonstrations(config)
    with tempfile.TemporaryDirectory() as folder:
        while True:
            reached = Checkpoint.load(Path(folder) / CHECKPOINT, config, sha)
            with closing(make_env(config)) as env:
                model = make_model(config, env, demonstrations)
                if reached.iteration:
                    model.load_state_arrays(reached.model)
                yield reached, model
                if reached.iteration == config.budget.n_iterations:
                    return
                try:  # as a run without time: to the next checkpoint
                    train(model, config, Path(folder), reached, progress=False, until=-math.inf)
                except KeyboardInterrupt as stop:
                    if not stop.args:  # Ctrl-C
                        raise


def records() -> list[RunRecord]:
    """Return every published record, in the order of the studies, bodies and methods."""
    found = [RunRecord.load(folder) for folder in recorded()]
    order = list(STUDIES), bodies.names(), list(METHODS)

    def rank(record: RunRecord) -> tuple[Any, ...]:
        keys = [record.config[name] for name in ("study", "body", "method")]
        ranks = [o.index(k) if k in o else len(o) for o, k in zip(order, keys, strict=True)]
        return *ranks, -record.training["n_steps"], record.config["seed"]

    return sorted(found, key=rank)


def learning_pack() -> bytes:
    """Return the curves of all published runs that learned, and the T that each ended with.

    Of those that were filmed while they learned also the iterations of the films, and each T.
    """
    runs = []
    for record in records():
        config = record.config
        if CURVE not in record.files or config["study"] not in STUDIES:  # a search has too many
            continue
        curve = files.read_csv(record.file(CURVE))
        run = {name: config[name] for name in ("study", "body", "method", "seed")}
        run |= {
            "id": record.run_id,
            "label": _label(record),
            "colour": style.method(config["method"]).color,
            "curve": {name: _plain(column) for name, column in curve.items()},
        }
        if TRANSFORM in record.files:
            arrays = files.read_npz(record.file(TRANSFORM))
            if arrays.keys() == {"A", "b"}:
                run |= {name: _plain(array) for name, array in arrays.items()}
        if films := sorted(int(film.stem) for film in (LEARNING / record.run_id).glob("*.mp4")):
            run["films"] = films
        if (learned := LEARNING / record.run_id / "transforms.npz").exists():
            arrays = files.read_npz(learned)
            run["learned"] = {name: [_plain(row) for row in arrays[name]] for name in ("A", "b")}
            run["learned"]["iteration"] = arrays["iteration"].tolist()
        runs.append(run)
    used = dict.fromkeys(run["body"] for run in runs if "A" in run)
    data = {
        "runs": runs,
        "features": {body: feature_names(body) for body in used},
        "studies": {name: STUDIES[name].about for name in STUDIES},
    }
    return gzip.compress(json.dumps(data).encode(), 9, mtime=0)


def _label(record: RunRecord) -> str:
    """Name a run by its method and demonstrations, and by the settings that its cell has not."""
    config, name = record.run_config, style.method(record.config["method"], "").label
    name += f" from {config.demonstrations}" * bool(config.demonstrations)
    told = [f"trial {config.seed}", f"{config.budget.n_iterations:,} iterations"]
    changed = [(n, s.value) for n, s in config.settings().items() if s.source == "this run"]
    return ", ".join([name, *told, *(" ".join(tables.setting(*item)) for item in changed)])


def _plain(values: np.ndarray) -> list[float | None]:
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values]
