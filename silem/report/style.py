"""One look for every figure: sizes, colours and names of the methods, and deterministic SVG.

Figures are `matplotlib.figure.Figure` objects, never pyplot's, so drawing one leaves no state
behind. The colours are Okabe and Ito's, which stay apart under the common colour blindnesses;
markers repeat what colour says.
"""

import io
import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from silem.util.errors import choose

WIDTH_IN = 7.6
"""Width of a figure that fills the book's text column, inches."""

INK = "#222222"
MUTED = "#6b6b6b"
FAINT = "#d9d9d9"
PAPER = "#E69F00"
"""Colour of the paper's own numbers."""

GHOST, WITHOUT_GHOSTS = "paper", "without-paper"
"""The name of what an SVG shows of the paper's numbers, and the fragment that hides it."""

_HIDING = f"<style>svg:target [id^='{GHOST}'] {{ visibility: hidden }}</style>"
WARNING = "#B3261E"
DASHED: Any = (0, (4, 3))
"""The line of a level that something is held against."""

DASH = "–"
"""What stands where there is no number."""

_CHARACTERS_PER_IN = 16.0  # of the footer's small print

_SHEET = mpl.rc_params_from_file(
    Path(__file__).with_name("silem.mplstyle"), use_default_template=False
)


class MethodStyle(NamedTuple):
    """How a method is called and drawn, the same everywhere."""

    short: str
    label: str
    color: str
    marker: str


METHODS = {
    "silem": MethodStyle("SILEM", "SILEM", "#0072B2", "o"),
    "silem-minus": MethodStyle("SILEM⁻", "SILEM⁻ ({original} expert)", "#D55E00", "s"),
    "silem-minus-own": MethodStyle("SILEM⁻ own", "SILEM⁻ (own expert)", "#009E73", "^"),
    "silem-mlp": MethodStyle("MLP", "SILEM with an MLP", "#CC79A7", "D"),
    "tpil": MethodStyle("TPIL", "TPIL", "#56B4E9", "v"),
    "peng20": MethodStyle("Peng20", "Peng20", "#882255", "d"),
    "ppo": MethodStyle("PPO", "PPO expert", "#444444", "P"),
    "random": MethodStyle("random", "random policy", "#999999", "X"),
}


class Quantity(NamedTuple):
    """How what is measured is called in tables, figures and claims, and with how many digits."""

    heading: str
    digits: int = 2


QUANTITIES = {
    "return_mean": Quantity("return", 0),
    "returns": Quantity("return", 0),
    "normalised": Quantity("score"),
    "best": Quantity("score, best expert"),
    "episode_length": Quantity("steps before a fall", 0),
    "steps": Quantity("steps of an episode", 0),
    "upright": Quantity("share of steps upright"),
    "disc_reward": Quantity("discriminator reward", 0),
    "speed_m_s": Quantity("speed (m/s)"),
    "disc_acc_expert": Quantity("discriminator accuracy"),
    "policy_std": Quantity("policy's standard deviation"),
    "wall_time_min": Quantity("wall time (min)", 1),
    "apart": Quantity("maps apart (%)", 0),
    "step_hz": Quantity("steps/s"),
    "stance": Quantity("stance"),
    "clearance_m": Quantity("clearance (m)"),
    "symmetry": Quantity("symmetry"),
    "features": Quantity("from his features"),
    "movement": Quantity("from his movement"),
}
"""What is measured, by the columns of records, of their curves, and of what is made of them."""

# Where a human demonstrates, no expert's body needs naming, and PPO on the true reward is no expert
# that anybody imitates.
_WITHOUT_EXPERT = {"silem-minus": "SILEM⁻", "ppo": "PPO, true reward"}

# Bodies of a family differ in one length, so their colours run from light to dark.
_LIGHT, _DARK = np.array([0.80, 0.74, 0.90]), np.array([0.25, 0.07, 0.42])


def method(name: str, original: str = "HC0") -> MethodStyle:
    """Return a method's style; an unknown method is a SilemError.

    Its label names the body whose expert demonstrates to the others, "" where a human does.
    """
    chosen = METHODS[choose("method", name, METHODS)]
    label = chosen.label if original else _WITHOUT_EXPERT.get(name, chosen.label)
    return chosen._replace(label=label.format(original=original))


def body_color(index: int, count: int) -> str:
    """Return the colour of body `index` of `count`, light to dark."""
    return to_hex(_LIGHT + index / max(count - 1, 1) * (_DARK - _LIGHT))


@contextmanager
def applied() -> Iterator[None]:
    """Draw a block, or as ``@applied()`` a function, in this look; the old one comes back."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_SHEET)
        yield


def new_figure(height_in: float, width_in: float = WIDTH_IN, **subplots: Any) -> tuple[Figure, Any]:
    """Return a figure of some inches with constrained layout, and its axes (`Figure.subplots`)."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    return figure, figure.subplots(**subplots)


def panels(
    titles: Iterable[str], row_in: float, n_columns: int = 2, **subplots: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure with a panel for each title, in rows of some inches (small multiples)."""
    named = list(titles)
    n_columns = min(n_columns, len(named))
    size: dict[str, Any] = {"nrows": -(-len(named) // n_columns), "ncols": n_columns}
    figure, grid = new_figure(row_in * size["nrows"] + 0.4, squeeze=False, **size, **subplots)
    for axes, title in zip(grid.flat, named, strict=False):
        axes.set_title(title)
    for axes in list(grid.flat)[len(named) :]:
        axes.set_axis_off()
    for axes in list(grid.flat)[max(0, len(named) - n_columns) : len(named)]:
        axes.tick_params(labelbottom=True)
    return figure, list(grid.flat)[: len(named)]


def finish(
    figure: Figure,
    handles: Sequence[Any] = (),
    note: str = "",
    ncols: int = 3,
    *,
    warn: bool = False,
    word: str = "no run",
) -> Figure:
    """Put a legend, read by rows, above a figure and small print under it, in red to warn.

    A panel in which nothing is drawn says so by a word, and an empty one has no scale of its own.
    """
    for axes in (axes for axes in figure.axes if axes.axison and not _has_data(axes)):
        if not axes.texts:
            say(axes, word)
        shared = axes.get_shared_x_axes(), axes.get_shared_y_axes()
        for axis, sharing in zip((axes.xaxis, axes.yaxis), shared, strict=True):
            if not any(map(_drawn, sharing.get_siblings(axes))):
                axis.set_ticks([])
    if handles:
        by_rows = [h for column in range(ncols) for h in handles[column::ncols]]
        figure.legend(handles=by_rows, loc="outside upper left", ncols=ncols)
    if note:
        lines = textwrap.fill(note, int(_CHARACTERS_PER_IN * figure.get_figwidth()))
        look: dict[str, Any] = {"color": WARNING if warn else MUTED, "linespacing": 1.4}
        figure.supxlabel(lines, x=0.01, ha="left", fontsize=8, **look)
    return figure


def _drawn(axes: Axes) -> list[Artist]:
    return [*axes.lines, *axes.collections, *axes.patches, *axes.images]


def _has_data(axes: Axes) -> bool:
    """Tell whether anything is drawn at data's places: levels and bands alone are nothing."""
    places = (a.get_transform().contains_branch_seperately(axes.transData) for a in _drawn(axes))
    return any(map(all, places))


def handle(color: str, label: str, **look: Any) -> Line2D:
    """Return an entry of a legend."""
    return Line2D([], [], color=color, label=label, **look)


def marks(looks: Iterable[MethodStyle]) -> list[Line2D]:
    """Return a legend's entries for methods, each with its marker."""
    look: dict[str, Any] = {"ls": "none", "mec": "white", "ms": 8}
    return [handle(m.color, m.label, marker=m.marker, **look) for m in looks]


def say(axes: Axes, word: str) -> None:
    """Write a word in the middle of an empty panel."""
    middle: dict[str, Any] = {"transform": axes.transAxes, "ha": "center", "va": "center"}
    axes.text(0.5, 0.5, word, color=MUTED, backgroundcolor="white", **middle)


def empty_slot(axes: Axes, x: float, text: str = "no run") -> None:
    """Mark a cell without a run: a dashed outline of the slot with a word in it."""
    place: dict[str, Any] = {"transform": axes.get_xaxis_transform()}
    axes.plot([x, x], [0.18, 0.94], color=FAINT, lw=1, ls=(0, (2, 3)), **place)
    place |= {"rotation": 90, "ha": "center", "va": "center", "fontsize": 8, "color": MUTED}
    axes.text(x, 0.56, text, bbox={"facecolor": "white", "edgecolor": "none", "pad": 2}, **place)


def number(value: float | None, digits: int | None = 0) -> str:
    """Write a number with thousands separated and a true minus; a dash where there is none.

    With None for the digits it is as short as it can be.
    """
    if value is None or np.isnan(value):
        return DASH
    text = f"{value:,g}".replace("e-0", "e-") if digits is None else f"{value:,.{digits}f}"
    return text.replace("-", "−").replace("inf", "∞")


def span(values: Iterable[float], digits: int = 0) -> str:
    """Write the least and the greatest of numbers, "2 to 5"; "2" if equal, a dash for none."""
    known = [value for value in values if not np.isnan(value)]
    ends = [number(end, digits) for end in (min(known), max(known))] if known else [DASH]
    return " to ".join(dict.fromkeys(ends))


def estimate(value: float, ends: tuple[float, float], digits: int = 0) -> str:
    """Write a number with its interval, "3 [1 to 5]", and without one that is not known."""
    return number(value, digits) + ("" if np.isnan(ends).any() else f" [{span(ends, digits)}]")


def trials(count: int) -> str:
    """Say how many trials there are: "no run", "one trial", "5 trials"."""
    return {0: "no run", 1: "one trial"}.get(count, f"{count} trials")


def svg(figure: Figure) -> str:
    """Return a figure as SVG text, the paper's own numbers named; same figure, same text."""
    for line in figure.findobj(Line2D):
        if line.get_color() == PAPER:
            line.set_gid(GHOST)
    for legend in figure.legends:
        for mark, label in zip(legend.legend_handles, legend.get_texts(), strict=True):
            if mark is not None and mark.get_gid() == GHOST:
                label.set_gid(GHOST)
    stream = io.StringIO()
    with applied():
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    # The XML prologue is of no use inside a page.
    text = re.sub(r"^.*?(?=<svg)", "", stream.getvalue(), count=1, flags=re.DOTALL)
    if f'id="{GHOST}' in text:
        text = re.sub(r"<svg ([^>]*)>", rf'<svg id="{WITHOUT_GHOSTS}" \1>{_HIDING}', text, count=1)
    return text
