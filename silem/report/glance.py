"""What README and the introduction begin with, written by `make figures` between their markers.

A summary in three sentences; the claims that hold, that do not and that are undecided, and what
stands behind that, with a figure; and the film's caption. Their words are in ``glance.toml``.
"""

import re
import tomllib
from pathlib import Path
from typing import Any

import pandas as pd

from silem.bodies.body import MAX_STEPS
from silem.bodies.humanoid import DEMONSTRATOR_SPEED_M_S
from silem.report import claims, results, scores, style, tables
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
_TEXTS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_VERDICTS = [claims.HOLDS, claims.FAILS, claims.UNDECIDED]


def blocks(root: str = "") -> dict[str, str]:
    """Return each block as Markdown; `root` is the way from its page to the repository's root."""
    frames = {study: results.load_records(study, "book") for study in FAMILIES}
    runner, humanoid = frames["halfcheetah"], frames["humanoids"]
    found = pd.concat(map(claims.evaluate, frames.values()))
    values: dict[str, Any] = {"root": root, "n_claims": len(found), "steps": f"{MAX_STEPS:,}"}
    counts = found["verdict"].value_counts().reindex(_VERDICTS, fill_value=0)
    values |= dict(zip(("n_hold", "n_fail", "n_undecided"), counts, strict=True))
    values["n_few"] = found["reason"].str.startswith("too few").sum()
    for name, method in (("silem", "silem"), ("minus", "silem-minus")):
        values[f"{name}_scores"] = _means(runner, method, "normalised", 2)
        values[f"{name}_returns"] = _means(humanoid, method, "return_mean", 0)
    values["same"] = ", ".join(
        f"{tables.same_settings(runner, body)} on {body}" for body in ("HC1", "HC2")
    )
    values["unpenalised_upright"] = walking.without_penalty(humanoid, "upright")
    values["unpenalised_returns"] = walking.without_penalty(runner, "return_mean")
    values["tables"] = "\n\n".join(map(_matrix, frames.values()))
    values |= _behind(list(frames.values()))
    values |= {"walks": _walks(humanoid), "man": DEMONSTRATOR_SPEED_M_S, "run": BODIES["Humanoid"]}
    return {name: text.strip().format(**values) for name, text in _TEXTS.items()}


def _means(frame: pd.DataFrame, method: str, column: str, digits: int) -> str:
    """Write a method's mean over trials on each body."""
    cells = ((body, results.cell(frame, method, body)) for body in results.body_names(frame))
    return ", ".join(f"{style.number(runs[column].mean(), digits)} on {b}" for b, runs in cells)


def _matrix(frame: pd.DataFrame) -> str:
    """Return a study's claims with the bodies on which they hold and do not; folded, the others."""
    found = claims.evaluate(frame)
    spans = found["reason"].str.contains("spans the bound")
    why = found["reason"].str.partition(":")[0].mask(spans, "interval spans the bound")
    title = [c.title + " on the body named" * c.title.endswith(" than") for c in found["claim"]]
    named = found.assign(title=title, body=[claim.body for claim in found["claim"]], why=why)
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


def _behind(frames: list[pd.DataFrame]) -> dict[str, Any]:
    """Count the runs behind the verdicts, and what is planned, and say what they cost."""
    cells = [results.trained(frame).groupby(["method", "body"]).size() for frame in frames]
    frames = frames + [f for f in map(results.paper_loss, frames) if f is not None]
    runs = results.trained(results.joined(frames))
    missing = {r["run_id"] for f in frames for r in f.attrs["missing"] if r["method"] != "random"}
    counts = {"n_done": len(runs), "n_planned": len(runs) + len(missing)}
    return counts | {"spread": style.span(pd.concat(cells)), "hours": results.hours(runs)}


def _walks(frame: pd.DataFrame) -> str:
    """Say how many trials of each method walk on humanoids, how fast, and what they return."""
    told = []
    for method in scores.COMPARED:
        runs = results.select(frame, [method])
        gaits = [walking.gait(*row) for row in zip(runs["upright"], runs["speed_m_s"], strict=True)]
        walk = sum(gait in (walking.WALKS, walking.SLOWER) for gait in gaits)
        means = f"{style.number(runs['speed_m_s'].mean(), 2)} m/s, return"
        means = f"{walk} of {len(runs)} ({means} {style.number(runs['return_mean'].mean())})"
        told.append(f"{style.method(method, '').label} {means if gaits else 'no run'}")
    return "; ".join(told)


PAGES = {REPO / "README.md": "", REPO / "book" / "intro.md": "../"}
"""The pages with markers, and the way from each to the repository's root."""


def filled(page: Path) -> str:
    """Return a page's text with every generated block as it has to be now."""
    made = blocks(PAGES.get(page, ""))
    pattern = rf"(<!-- ({'|'.join(made)}): begin -->).*?(<!-- \2: end -->)"
    text, n_blocks = re.subn(
        pattern, lambda m: f"{m[1]}\n{made[m[2]]}\n{m[3]}", page.read_text(), flags=re.DOTALL
    )
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
