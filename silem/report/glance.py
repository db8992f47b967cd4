"""What README and the introduction begin with, written by `make figures` between their markers.

A summary in three sentences; the claims that hold, that do not and that are undecided, and what
stands behind that, with a figure; and the film's caption.
"""

import re
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from silem.bodies.body import MAX_STEPS
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.report import claims, results, scores, style
from silem.report.pages import walking
from silem.report.scores import normalised_scores
from silem.report.web import BODIES
from silem.study.studies import BOTH, STUDIES
from silem.util import files
from silem.util.errors import SilemError
from silem.util.paths import REPO

FAMILIES = {"halfcheetah": "HalfCheetah", "ant": "Ants", "humanoids": "Humanoids"}
"""The studies whose claims the box counts, and what to call their bodies."""
FIGURE = REPO / "book" / "figures" / "halfcheetah.svg"
_VERDICTS = [claims.HOLDS, claims.FAILS, claims.UNDECIDED]


def summary(root: str = "") -> str:
    """Return in three sentences what came out; `root` is the way from its page to the root."""
    studies = _studies()
    found = pd.concat(map(claims.evaluate, studies.values()))
    hold, fail, undecided = ((found["verdict"] == verdict).sum() for verdict in _VERDICTS)
    few = found["reason"].str.startswith("too few").sum()
    runner, humanoid = studies["halfcheetah"], studies["humanoids"]
    told = [_means(runner, method, "normalised", 2) for method in BOTH]
    told += [_means(humanoid, method, "return_mean", 0) for method in BOTH]
    return (
        "## At a glance\n\nA learner imitates an expert whose body is not its own: does SILEM do"
        f" what its paper claims? Of [{len(found)} claims]({root}notebooks/07_scorecard.ipynb),"
        f" each judged by a rule fixed before its runs were complete, **{hold} hold, {fail} do not"
        f" and {undecided} are undecided**, {few} of these for want of trials.\n\nOn HalfCheetah"
        f" SILEM scores {told[0]}, where the body's own experts score 1; SILEM⁻, the same without"
        f" the transform, {told[1]}. On humanoids SILEM returns {told[2]} of at most {MAX_STEPS:,},"
        f" and SILEM⁻ {told[3]}.\n\nAll that is with a gradient penalty of the discriminator that is"
        f" ours and not the paper's. Without it SILEM survives, of {MAX_STEPS:,} steps,"
        f" {walking.without_penalty(humanoid, 'upright', MAX_STEPS)}, and returns"
        f" {walking.without_penalty(runner, 'return_mean')}."
    )


def _studies() -> dict[str, pd.DataFrame]:
    return {study: results.load_records(study, "book") for study in FAMILIES}


def _means(frame: pd.DataFrame, method: str, column: str, digits: int) -> str:
    """Write a method's mean over trials on each body."""
    cells = ((body, results.cell(frame, method, body)) for body in results.body_names(frame))
    return ", ".join(f"{style.number(runs[column].mean(), digits)} on {b}" for b, runs in cells)


def box(root: str = "") -> str:
    """Return the claims by verdict as Markdown, and what stands behind them, with a figure."""
    frames = list(_studies().values())
    empty = "; empty slots are runs not made yet" * bool(frames[0].attrs["missing"])
    return "\n\n".join(
        [
            "## The claims",
            *map(_matrix, frames),
            _behind(frames),
            "![Left the normalised scores of SILEM and its ablation on three HalfCheetah bodies,"
            " minimum, mean and maximum over trials; right the forward speed of the same trials"
            f" and of the experts.]({root}{FIGURE.relative_to(REPO)})",
            f"*Figure 2b from the committed runs, and the speed behind each score{empty}.*",
        ]
    )


def _matrix(frame: pd.DataFrame) -> str:
    """Return a study's claims with the bodies on which they hold and do not; folded, the others."""
    found = claims.evaluate(frame)
    spans = found["reason"].str.contains("spans the bound")
    why = found["reason"].str.partition(":")[0].mask(spans, "interval spans the bound")
    title, body = ([getattr(claim, of) for claim in found["claim"]] for of in ("title", "body"))
    title = [f"{text} on the body named" if text.endswith(" than") else text for text in title]
    named = found.assign(title=title, body=body, why=why)
    named = named.groupby(["title", "verdict", "why"], sort=False)["body"].agg(", ".join)
    named = named.reset_index()
    named["body"] += named["why"].map(lambda words: f" ({words})" if words else "")
    table = named.groupby(["title", "verdict"])["body"].agg("; ".join).unstack()
    table = table.reindex(index=dict.fromkeys(title), columns=_VERDICTS)
    count = found["verdict"].value_counts().reindex(_VERDICTS, fill_value=0)
    study, _ = results.context(frame)
    text = f"**{FAMILIES[study]}, {STUDIES[study].about}: {len(found)} claims**"
    for columns in (_VERDICTS[:2], _VERDICTS[2:]):
        rows = table[columns].dropna(how="all").fillna("")
        heads = " | ".join(f"{verdict} ({count[verdict]})" for verdict in columns)
        part = f"| claim | {heads} |\n| --- |{' --- |' * len(columns)}"
        part += "".join(f"\n| {' | '.join(row)} |" for row in rows.itertuples())
        folded = f"<details><summary>{heads}</summary>\n\n{part}\n\n</details>"
        text += f"\n\n{folded if columns == _VERDICTS[2:] else part}" * bool(len(rows))
    return text


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
    return (
        "*SILEM's policy on dm_control's humanoid, learned from one clip of a man walking: no"
        " reward, no actions, no retargeting. It is one trial."
        f" {_walks(results.load_records('humanoids', 'book'))}"
        f" `silem render {BODIES['Humanoid']} --out walk.mp4` films it again.*"
    )


def _walks(frame: pd.DataFrame) -> str:
    """Say how many trials of each method walk on humanoids, how fast, and what they return."""
    told = []
    for method in scores.COMPARED:
        runs = results.select(frame, [method])
        gaits = [walking.gait(*row) for row in zip(runs["upright"], runs["speed_m_s"], strict=True)]
        walk = sum(gait in (walking.WALKS, walking.SLOWER) for gait in gaits)
        means = f"{style.number(runs['speed_m_s'].mean(), 2)} m/s, return"
        means = f"{walk} of {len(runs)} ({means} {style.number(runs['return_mean'].mean())})"
        means = means if gaits else "no run"
        told.append(f"{style.method(method, '').label} {means}")
    return (
        f"Trials that walk, on {', '.join(results.body_names(frame))}, with the means of all:"
        f" {'; '.join(told)}. The man's speed is {DEMONSTRATOR_SPEED_M_S:.2f} m/s."
    )


_BLOCKS: dict[str, Callable[[str], str]] = {"at a glance": summary, "claims": box, "film": film}
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
