"""What README and the introduction begin with, written by `make figures` between their markers.

The box says which claims hold, which do not and which are undecided, and what stands behind that;
the film's caption says how many trials do.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from silem.report import claims, results, scorecard, style
from silem.report.pages import walking
from silem.util import files
from silem.util.errors import SilemError
from silem.util.paths import REPO

STUDIES = {
    "halfcheetah": "HalfCheetah, Figure 2b and Table 1",
    "humanoids": "Humanoids, Figures 3b, 4a and 4b",
}
FILM = "silem_Humanoid_from_cmu_08_01_book_s0_b5918e5b"
"""The run that README films."""


def box(root: str = "") -> str:
    """Return the box as Markdown.

    Args:
        root: Way from the page to the repository's root, e.g. ``"../"``.
    """
    frames = [results.load_records(study, "book") for study in STUDIES]
    judged = {}
    for (study, name), frame in zip(STUDIES.items(), frames, strict=True):
        judged[f"{name}: {len(claims.of(study))} claims"] = scorecard.evaluate(frame)
    frames += [other for f in frames if (other := results.paper_loss(f)) is not None]
    where = f"[by a rule fixed before its runs were complete]({root}notebooks/07_scorecard.ipynb)"
    return "\n".join(
        [
            "## At a glance", "",
            "A learner imitates an expert whose body is not its own: does SILEM, the paper's way to"
            f" do that, do here what the paper claims? Each claim is judged {where}, on the bodies"
            " that are named.", "",
            *(line for name, found in judged.items() for line in _matrix(name, found)),
            _behind(frames), "",
            f"![{_ALT}]({root}book/figures/halfcheetah.svg)", "",
            "*Figure 2b from the committed runs, and the speed behind each score; empty slots are"
            " runs not made yet.*",
        ]
    )  # fmt: skip


_ORDER = (claims.HOLDS, claims.FAILS, claims.UNDECIDED)
_ALT = (
    "Left the normalised scores of SILEM and its ablation on three HalfCheetah bodies, minimum,"
    " mean and maximum over trials; right the forward speed of the same trials and of the experts."
)


def _matrix(name: str, found: pd.DataFrame) -> list[str]:
    """Return a table of the claims by verdict: in each cell the bodies that have it, and why."""
    rows: dict[str, dict[str, list[str]]] = {}
    for row in found.itertuples():
        cells = rows.setdefault(row.claim.title, {verdict: [] for verdict in _ORDER})
        why = "interval spans the bound" if "spans" in row.reason else row.reason.partition(":")[0]
        cells[row.verdict].append(f"{row.claim.body}, {why}" if why else row.claim.body)
    heads = [f"{verdict} ({(found['verdict'] == verdict).sum()})" for verdict in _ORDER]
    lines = [f"**{name}**", "", f"| claim | {' | '.join(heads)} |", "| --- | --- | --- | --- |"]
    for title, cells in rows.items():
        words = [_grouped(names) for names in cells.values()]
        lines.append(f"| {title} | {' | '.join(words)} |")
    return [*lines, ""]


def _grouped(names: list[str]) -> str:
    """Join bodies, and write a reason that several share once."""
    groups: dict[str, list[str]] = {}
    for name in names:
        body, _, why = name.partition(", ")
        groups.setdefault(why, []).append(body)
    return "; ".join(
        ", ".join(bodies) + (f" ({why})" if why else "") for why, bodies in groups.items()
    )


def _behind(frames: list[pd.DataFrame]) -> str:
    """Say how many runs stand behind the verdicts, how many are planned, and what they cost."""
    runs = pd.concat([f for f in frames if len(f)] or frames[:1]).drop_duplicates("run_id")
    trained = runs[runs["method"] != "random"]
    done = int((~trained["stand_in"]).sum())
    missing = {r["run_id"] for f in frames for r in f.attrs["missing"] if r["method"] != "random"}
    cells = [
        len(group)
        for frame in frames[: len(STUDIES)]
        for _, group in frame[~frame["stand_in"]].groupby(["method", "body"])
        if group["method"].iloc[0] != "random"
    ]
    low, high = (min(cells), max(cells)) if cells else (0, 0)
    spread = f"{low if low == high else f'{low} to {high}'} in each cell that has any"
    hours = trained["wall_time_s"].sum() / 3600
    return (
        f"Behind it stand {done} finished trainings of {done + len(missing)} planned ({spread}) and"
        f" {hours:.0f} hours by the clock on one processor core a run, no graphics card."
    )


def film(_: str = "") -> str:
    """Return the caption of README's film as Markdown."""
    frame = results.load_records("humanoids", "book")
    parts = []
    for method in ("silem", "silem-minus"):
        runs = frame[(frame["method"] == method) & ~frame["stand_in"]]
        gaits = [walking.gait(*row) for row in zip(runs["upright"], runs["speed_m_s"], strict=True)]
        walk = sum(gait in (walking.WALKS, walking.SLOWER) for gait in gaits)
        counts = [f"{body} {len(group)}" for body, group in runs.groupby("body")]
        label = style.method(method, "").label
        parts.append(
            f"{label} has {style.trials(len(runs))} on {len(counts)} of"
            f" {len(results.body_names(frame))} bodies ({', '.join(counts)}), of which {walk}"
            f" {'walks' if walk == 1 else 'walk'}"
            if len(runs)
            else f"{label} has no run"
        )
    return (
        "*SILEM's policy on dm_control's humanoid, learned from one clip of a man walking: no"
        " reward, no actions, no retargeting. One trial is filmed. Behind it:"
        f" {parts[0]}; without the transform, {parts[1]}."
        f" `silem render {FILM} --out walk.mp4` films it again.*"
    )


_BLOCKS: dict[str, Callable[[str], str]] = {"at a glance": box, "film": film}
PAGES = {REPO / "README.md": "", REPO / "book" / "intro.md": "../"}
"""The pages with markers, and the way from each to the repository's root."""


def filled(page: Path) -> str:
    """Return a page's text with every generated block as it has to be now.

    Raises:
        SilemError: The page has no block, or one without its end.
    """
    text, n_blocks = page.read_text(), 0
    for name, write in _BLOCKS.items():
        begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
        if begin in text:
            block = f"{begin}\n{write(PAGES.get(page, ''))}\n{end}"
            pattern = f"{re.escape(begin)}.*?{re.escape(end)}"
            parts = re.split(pattern, text, flags=re.DOTALL)
            text, n_blocks = block.join(parts), n_blocks + len(parts) - 1
    if n_blocks != len(re.findall(r"<!-- [\w ]+: begin -->", text)) or not n_blocks:
        raise SilemError(f"{page.name}: a generated block is missing or has no end")
    return text


def write() -> list[Path]:
    """Write every generated block into its page, and return the pages."""
    for page in PAGES:
        files.write_text(page, filled(page))
    return list(PAGES)
