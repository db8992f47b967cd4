"""The body that runs in the page: the same policy, observation and model as in Python."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

from silem.envs import make_vec
from silem.report import results, web
from silem.study.evaluate import load_policy
from silem.util.errors import SilemError

pytestmark = pytest.mark.xdist_group("book")

N = 100
SCRIPTS = "".join(
    f"<script src='_static/{name}.js'></script>" for name in ("silem", "body", "capsules", "push")
)
PAGE = f"""<!doctype html><meta charset=utf-8><link rel=stylesheet href=_static/web.css>
<style>:root {{ --pst-color-background: white; }}</style>
<div id=silem-push class=silem-web data-bodies="Humanoid HumanoidR"
  data-film="_static/walking.mp4" data-still="_static/walking.jpg"></div>{SCRIPTS}"""
READ = "async name => silem.read = silem.body.read(await silem.bytes(`body-${name}`))"
ACT = "observations => observations.map(o => silem.body.act(silem.read.policy, o))"
OBSERVE = """async states => {
  const body = new silem.body.Simulation(await silem.body.engine(), silem.read.header);
  return states.map(([qpos, qvel]) => (body.place(qpos, qvel), Array.from(body.observe())));
}"""
HAND = """() => {
  const [hand, shoulder] = ["right_hand", "right_shoulder"].map(name => silem.push.sim.point(name));
  return Math.hypot(...hand.map((value, i) => value - shoulder[i]));
}"""
LOADED = "() => document.getElementById('silem-push').dataset.state === 'ready'"


@pytest.fixture
def page(site: Path, browser: Browser) -> Iterator[Page]:
    context = browser.new_context(offline=True)
    page = context.new_page()
    (site / "page.html").write_text(PAGE)
    page.goto((site / "page.html").as_uri())
    yield page
    context.close()


@pytest.fixture(params=web.BODIES)
def recorded(request: pytest.FixtureRequest) -> tuple[str, np.ndarray, np.ndarray, list[Any]]:
    """A body's name, observations (N, O), mean actions (N, A) and states in which it saw them."""
    name = request.param
    policy, env = load_policy(results.find(web.BODIES[name])), make_vec(name, n_envs=1, seed=0)
    observation, seen, done, states = np.asarray(env.reset()), [], [], []
    for _ in range(N):
        action, _ = policy.predict(observation, deterministic=True)
        seen.append(observation[0].copy())
        done.append(action[0].copy())
        simulation = env.simulation  # type: ignore[attr-defined]
        states.append([simulation.qpos[0].tolist(), simulation.qvel[0].tolist()])
        observation = np.asarray(env.step(action)[0])
    env.close()
    return name, np.array(seen), np.array(done), states


def needs_physics(site: Path) -> None:
    if not (site / "_static" / "web" / "mujoco.wasm.js").exists():
        pytest.skip("MuJoCo's npm package cannot be fetched here")


def test_the_page_acts_as_python_does(page: Page, recorded: Any) -> None:
    name, seen, done, _ = recorded
    page.evaluate(READ, name)
    acted = np.clip(page.evaluate(ACT, seen.tolist()), -1, 1)
    np.testing.assert_allclose(acted, done, atol=1e-5)
    # negative control: the other body's policy does otherwise
    page.evaluate(READ, next(other for other in web.BODIES if other != name))
    assert np.abs(np.clip(page.evaluate(ACT, seen.tolist()), -1, 1) - done).max() > 0.1


def test_the_page_sees_what_python_sees(site: Path, page: Page, recorded: Any) -> None:
    needs_physics(site)
    name, seen, _, states = recorded
    page.evaluate(READ, name)
    np.testing.assert_allclose(page.evaluate(OBSERVE, states), seen, atol=1e-5, rtol=1e-5)
    page.evaluate("() => silem.read.header.arms = {left: 1, right: 0.9}")  # another body's arms
    assert np.abs(np.array(page.evaluate(OBSERVE, states)) - seen).max() > 0.01


def test_a_body_walks_falls_when_pushed_and_stands_up_again(site: Path, page: Page) -> None:
    needs_physics(site)
    said = page.locator(".silem-status")
    page.locator(".silem-load").click()
    page.wait_for_function(LOADED)
    page.get_by_label("Time").fill("2")
    page.get_by_role("button", name="Start").click()
    page.wait_for_function("() => silem.push.sim.seconds > 1.5")
    way = page.evaluate("() => silem.push.sim.point('torso')[0]")
    assert way > 0.5  # it has walked
    page.get_by_label("Force").fill("500")
    page.get_by_role("button", name="Back").click()
    page.wait_for_function("() => silem.push.sim.fallen")
    said.filter(has_text="It fell after").wait_for()
    page.get_by_role("button", name="Reset").click()
    assert page.evaluate("() => [silem.push.sim.fallen, silem.push.sim.seconds]") == [False, 0]
    assert page.locator("canvas").evaluate("canvas => canvas.tabIndex") == 0


def test_keys_push_and_arms_stretch(site: Path, page: Page) -> None:
    needs_physics(site)
    page.locator(".silem-load").click()
    page.wait_for_function(LOADED)
    before = page.evaluate(HAND)
    page.get_by_label("Right arm").fill("1.5")
    assert page.evaluate(HAND) > 1.3 * before
    page.get_by_label("Body").select_option("HumanoidR")
    page.wait_for_function("() => silem.push.sim.header.body === 'HumanoidR'")
    assert page.get_by_label("Left arm").input_value() == "0.5"
    # time stands still: a push ends by itself, and a body that falls says so over what was said
    page.evaluate("() => { silem.push.sim.step = () => {}; }")
    page.locator("canvas").focus()
    page.keyboard.press("ArrowLeft")
    assert page.evaluate("() => Math.hypot(...silem.push.sim.force)") == pytest.approx(150)
    box = page.locator("canvas").bounding_box() or {}
    page.mouse.move(box["x"] + 200, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 260, box["y"] + 100)
    page.mouse.up()
    page.get_by_text("Pushed with 120 N").wait_for()


def test_another_package_is_refused_and_none_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))  # where there is no npm
    assert web.physics(tmp_path) is None
    assert "shows a film" in capsys.readouterr().err
    (tmp_path / f"mujoco-wasm-{web.NPM_PACKAGE[1]}.tgz").write_bytes(b"another")
    with pytest.raises(SilemError, match="SHA-256"):
        web.physics(tmp_path)


@pytest.mark.parametrize("lacks", ["WebAssembly", "packs"])
def test_without_the_body_a_film_stands_there(site: Path, browser: Browser, lacks: str) -> None:
    (site / "page.html").write_text(PAGE)
    page = browser.new_page()
    if lacks == "WebAssembly":
        page.add_init_script("delete window.WebAssembly")
    else:
        page.route("**/packs.js", lambda route: route.abort())
    page.goto((site / "page.html").as_uri())
    page.get_by_text("The film shows the same policy").wait_for()
    assert page.locator(".silem-load").count() == 0
    film = page.locator(".silem-poster video[controls]")
    assert (film.get_attribute("poster") or "").endswith("walking.jpg")
    assert film.evaluate(
        "film => film.play().then(() => film.pause(), () => 0).then(() => film.videoWidth)"
    )
    page.close()
