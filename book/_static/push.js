// The page "A body to push": loads a body when asked for, runs it in real time, and lets the reader
// push it, stretch its arms and slow time down.
silem.ready(() => {
  const place = document.getElementById("silem-push");
  if (!place) return;
  const { make } = silem;
  const MAX_N = 500;
  const PUSH_S = 0.2;
  const stage = make("div", { class: "silem-stage" });
  const status = make("p", { class: "silem-status", role: "status", "aria-live": "polite" });
  place.replaceChildren(stage, status);

  // ------------------------------------------------------------ before anything is loaded

  const film = make("video", {
    src: place.dataset.film, poster: place.dataset.still, controls: true, loop: true, muted: true, playsinline: true, preload: "none",
    "aria-label": "A humanoid of capsules walks forwards on a chequered floor: the policy that this page can load, filmed.",
  });
  const poster = make("div", { class: "silem-poster" }, film);
  stage.append(poster);

  const why = (text) => {
    place.dataset.state = "film";
    status.textContent = `${text} The film shows the same policy.`;
  };
  silem.script("packs.js").then(() => {
    const { sizes, version, mujoco_python: trained } = silem.about;
    for (const spot of document.querySelectorAll("[data-silem-version]")) spot.textContent = spot.dataset.silemVersion === "page" ? version : trained;
    if (!sizes["mujoco.wasm"]) return why("This copy of the book was built without MuJoCo's WebAssembly.");
    if (typeof WebAssembly !== "object") return why("This browser has no WebAssembly.");
    const bytes = sizes["mujoco.wasm"] + sizes["mujoco.js"] + sizes["body-Humanoid"];
    const load = make("button", { type: "button", class: "silem-load", onclick: () => start(load) },
      `Load the body (${(bytes / 1e6).toFixed(1)} MB)`);
    poster.append(make("div", { class: "silem-offer" }, load));
    status.textContent = "Nothing is loaded until you ask for it.";
    place.dataset.state = "offered";
  }, (error) => why(`${error.message}.`));

  async function start(button) {
    button.disabled = true;
    button.textContent = "Loading…";
    try {
      const mujoco = await silem.body.engine();
      await run(mujoco);
    } catch (error) {
      console.warn(error);
      button.remove();
      why(`The body could not be loaded: ${error.message}.`);
    }
  }

  // ------------------------------------------------------------ the body

  async function run(mujoco) {
    const canvas = make("canvas", {
      tabindex: 0, role: "application", "aria-describedby": "silem-push-keys",
      "aria-label": "A humanoid of capsules under its learned policy, seen from the side. Drag to push it, or use the buttons below.",
    });
    const meter = make("output", { class: "silem-meter" });
    const view = new silem.View(canvas);
    const bodies = {};
    let sim, policy, running = false, time = 1, turn = -1.9, dragged = null, last = 0, owed = 0, shown = "";
    let colours = theme();

    const choose = async (name) => {
      bodies[name] ??= silem.body.read(await silem.bytes(`body-${name}`));
      policy = bodies[name].policy;
      sim?.data.delete();
      sim?.model.delete();
      sim = new silem.body.Simulation(mujoco, bodies[name].header);
      silem.push.sim = sim;
      for (const side of ["left", "right"]) arms[side].value = sim.arms[side];
      label();
      tell(`${name} stands ready.`);
      pause();
    };
    const act = (observation) => {
      const mean = silem.body.act(policy, observation);
      return noise.checked ? mean.map((value, i) => value + policy.std[i] * normal()) : mean;
    };
    const normal = () => Math.sqrt(-2 * Math.log(1 - Math.random())) * Math.cos(2 * Math.PI * Math.random());
    const tell = (text) => { if (text !== shown) status.textContent = shown = text; };

    // controls
    const button = (text, onclick, more = {}) => make("button", { type: "button", onclick, ...more }, text);
    const slider = (name, min, max, step, value, oninput) => {
      const input = make("input", { type: "range", min, max, step, value, oninput, "aria-label": name });
      const output = make("output");
      input.row = make("label", { class: "silem-slider" }, make("span", {}, name), input, output);
      input.say = (text) => { output.textContent = text; input.setAttribute("aria-valuetext", text); };
      return input;
    };
    const go = button("Start", () => (running ? pause() : resume()), { class: "silem-load" });
    const pause = () => { running = false; go.textContent = sim.steps ? "Go on" : "Start"; };
    const resume = () => {
      if (sim.fallen) reset();
      running = true; go.textContent = "Pause"; last = 0; tell("It runs.");
    };
    const reset = () => { sim.reset(); owed = 0; tell("It stands ready again."); pause(); };
    const force = slider("Force", 20, MAX_N, 10, 150, () => label());
    const speed = slider("Time", 0.1, 2, 0.1, 1, () => { time = Number(speed.value); label(); });
    const sight = slider("View", -180, 180, 5, -110, () => { turn = (Number(sight.value) * Math.PI) / 180; label(); });
    const arms = {};
    for (const side of ["left", "right"])
      arms[side] = slider(`${side === "left" ? "Left" : "Right"} arm`, 0.3, 2, 0.05, 1, () => {
        sim.build({ left: Number(arms.left.value), right: Number(arms.right.value) });
        label();
      });
    const noise = make("input", { type: "checkbox" });
    const push = (forwards, left, newtons = Number(force.value)) => {
      const [ahead, aside] = sim.torsoAxes();
      const way = [0, 1].map((i) => forwards * ahead[i] + left * aside[i]);
      shove(way.map((value) => (value * newtons) / Math.hypot(...way)));
    };
    const shove = ([x, y]) => {
      sim.push([x, y, 0], PUSH_S);
      if (!running && !sim.fallen) resume();
      tell(`Pushed with ${Math.round(Math.hypot(x, y))} N for ${PUSH_S} s.`);
    };
    function label() {
      force.say(`${force.value} N`);
      speed.say(`× ${Number(speed.value).toFixed(1)}`);
      sight.say(`${sight.value}°`);
      for (const side of ["left", "right"]) arms[side].say(`× ${Number(arms[side].value).toFixed(2)}`);
    }
    const select = make("select", { "aria-label": "Body", onchange: () => choose(select.value) },
      ...place.dataset.bodies.split(" ").map((name) => make("option", {}, name)));
    const own = button("Own arms", () => {
      for (const side of ["left", "right"]) arms[side].value = sim.header.arms[side];
      sim.build(sim.header.arms); label();
    });
    const panel = make("div", { class: "silem-panel" },
      make("div", { class: "silem-row" }, select, go, button("Reset", reset)),
      make("fieldset", {}, make("legend", {}, `Push for ${PUSH_S} s`), force.row,
        make("div", { class: "silem-row" },
          button("Ahead", () => push(1, 0)), button("Back", () => push(-1, 0)),
          button("Left", () => push(0, 1)), button("Right", () => push(0, -1)))),
      make("fieldset", {}, make("legend", {}, "Stretch its arms"), arms.left.row, arms.right.row,
        make("div", { class: "silem-row" }, own)),
      make("fieldset", {}, make("legend", {}, "See"), speed.row, sight.row,
        make("label", { class: "silem-check" }, noise, "random actions, as in evaluation")));
    const keys = make("p", { id: "silem-push-keys", class: "silem-keys" },
      "Drag across the picture to push: 2 N for each pixel. With the picture in focus: arrow keys push, space starts and pauses, R resets.");
    silem.push = { sim: null, go, push, view };
    await choose(select.value);

    // dragging
    const at = (event) => [event.offsetX, event.offsetY];
    const pulled = () => {
      const [dx, dy] = dragged.to.map((value, i) => 2 * (value - dragged.from[i]));
      const way = [0, 1].map((i) => view.right[i] * dx + (view.back[i] / Math.hypot(view.back[0], view.back[1])) * dy);
      const size = Math.hypot(...way);
      return way.map((value) => value * Math.min(1, MAX_N / (size || 1)));
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      dragged = { from: at(event), to: at(event) };
    });
    canvas.addEventListener("pointermove", (event) => { if (dragged) dragged.to = at(event); });
    canvas.addEventListener("pointercancel", () => (dragged = null));
    canvas.addEventListener("pointerup", () => {
      const way = dragged && pulled();
      dragged = null;
      if (way && Math.hypot(...way) >= 10) shove(way);
    });
    const ARROWS = { ArrowUp: [0, -1], ArrowDown: [0, 1], ArrowLeft: [-1, 0], ArrowRight: [1, 0] };
    canvas.addEventListener("keydown", (event) => {
      const arrow = ARROWS[event.key];
      if (arrow) {
        const level = Math.hypot(view.back[0], view.back[1]);
        shove([0, 1].map((i) => force.value * (view.right[i] * arrow[0] + (view.back[i] / level) * arrow[1])));
      } else if (event.key === " ") go.click();
      else if (event.key.toLowerCase() === "r") reset();
      else return;
      event.preventDefault();
    });

    // drawing
    function theme() {
      const style = getComputedStyle(document.documentElement);
      const of = (name) => silem.rgb(style.getPropertyValue(name).trim());
      const dark = document.documentElement.dataset.theme === "dark";
      return {
        sky: of("--pst-color-background"), ground: of("--silem-ground"), line: of("--silem-line"),
        skin: of("--silem-skin"), arm: of("--silem-arm"), force: of("--silem-force"),
        shade: [0, 0, 0, dark ? 0.45 : 0.2],
      };
    }
    new MutationObserver(() => (colours = theme())).observe(document.documentElement, { attributes: true, attributeFilter: ["data-theme"] });
    const focus = [0, 0, 0.85];
    function draw() {
      const torso = sim.point("torso");
      torso.slice(0, 2).forEach((value, i) => (focus[i] = value));
      const changed = new Set(["left", "right"].filter((side) => sim.arms[side] !== 1)
        .flatMap((side) => ["upper_arm", "lower_arm", "hand"].map((link) => mujoco.mj_name2id(sim.model, 1, `${side}_${link}`))));
      const shapes = silem.shapesOf(sim.model, sim.data, (body) => (changed.has(body) ? colours.arm : colours.skin));
      const [x, y] = dragged ? pulled() : sim.force;
      const size = Math.hypot(x, y);
      if (size > 5) { // an arrow that ends at the chest
        const [end, long] = [torso.map((v, i) => v - 0.12 * ([x, y, 0][i] / size)), 0.25 + size / 450];
        const back = (far) => end.map((v, i) => v - far * ([x, y, 0][i] / size));
        shapes.push(silem.between(back(long + 0.16), back(0.16), [0.02, 0.02], colours.force));
        shapes.push(silem.between(back(0.2), end, [0.06, 0.004], colours.force));
      }
      view.draw(shapes, focus, turn, colours);
      const [vx, vy] = sim.velocity();
      const way = Math.hypot(torso[0] - sim.start[0], torso[1] - sim.start[1]);
      meter.textContent = `${sim.seconds.toFixed(1)} s   ${Math.hypot(vx, vy).toFixed(1)} m/s   ${way.toFixed(1)} m` + (size > 5 ? `   ${Math.round(size)} N` : "");
    }
    function frame(now) {
      if (!place.isConnected) return;
      if (running) {
        owed += last ? Math.min(now - last, 100) * 0.001 * time : 0;
        last = now;
        const step = sim.model.opt.timestep;
        for (; owed >= step; owed -= step) {
          const stood = !sim.fallen;
          sim.step(act);
          if (stood && sim.fallen) { sim.end = sim.steps + 2 / step; tell(`It fell after ${sim.seconds.toFixed(1)} s. Reset puts it back on its feet.`); }
        }
        if (sim.fallen && sim.steps > sim.end) pause(); // limp, it has come to rest
      }
      draw();
      requestAnimationFrame(frame);
    }
    label();
    stage.replaceChildren(make("div", { class: "silem-scene" }, canvas, meter), panel);
    status.before(keys);
    place.dataset.state = "ready";
    go.focus();
    requestAnimationFrame(frame);
  }
});
