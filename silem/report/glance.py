"""What README and the introduction begin with, written by `make figures` between their markers.

The box says which claims hold, which do not and which are undecided, and what stands behind that,
with a figure; the film's caption says how many trials do.
"""

import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from silem.report import claims, results, scores, style
from silem.report.pages import walking
from silem.report.scores import normalised_scores
from silem.report.web import BODIES
from silem.study.studies import STUDIES
from silem.util import files
from silem.util.errors import SilemError
from silem.util.paths import REPO

FAMILIES = {"halfcheetah": "HalfCheetah", "ant": "Ants", "humanoids": "Humanoids"}
"""The studies whose claims the box counts, and what to call their bodies."""
FIGURE = REPO / "book" / "figures" / "halfcheetah.svg"
_VERDICTS = [claims.HOLDS, claims.FAILS, claims.UNDECIDED]


def box(root: str = "") -> str:
    """Return the box as Markdown; `root` is the way from its page to the repository's root."""
    frames = [results.load_records(study, "book") for study in FAMILIES]
    return "\n\n".join(
        [
            "## At a glance",
            "A learner imitates an expert whose body is not its own: does SILEM, the paper's way to"
            " do that, do here what the paper claims? Each claim is judged [by a rule fixed before"
            f" its runs were complete]({root}notebooks/07_scorecard.ipynb), on the bodies that are"
            " named.",
            *map(_matrix, frames),
            _behind(frames),
            "![Left the normalised scores of SILEM and its ablation on three HalfCheetah bodies,"
            " minimum, mean and maximum over trials; right the forward speed of the same trials"
            f" and of the experts.]({root}{FIGURE.relative_to(REPO)})",
            "*Figure 2b from the committed runs, and the speed behind each score; empty slots are"
            " runs not made yet.*",
        ]
    )


def _matrix(frame: pd.DataFrame) -> str:
    """Return a table of the claims by verdict: in each cell the bodies that have it, and why."""
    found = claims.evaluate(frame)
    spans = found["reason"].str.contains("spans the bound")
    why = found["reason"].str.partition(":")[0].mask(spans, "interval spans the bound")
    title, body = ([getattr(claim, of) for claim in found["claim"]] for of in ("title", "body"))
    named = found.assign(title=title, body=body, why=why)
    named = named.groupby(["title", "verdict", "why"], sort=False)["body"].agg(", ".join)
    named = named.reset_index()
    named["body"] += named["why"].map(lambda words: f" ({words})" if words else "")
    table = named.groupby(["title", "verdict"])["body"].agg("; ".join).unstack(fill_value="")
    table = table.reindex(pd.unique(pd.Series(title)), columns=_VERDICTS, fill_value="")
    heads = [f"{verdict} ({(found['verdict'] == verdict).sum()})" for verdict in _VERDICTS]
    lines = [f"| {title} | {' | '.join(cells)} |" for title, *cells in table.itertuples()]
    study, _ = results.context(frame)
    name = f"{FAMILIES[study]}, {STUDIES[study].about}"
    head = f"**{name}: {len(found)} claims**\n\n| claim | {' | '.join(heads)} |\n"
    return head + "\n".join(["| --- | --- | --- | --- |", *lines])


def _behind(frames: list[pd.DataFrame]) -> str:
    """Say how many runs stand behind the verdicts, how many are planned, and what they cost."""
    cells = pd.concat(
        [results.trained(frame).groupby(["method", "body"]).size() for frame in frames]
    )
    low, high = (cells.min(), cells.max()) if len(cells) else (0, 0)
    spread = f"{low if low == high else f'{low} to {high}'} in each cell that has any"
    frames = frames + [f for f in map(results.paper_loss, frames) if f is not None]
    runs = results.joined(frames)
    done = len(results.trained(runs))
    missing = {r["run_id"] for f in frames for r in f.attrs["missing"] if r["method"] != "random"}
    hours = results.hours(results.trained(runs))
    return (
        f"Behind it stand {done} finished trainings of {done + len(missing)} planned ({spread})"
        f" and {hours}, on one processor core a run and no graphics card."
    )


def film(_: str = "") -> str:
    """Return the caption of README's film as Markdown."""
    frame = results.load_records("humanoids", "book")
    parts = [_trials(frame, method) for method in scores.COMPARED]
    return (
        "*SILEM's policy on dm_control's humanoid, learned from one clip of a man walking: no"
        " reward, no actions, no retargeting. One trial is filmed. Behind it:"
        f" {parts[0]}; its rivals: {'; '.join(parts[1:])}."
        f" `silem render {BODIES['Humanoid']} --out walk.mp4` films it again.*"
    )


def _trials(frame: pd.DataFrame, method: str) -> str:
    """Say how many trials of a method there are, on which bodies, and how many of them walk."""
    label, runs = style.method(method, "").label, results.trained(results.select(frame, [method]))
    if runs.empty:
        return f"{label} has no run"
    gaits = [walking.gait(*row) for row in zip(runs["upright"], runs["speed_m_s"], strict=True)]
    walk = sum(gait in (walking.WALKS, walking.SLOWER) for gait in gaits)
    counts = [f"{body} {count}" for body, count in runs.groupby("body").size().items()]
    return (
        f"{label} has {style.trials(len(runs))} on {len(counts)} of"
        f" {len(results.body_names(frame))} bodies ({', '.join(counts)}), of which {walk}"
        f" {'walks' if walk == 1 else 'walk'}"
    )


_BLOCKS: dict[str, Callable[[str], str]] = {"at a glance": box, "film": film}
PAGES = {REPO / "README.md": "", REPO / "book" / "intro.md": "../"}
"""The pages with markers, and the way from each to the repository's root."""


def filled(page: Path) -> str:
    """Return a page's text with every generated block as it has to be now."""

    def block(found: re.Match[str]) -> str:
        return f"{found[1]}\n{_BLOCKS[found[2]](PAGES.get(page, ''))}\n{found[3]}"

    names = "|".join(_BLOCKS)
    pattern = rf"(<!-- ({names}): begin -->).*?(<!-- \2: end -->)"
    text, n_blocks = re.subn(pattern, block, page.read_text(), flags=re.DOTALL)
    if n_blocks != len(re.findall(r"<!-- [\w ]+: begin -->", text)) or not n_blocks:
        raise SilemError(f"{page.name}: a generated block is missing or has no end")
    return text


def figure() -> str:
    """Return the box's figure as SVG: same records, same text."""
    return style.svg(normalised_scores(results.load_records("halfcheetah", "book")))


def write() -> list[Path]:
    """Write the figure, and every generated block into its page; return the files."""
    written = {FIGURE: figure()} | {page: filled(page) for page in PAGES}
    for path, text in written.items():
        files.write_text(path, text)
    return list(written)
