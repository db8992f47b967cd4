"""The slider, what stands under figures, and the PDF, in a browser without a network."""

from __future__ import annotations

import base64
import gzip
import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page

from silem.report import pdf, results, scores, style, web
from silem.report.pages.slider import LEARNING, learning_pack, records
from silem.study.runs import CURVE
from silem.study.studies import STUDIES
from silem.util import files

pytestmark = pytest.mark.xdist_group("book")

HEAD = "<!doctype html><meta charset=utf-8><link rel=stylesheet href=_static/web.css>"
HEAD += "<script src=_static/silem.js></script>"
SLIDER = (
    f"{HEAD}<div id=silem-learning class=silem-web></div><script src=_static/slider.js></script>"
)
MOVE = "(slider, row) => { slider.value = row; slider.dispatchEvent(new Event('input')); }"
RUN = web.BODIES["Humanoid"]

Open = Callable[[str], Page]


@pytest.fixture
def opened(site: Path, browser: Browser) -> Iterator[Open]:
    """Open a page that a test writes, beside the scripts and without a network."""
    context = browser.new_context(offline=True, viewport={"width": 1000, "height": 800})

    def write_and_open(text: str) -> Page:
        (site / "written.html").write_text(text)
        page = context.new_page()
        page.on("pageerror", lambda error: pytest.fail(str(error)))
        page.goto((site / "written.html").as_uri())
        return page

    yield write_and_open
    context.close()


# ---------------------------------------------------------------- the slider


def test_the_slider_moves_through_a_runs_record(opened: Open) -> None:
    page = opened(SLIDER)
    page.locator("[data-state=ready]").wait_for()
    page.get_by_label("Study").select_option("humanoids")
    assert page.get_by_label("Run", exact=True).input_value() == RUN
    assert page.locator("video").count() == 0
    curve = results.load_curve(RUN)
    shown = page.locator(".silem-panel-one", has_text="Return of an episode").locator("output")
    for row in (0, len(curve) // 2, len(curve) - 1):
        page.get_by_role("slider", name="Iteration").evaluate(MOVE, row)
        assert float(shown.inner_text().replace(",", "")) == round(curve["return_mean"][row])
        assert (
            f"iteration {curve['iteration'][row]:,.0f} of"
            in page.locator(".silem-play").inner_text()
        )
    # the transform that the run ended with
    learned = results.load_transform(RUN)
    assert page.locator(".silem-bar").count() == learned["A"].size + learned["b"].size
    said = page.locator(".silem-bar title").evaluate_all("all => all.map(one => one.textContent)")
    values = [float(text.rpartition(" ")[2].replace("−", "-")) for text in said]
    np.testing.assert_allclose(values, np.concatenate([learned["A"], learned["b"]]), atol=6e-4)


def test_film_and_transform_change_at_the_checkpoints(opened: Open, site: Path) -> None:
    (run_id,) = [path.name for path in LEARNING.iterdir()]
    page = opened(SLIDER)  # it begins with the run that was filmed
    page.locator("[data-state=ready]").wait_for()
    assert page.get_by_label("Run", exact=True).input_value() == run_id
    curve, shown = results.load_curve(run_id), page.locator(".silem-film video[controls]")
    films = sorted(int(path.stem) for path in (LEARNING / run_id).glob("*.mp4"))
    learned = files.read_npz(LEARNING / run_id / "transforms.npz")
    assert films[0] == 0 and films[-1] == curve["iteration"].iloc[-1] and len(films) > 3
    slider, bar = page.get_by_role("slider", name="Iteration"), page.locator(".silem-bar title")
    for iteration in (1, films[1] - 1, films[1], films[-1]):
        row = int((curve["iteration"] <= iteration).sum() - 1) if iteration > 1 else 0
        at = curve["iteration"][row]
        slider.evaluate(MOVE, row)
        before = max(one for one in films if one <= at)
        assert (shown.get_attribute("src") or "").endswith(f"films/{run_id}/{before}.mp4")
        assert (shown.get_attribute("poster") or "").endswith(f"films/{run_id}/{before}.jpg")
        loaded = "film => film.play().then(() => film.pause()).then(() => film.videoWidth)"
        assert shown.evaluate(loaded) > 0
        known = int((learned["iteration"] <= at).sum() - 1)
        text = bar.first.text_content() or ""
        scale = float(text.rpartition(" ")[2].replace("−", "-"))
        assert scale == pytest.approx(float(learned["A"][known][0]), abs=6e-4)
    said = page.locator(".silem-film").inner_text()
    assert run_id in said and f"return {curve['return_mean'].iloc[-1]:,.0f}" in said


def test_the_slider_plays_compares_and_leaves_out_what_a_run_has_not(opened: Open) -> None:
    page = opened(SLIDER)
    page.locator("[data-state=ready]").wait_for()
    page.get_by_label("Study").select_option("halfcheetah")
    expert = results.cell(results.load_records("halfcheetah", "book"), "ppo", "HC0")
    page.get_by_label("Run", exact=True).select_option(expert["run_id"].iloc[0])
    assert page.locator(".silem-bar").count() == 0  # it has no T
    assert page.locator(".silem-panel-one", has_text="Discriminator").count() == 0
    other = page.get_by_label("Compare with")
    other.select_option(index=2)
    assert page.locator(".silem-second").count() == page.locator(".silem-panel-one").count()
    page.get_by_role("button", name="Play").click()
    count = page.locator(".silem-play output")
    first = count.inner_text()
    page.wait_for_function(
        "text => document.querySelector('.silem-play output').textContent !== text", arg=first
    )
    page.get_by_role("button", name="Pause").click()


def test_the_packs_hold_every_published_curve() -> None:
    of_studies = (record for record in records() if record.config["study"] in STUDIES)
    found = [record for record in of_studies if CURVE in record.files]
    assert len(found) > 30
    pack = learning_pack()
    runs = json.loads(gzip.decompress(pack))["runs"]
    assert len(runs) == len(found) and all(runs[0]["curve"].values())
    # readers can tell the runs of a body apart
    assert len({(run["study"], run["body"], run["label"]) for run in runs}) == len(runs)


# ---------------------------------------------------------------- under a figure


@pytest.fixture(scope="module")
def experts() -> pd.DataFrame:
    return results.load_records("halfcheetah", "book")


def figure_page(site: Path, frame: pd.DataFrame) -> str:
    (site / "_images").mkdir(exist_ok=True)
    (site / "_images" / "experts.svg").write_text(style.svg(scores.experts(frame)))
    web.finish(site)
    trace = results.trace(scores.runs_of("experts", frame)).data
    figure = "<figure><img width=800 src=_images/experts.svg></figure>"
    return f"{HEAD}<div class=cell>{figure}</div><div class=cell>{trace}</div>"


def test_a_figure_comes_with_data_picture_and_commands(
    site: Path, opened: Open, experts: pd.DataFrame
) -> None:
    page = opened(figure_page(site, experts))
    shown = scores.runs_of("experts", experts)
    with page.expect_download() as download:
        page.get_by_role("link", name="data (CSV)").click()
    assert download.value.suggested_filename == "experts.csv"
    table = pd.read_csv(download.value.path())
    assert list(table["run_id"]) == list(shown["run_id"])
    np.testing.assert_allclose(table["return_mean"], shown["return_mean"].astype(float))
    picture = page.get_by_role("link", name="figure (SVG)").get_attribute("href") or ""
    assert picture.endswith("_images/experts.svg")
    page.evaluate("() => navigator.clipboard.writeText = text => { window.copied = text; }")
    page.get_by_role("button", name="copy the commands").click()
    page.get_by_role("button", name=f"copied {len(shown)}").wait_for()
    assert page.evaluate("() => copied").splitlines() == list(shown["command"])
    assert results.hours(shown) in page.locator(".silem-links").inner_text()


def test_the_papers_numbers_can_be_hidden(site: Path, opened: Open, experts: pd.DataFrame) -> None:
    page = opened(figure_page(site, experts))

    def amber() -> int:
        page.wait_for_function("() => document.images[0].complete")
        page.evaluate("() => document.images[0].decode()")
        pixels = np.asarray(Image.open(io.BytesIO(page.locator("img").screenshot())).convert("RGB"))
        wanted = np.array([int(style.PAPER[i : i + 2], 16) for i in (1, 3, 5)])
        return int((np.abs(pixels.astype(int) - wanted).max(axis=-1) < 12).sum())

    assert amber() > 50
    page.get_by_label("show the paper's numbers").uncheck()
    assert amber() == 0
    page.reload()  # it is remembered
    page.locator(".silem-paper input:not(:checked)").wait_for()
    assert amber() == 0
    page.get_by_label("show the paper's numbers").check()
    assert amber() > 50


def test_each_figures_data_is_what_it_draws() -> None:
    frame = results.load_records("humanoids", "book")
    curves = results.figure_data(scores.runs_of("learning_curves", frame))
    assert {"iteration", "return_mean", "run_id"} <= set(curves)
    learned = results.figure_data(scores.runs_of("by_feature", frame))
    of = learned[learned["run_id"] == RUN]
    np.testing.assert_allclose(of["A"], results.load_transform(RUN)["A"])
    assert of["feature"].iloc[0] == "left hand x"


# ---------------------------------------------------------------- the PDF


def test_a_page_prints_to_a_pdf_without_its_buttons(
    site: Path, browser: Browser, tmp_path: Path
) -> None:
    page = site / "printed.html"
    picture = base64.b64encode(style.svg(style.new_figure(1.0)[0]).encode()).decode()
    page.write_text(
        f"{HEAD}<h1>One</h1><p class=silem-links><button>copy</button></p>"
        f"<img src='data:image/svg+xml;base64,{picture}'><h1>Two</h1>"
    )
    pdf.print_page(browser, page, tmp_path / "book.pdf")
    data = (tmp_path / "book.pdf").read_bytes()
    assert data.startswith(b"%PDF")
    assert data.count(b"/Type /Page\n") >= 2 or data.count(b"/Type /Page ") >= 2
    assert b"/Outlines" in data
