"""The humanoids' policies on film: on one body, every method that has a finished run."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from IPython.display import HTML, display

from silem.report import notebook, rendering, results, style
from silem.report.motion_video import STATES_PER_PICTURE
from silem.report.video import Clip, side_by_side, strip
from silem.study.policies import load_policy
from silem.study.record import POLICY

METHODS = ("silem", "silem-minus", "tpil", "peng20", "ppo")
"""The methods that are filmed, in their order on the page."""

_N_COLUMNS = 3
_WIDTH, _HEIGHT = 320, 300  # pixels of one clip
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
        groups: Tables of runs by what to call them, "" for an only one.
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
            label = ", ".join(filter(None, [_short(method), name]))
            run = best(frame, method, body)
            if run is None:
                absent.append(label)
                continue
            if run["stand_in"]:
                label += f", {run['n_iterations']:,} iterations"
            clip = film(str(run["run_id"]), duration_s)
            fell = round(duration_s - clip.duration_s, 2) > 0
            clips[f"{label}, falls at {clip.duration_s:.1f} s" if fell else label] = clip
    if clips:
        text = f"{body}, best trials, in real time: {' | '.join(clips)}"
        notebook.play(grid(list(clips.values()), list(clips)), text)
    if absent:
        _note(f"No finished run on {body} yet: {'; '.join(absent)}.")


def show_strip(run_id: str, duration_s: float, n_pictures: int = 6) -> None:
    """Show equally spaced pictures of a humanoid's policy side by side: a film on paper.

    Args:
        run_id: A finished run; "" shows nothing but says so.
        duration_s: Simulated time from the first picture to the last, seconds.
        n_pictures: How many pictures, fewer if the body falls before there are so many.
    """
    if not run_id or POLICY not in results.find(run_id).files:
        _note("No pictures: there is no policy.")
    elif why := rendering.why_no_pictures(results.find(run_id).config["body"]):
        _note(f"No pictures: {why}")
    else:
        clip = film(run_id, duration_s)
        notebook.show_picture(strip(clip, min(n_pictures, len(clip.frames))))


def film(run_id: str, duration_s: float, seed: int = 0) -> Clip:
    """Film a humanoid's policy from the start of an episode, acting stochastically.

    The clip ends where the episode does, if that comes first.

    Args:
        run_id: A finished run.
        duration_s: Simulated time to film, seconds.
        seed: Seed of the start state and of the policy's random numbers.

    Raises:
        SilemError: There is no such run, its policy is missing, or nothing can be drawn offscreen.
    """
    record = results.find(run_id)
    return rendering.rollout(
        record.run_config().learner,
        load_policy(record),
        duration_s=duration_s,
        seed=seed,
        steps_per_frame=STATES_PER_PICTURE,
        size=(_WIDTH, _HEIGHT),
    )


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


def _short(method: str) -> str:
    return style.method(method, "").label.partition(",")[0]


def _note(text: str) -> None:
    display(HTML(f"<p><em>{html.escape(text)}</em></p>"))  # type: ignore[no-untyped-call]
