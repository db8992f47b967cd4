"""The page of the slider: runs that were filmed while they learned.

A run keeps its last policy alone, so that filming it means to train it again. This is the one place
where the book's code does so: it changes no record, and keeps nothing of a run that ends otherwise
than it is recorded. ``python -m silem.report.build --film RUN_ID`` calls `of_training`.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from silem.algorithms import PPO, SILEM
from silem.algorithms.silem import AffineTransform
from silem.report import film
from silem.study import runs
from silem.study.runs import CHECKPOINT, CURVE, RunRecord, curve_csv
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
    reached = Checkpoint.start(config, sha or "")
    with tempfile.TemporaryDirectory() as folder:
        while True:
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
            reached = Checkpoint.load(Path(folder) / CHECKPOINT, config, sha or "")
