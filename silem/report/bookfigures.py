"""The figures that stand as files in the book and the README, and the texts generated beside them.

``python -m silem.report.bookfigures``, or ``make figures``, makes them anew from the committed
records. The same records give the same bytes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from matplotlib.figure import Figure

from silem.report import diagram, figures, glance, results, style
from silem.util.errors import SilemError
from silem.util.paths import REPO

FOLDER = REPO / "book" / "figures"


def halfcheetah() -> Figure:
    """Draw Figure 2b from the committed runs of the `book` budget."""
    return figures.normalised_scores(results.load_records("halfcheetah", "book"))


FIGURES: dict[str, Callable[[], Figure]] = {
    "method.svg": diagram.overview,
    "halfcheetah.svg": halfcheetah,
}
"""File name of each figure, and the function that draws it."""


def draw(folder: Path = FOLDER) -> list[Path]:
    """Draw every figure into a folder and return the files.

    Raises:
        SilemError: If the records that a figure needs are missing or damaged.
    """
    paths = []
    for name, function in FIGURES.items():
        style.save(function(), folder / name)
        paths.append(folder / name)
    return paths


def main() -> int:
    """Redraw the figures and rewrite the texts; return the exit status."""
    try:
        for path in (*draw(), *glance.write()):
            print(path.relative_to(REPO))
    except SilemError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
