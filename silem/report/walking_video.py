"""The humanoids' policies on film: on one body, every method that has a finished run."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from IPython.display import HTML, display
from PIL import Image

from silem.report import notebook, rendering, results, style
from silem.report.video import Clip, side_by_side
from silem.study.policies import load_policy
from silem.study.record import POLICY

METHODS = ("silem", "silem-minus", "tpil", "peng20", "ppo")
"""The methods that are filmed, in their order on the page."""

_N_COLUMNS = 3
_SIZE = (320, 240)  # of one clip, in pixels: half of what the camera takes
_GAP = 8


def show(
    groups: Mapping[str, pd.DataFrame],
    body: str,
    duration_s: float,
    methods: Sequence[str] = METHODS,
) -> None:
    """Film the best trial of every method on a body, and play the clips as one grid.

    Each starts from the same seed, stands still on its last picture once the body has fallen, and
    says when that was. What cannot be filmed is named instead.

    Args:
        groups: Tables of runs by what to call them; "" for the only one.
        body: The body.
        duration_s: Simulated time to film, seconds.
        methods: The methods.
    """
    if why := rendering.why_no_pictures(body):
        _note(f"No videos of {body}: {why}")
        return
    clips, absent = {}, []
    for name, frame in groups.items():
        for method in methods:
            label = " ".join([style.method(method, "").label, name]).strip()
            run = best(frame, method, body)
            if run is None:
                absent.append(label)
                continue
            if run["stand_in"]:
                label += f" ({run['n_iterations']:,} iterations)"
            clip = _filmed(str(run["run_id"]), duration_s)
            seconds = clip.duration_s
            fell = round(seconds, 2) < round(duration_s, 2)
            clips[f"{label}: falls after {seconds:.1f} s" if fell else label] = clip
    if clips:
        text = f"{body}, best trials, in real time: {' | '.join(clips)}"
        notebook.play(grid(list(clips.values()), list(clips)), text)
    if absent:
        _note(f"No finished run on {body} yet of: {', '.join(absent)}.")


def best(frame: pd.DataFrame, method: str, body: str) -> pd.Series | None:
    """Return a cell's run of the highest return among those with a policy, None if none has.

    A run of another number of iterations than planned only counts where there is no planned one.
    """
    for runs in (results.cell(frame, method, body), results.stand_ins(frame, method, body)):
        for _, run in runs.sort_values("return_mean", ascending=False).iterrows():
            if POLICY in results.find(run["run_id"]).files:
                return run
    return None


def grid(clips: Sequence[Clip], labels: Sequence[str], n_columns: int = _N_COLUMNS) -> Clip:
    """Lay clips out in rows, each under its label; one that ends early holds its last frame.

    Args:
        clips: Of one size and frame rate.
        labels: One for each.
        n_columns: Clips in a row.

    Raises:
        SilemError: Clips and labels differ in number, or the clips in frame rate or height.
    """
    rows = [
        side_by_side(clips[start : start + n_columns], labels[start : start + n_columns]).frames
        for start in range(0, len(clips), n_columns)
    ] or [side_by_side(clips, labels).frames]
    n_frames, width = max(len(row) for row in rows), max(row.shape[2] for row in rows)
    stacked: list[np.ndarray] = []
    for row in rows:
        held = np.pad(row, [(0, n_frames - len(row)), (0, 0), (0, 0), (0, 0)], mode="edge")
        right, below = width - row.shape[2], _GAP if len(stacked) < len(rows) - 1 else 0
        white = [(0, 0), (0, below), (0, right), (0, 0)]
        stacked.append(np.pad(held, white, constant_values=255))
    return Clip(np.concatenate(stacked, axis=1), clips[0].frames_per_s)


def _filmed(run_id: str, duration_s: float) -> Clip:
    """Film a run's policy, at half of the camera's size."""
    record = results.find(run_id)
    learner = record.run_config().learner
    clip = rendering.rollout(learner, load_policy(record), duration_s=duration_s)
    small = [
        np.asarray(Image.fromarray(frame).resize(_SIZE, Image.Resampling.LANCZOS))
        for frame in clip.frames
    ]
    return replace(clip, frames=np.stack(small))


def _note(text: str) -> None:
    display(HTML(f"<p><em>{html.escape(text)}</em></p>"))  # type: ignore[no-untyped-call]
