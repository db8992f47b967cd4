"""What the notebooks share: how figures, tables, videos and numbers are shown."""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Callable, Sequence
from numbers import Integral, Real
from typing import Any

import numpy as np
import pandas as pd
from IPython.display import HTML, SVG, Markdown, display
from IPython.display import Image as DisplayedImage
from matplotlib.figure import Figure
from myst_nb import glue
from pandas.io.formats.style import Styler

from silem.report import film as films
from silem.report import results, style, tables
from silem.report.film import Clip, encode_mp4, encode_png, why_no_pictures
from silem.report.parameters import literal_assignments, parameters
from silem.study.config import TRIAL_SEEDS

__all__ = [
    "film", "literal_assignments", "note", "parameters", "play", "play_first_trials", "say", "show",
    "show_picture", "table", "text",
]  # fmt: skip


def show(figure: Figure) -> None:
    """Display a figure as vector graphics; the same figure always gives the same bytes.

    The runs it was drawn from follow in a cell of their own, by `silem.report.provenance.trace`:
    a captioned cell may have one output only.
    """
    _display(SVG(style.svg(figure)))  # type: ignore[no-untyped-call]


def show_picture(picture: np.ndarray) -> None:
    """Display a picture (H, W, 3)."""
    _display(DisplayedImage(data=encode_png(picture)))  # type: ignore[no-untyped-call]


def table(frame: pd.DataFrame, digits: int | None = None, caption: str = "") -> Styler:
    """Return a table in the book's look; a named index becomes its first column.

    Args:
        frame: The table.
        digits: Digits after the point of numbers that are not whole; None writes them as they are.
        caption: What it shows.
    """
    named = frame.reset_index() if frame.index.name else frame
    return tables.styled(named.map(lambda value: _cell(value, digits)), caption)


def _cell(value: Any, digits: int | None) -> str:
    if isinstance(value, bool | str) or not isinstance(value, Real):
        return html.escape(str(value))
    if digits is None or isinstance(value, Integral):
        return f"{value:,}".replace("-", "−")
    return tables.number(round(float(value), digits) + 0.0, digits)  # never a negative zero


def play(clip: Clip | None, caption: str) -> None:
    """Embed a clip as a video that needs neither a network nor a file beside the page.

    Args:
        clip: The clip; it plays at the speed of the simulation. None says that there is none yet.
        caption: What it shows, as plain text.
    """
    if clip is None:
        return note(f"No video ({caption}): no run with a policy has been published yet.")
    height, width = clip.frames.shape[1:3]
    poster = base64.b64encode(encode_png(clip.frames[0])).decode()
    video = base64.b64encode(encode_mp4(clip)).decode()
    text = html.escape(caption)
    page = (
        '<figure class="silem-clip">'
        f'<video controls loop muted playsinline width="{width}" height="{height}"'
        f' style="max-width: 100%; height: auto" aria-label="{text}"'
        f' poster="data:image/png;base64,{poster}">'
        f'<source type="video/mp4" src="data:video/mp4;base64,{video}"></video>'
        f"<figcaption>{text}</figcaption></figure>"
    )
    _display_html(page)


def film(make: Callable[[], Clip | None], caption: str) -> Clip | None:
    """Make a clip and play it; where nothing can be drawn offscreen, say why instead.

    Args:
        make: Makes the clip, e.g. ``lambda: film.rollout("Atlas")``.
        caption: What it shows, as plain text.

    Returns:
        The clip, if there is one.
    """
    if why := why_no_pictures("Humanoid"):
        note(f"No video ({caption}): {why}")
        return None
    clip = make()
    play(clip, caption)
    return clip


def show_strip(clip: Clip | None) -> None:
    """Show a clip on paper: equally spaced pictures of it; say so where there is none."""
    note("No pictures: there is no clip.") if clip is None else show_picture(films.strip(clip))


def play_first_trials(
    records: pd.DataFrame, methods: Sequence[str], body: str, duration_s: float
) -> None:
    """Film the first trial of each method on a body, side by side, from the saved policies.

    The first trial rather than the best one: its seed was fixed before any run was made. What
    cannot be filmed, because that run is not there yet, is named instead.

    Args:
        records: Runs of one study at one budget, from `silem.report.results.load_records`.
        methods: The methods, from left to right.
        body: The body.
        duration_s: Simulated time to film, seconds.
    """
    chosen = {}
    for method in methods:
        label = style.method(method, results.original_body(records)).label
        of_cell = (records["method"] == method) & (records["body"] == body)
        first = records[of_cell & (records["seed"] == TRIAL_SEEDS[0])]
        record = results.find(first["run_id"].iloc[0]) if len(first) else None
        if record is None:
            note(f"No policy of {label} on {body} has been published at this budget yet.")
            continue
        if first["stand_in"].iloc[0]:
            label += f", {first['n_iterations'].iloc[0]:,} iterations"
        if why := why_no_pictures(body):
            note(f"No video of {label} on {body}: {why}")
            continue
        chosen[label] = record
    if chosen:
        clips = films.of_runs(chosen, duration_s)
        text = f"{body}, first trial, in real time: {' | '.join(clips)}"
        play(films.grid(clips), text)


def text(words: str) -> None:
    """Show sentences that were made from records, in Markdown."""
    _display(Markdown(words))  # type: ignore[no-untyped-call]


def note(text: str) -> None:
    """Say on the page what is not there."""
    _display_html(f"<p><em>{html.escape(text)}</em></p>")


def _display(item: object) -> None:
    display(item)  # type: ignore[no-untyped-call]


def _display_html(text: str) -> None:
    _display(HTML(text))  # type: ignore[no-untyped-call]


def say(**values: float | str | np.ndarray | None) -> None:
    """Make numbers available to the page's sentences, through ``{glue:text}`name` ``.

    Args:
        **values: Numbers or texts by the name that the sentences use; of an array, such as the
            scores of a cell's trials, the mean. None, NaN and an empty array, for what no run has
            shown yet, become a dash.
    """
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value = float(value.mean()) if len(value) else None
        glue(name, value if isinstance(value, str) else _in_words(value), display=False)


def _in_words(value: float | None) -> str:
    """Write a number with as many digits as a sentence needs, and a true minus."""
    if value is None or math.isnan(value):
        return tables.DASH
    if abs(value) >= 100 or value == int(value):
        return style.number(value)
    return f"{value:.2f}".replace("-", "−")
