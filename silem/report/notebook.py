"""What the notebooks share: their parameters, and how figures, tables, films and numbers are shown.

A notebook's second cell, tagged ``parameters``, holds plain literals; papermill injects a cell of
overriding literals after it. papermill only warns about a name the notebook does not know and
never checks a type, so a misspelt parameter would silently run the defaults. The third cell
therefore calls `parameters`.
"""

import ast
import base64
import html
import math
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import chain, groupby
from numbers import Integral, Real
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from IPython.display import HTML, SVG, Markdown, display
from IPython.display import Image as DisplayedImage
from matplotlib.figure import Figure
from myst_nb import glue
from pandas.io.formats.style import Styler

from silem.report import results, style, tables
from silem.study.config import TRIAL_SEEDS
from silem.util.errors import SilemError

if TYPE_CHECKING:  # simulators and PyTorch come with it, which a page of tables does not need
    from silem.report.film import Clip

_NO_NUMBER = re.compile(r"float\('-?(nan|inf)'\)")  # as papermill writes them


def parameters(namespace: Mapping[str, Any], /, **schema: type | Sequence[str]) -> SimpleNamespace:
    """Check a notebook's parameters and return them as attributes.

    The names checked are those assigned by the last cells that held nothing but assignments of
    literals: the ``parameters`` cell and the one papermill injects. Variables of other cells are
    no parameters, and the cell can be run again at any time.

    Args:
        namespace: The notebook's ``globals()``.
        **schema: For each parameter its type (``str``, ``int``, ``float`` or ``bool``) or the
            strings allowed. An ``int`` is taken for a ``float``; a ``bool`` is never a number.

    Raises:
        SilemError: Naming each parameter that is unknown, missing or not what is allowed.
    """
    problems = [f"unknown parameter {n!r}" for n in _given(namespace) if n not in schema]
    problems += [f"parameter {name!r} is missing" for name in schema if name not in namespace]
    values = {name: namespace[name] for name in schema if name in namespace}
    for name, value in values.items():
        if not _conforms(value, schema[name]):
            problems.append(f"{name} = {value!r} is not {_describe(schema[name])}")
        elif schema[name] is float:
            values[name] = float(value)
    if problems:
        listing = "; ".join(f"{name}: {_describe(allowed)}" for name, allowed in schema.items())
        raise SilemError(f"{'; '.join(problems)}. Allowed: {listing}")
    return SimpleNamespace(**values)


def _given(namespace: Mapping[str, Any]) -> list[str]:
    """Return the names set as parameters: by the notebook's last literal-only cells."""
    assigned = [literal_assignments(source) for source in namespace.get("In", [])]
    neighbours = [list(cells) for literal, cells in groupby(assigned, key=bool) if literal]
    names = chain(*neighbours[-1]) if neighbours else ()
    return [name for name in dict.fromkeys(names) if name in namespace]


def literal_assignments(source: str) -> list[str]:
    """Return the names that a cell assigns, if it does nothing but assign literals, else []."""
    names = []
    try:
        for statement in ast.parse(source).body:
            if not isinstance(statement, ast.Assign | ast.AnnAssign):
                return []
            value = ast.unparse(statement.value) if statement.value else ""
            ast.literal_eval(_NO_NUMBER.sub("0", value))
            targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
            names += [target.id for target in targets if isinstance(target, ast.Name)]
    except (SyntaxError, ValueError, TypeError):
        return []
    return names


def _conforms(value: Any, allowed: type | Sequence[str]) -> bool:
    """Whether a parameter's value is what the schema allows."""
    if not isinstance(allowed, type):
        return isinstance(value, str) and value in allowed
    if allowed is float:
        return type(value) in (int, float) and math.isfinite(value)
    return type(value) is allowed


def _describe(allowed: type | Sequence[str]) -> str:
    """What the schema allows, in words."""
    if isinstance(allowed, type):
        return "a finite float" if allowed is float else f"of type {allowed.__name__}"
    return f"one of {', '.join(allowed)}"


def show(figure: Figure) -> None:
    """Display a figure as vector graphics; the same figure always gives the same bytes."""
    display(SVG(style.svg(figure)))


def show_picture(picture: np.ndarray) -> None:
    """Display a picture (H, W, 3)."""
    from silem.report import film as films

    display(DisplayedImage(data=films.encode_png(picture)))


def table(frame: pd.DataFrame, digits: int | None = None, caption: str = "") -> Styler:
    """Return a table of values in this project's look; a named index becomes its first column.

    Numbers that are not whole get `digits` after the point; with None they stay as they are.
    """

    def written(value: Any) -> str:
        if isinstance(value, bool | str) or not isinstance(value, Real):
            return html.escape(str(value))
        if digits is None or isinstance(value, Integral):
            return f"{value:,}".replace("-", "−")
        return style.number(round(float(value), digits) + 0.0, digits)  # never a negative zero

    named = frame.reset_index() if frame.index.name else frame
    return tables.styled(named.map(written), caption)


def play(clip: "Clip | None", caption: str) -> None:
    """Embed a clip as a video that needs no file beside the page; None: say that there is none."""
    if clip is None:
        return note(f"No video ({caption}): no run with a policy has been published yet.")
    from silem.report import film as films

    height, width = clip.frames.shape[1:3]
    poster = base64.b64encode(films.encode_png(clip.frames[len(clip.frames) // 2])).decode()
    video = base64.b64encode(films.encode_mp4(clip)).decode()
    text = html.escape(caption)
    page = (
        '<figure class="silem-clip">'
        f'<video controls loop muted playsinline width="{width}" height="{height}"'
        f' style="max-width: 100%; height: auto" aria-label="{text}"'
        f' poster="data:image/png;base64,{poster}">'
        f'<source type="video/mp4" src="data:video/mp4;base64,{video}"></video>'
        f"<figcaption>{text}</figcaption></figure>"
    )
    display(HTML(page))


def film(make: "Callable[[], Clip | None]", caption: str) -> "Clip | None":
    """Make, play and return a clip; where nothing can be drawn offscreen, say why instead."""
    from silem.report import film as films

    if why := films.why_no_pictures("Humanoid"):
        note(f"No video ({caption}): {why}")
        return None
    clip = make()
    play(clip, caption)
    return clip


def show_strip(clip: "Clip | None") -> None:
    """Show a clip on paper: equally spaced pictures of it; say so where there is none."""
    from silem.report import film as films

    note("No pictures: there is no clip.") if clip is None else show_picture(films.strip(clip))


def play_trials(
    records: pd.DataFrame, methods: Sequence[str], body: str, duration_s: float
) -> None:
    """Film the first trial of each method on a body, from one start and side by side.

    Its seed was fixed before any run was made. Whoever falls stands still from then on.
    """
    from silem.report import film as films

    runs = {}
    for method in methods:
        trials = results.cell(records[records["seed"].eq(TRIAL_SEEDS[0])], method, body)
        name = style.METHODS[method].short
        runs[name] = results.find(trials["run_id"].iloc[0]) if len(trials) else None
    told = [name if run else f"{name}: no run yet" for name, run in runs.items()]
    caption, made = f"{body}, first trials, in real time: {' | '.join(told)}", any(runs.values())
    film(lambda: films.grid(films.of_runs(runs, duration_s)) if made else None, caption)


def text(words: str) -> None:
    """Show sentences that were made from records, in Markdown."""
    display(Markdown(words))


def note(text: str) -> None:
    """Say on the page what is not there."""
    display(HTML(f"<p><em>{html.escape(text)}</em></p>"))


NO_RUNS = "silem-no-runs"
"""What a page's cell shows where `need_runs` found none."""


def need_runs(frame: pd.DataFrame, what: str) -> None:
    """Say in a banner if no run of a study is finished.

    The book leaves out the cells below that have the tag ``with-runs``, up to the next that asks.
    """
    if not frame.attrs.get("n_own", len(frame)):
        words = f"No run of {what} is finished; {len(frame.attrs['missing'])} are planned."
        words += " Figures, numbers and verdicts stand here from the first one on."
        display(HTML(f'<div class="admonition note {NO_RUNS}"><p>{html.escape(words)}</p></div>'))


def say(**values: float | str | np.ndarray | None) -> None:
    """Make numbers and texts available to the page's sentences, through ``{glue:text}`name` ``.

    Of an array, such as the scores of a cell's trials, that is the mean. None, NaN and an empty
    array, for what no run has shown yet, become a dash.
    """
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value = float(value.mean()) if len(value) else None
        if not isinstance(value, str):
            whole = value is None or math.isnan(value) or abs(value) >= 100 or value == int(value)
            value = style.number(value, 0 if whole else 2)
        glue(name, value, display=False)
