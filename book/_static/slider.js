// The page "Watching a run learn": curves of a run up to the iteration that a slider chooses, its
// transform, as bars against A = 1 and b = 0, and of a run that was filmed its policy at checkpoints.
silem.ready(async () => {
  const place = document.getElementById("silem-learning");
  if (!place) return;
  const { make } = silem;
  const status = make("p", { class: "silem-status", role: "status" }, "Loading the curves…");
  place.replaceChildren(status);
  let data;
  try {
    data = await silem.json("learning");
  } catch (error) {
    status.textContent = `There are no curves to show: ${error.message}.`;
    return;
  }
  const PANELS = [
    ["return_mean", "Return of an episode", 0],
    ["speed_m_s", "Speed, m/s", 2],
    ["disc_reward", "Discriminator reward", 1],
    ["episode_length", "Steps of an episode", 0],
    ["disc_acc_learner", "D's accuracy on the learner", 2],
    ["disc_acc_expert", "D's accuracy on the expert", 2],
    ["transform_loss", "Loss of T", 3],
    ["policy_std", "Standard deviation of the actions", 3],
  ];
  const [WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM] = [340, 150, 48, 12, 10, 22];
  const NS = "http://www.w3.org/2000/svg";
  const svg = (tag, attributes, ...children) => {
    const element = document.createElementNS(NS, tag);
    for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
    element.append(...children);
    return element;
  };
  const written = (value, digits) => value == null ? "–"
    : value.toLocaleString("en-US", { minimumFractionDigits: digits, maximumFractionDigits: digits }).replace("-", "−");

  // ------------------------------------------------------------ what to show

  const options = (values, label = (value) => value) => values.map((value) => make("option", { value }, label(value)));
  const unique = (values) => [...new Set(values)];
  const study = make("select", { "aria-label": "Study" }, ...options(unique(data.runs.map((run) => run.study))));
  const body = make("select", { "aria-label": "Body" });
  const run = make("select", { "aria-label": "Run" });
  const other = make("select", { "aria-label": "Compare with" });
  const iteration = make("input", { type: "range", min: 0, step: 1, "aria-label": "Iteration" });
  const count = make("output");
  const play = make("button", { type: "button", class: "silem-load" }, "Play");
  const field = (name, control) => make("label", { class: "silem-field" }, make("span", {}, name), control);
  const panels = make("div", { class: "silem-panels" });
  const transform = make("div", { class: "silem-transform" });
  const film = make("video", { controls: true, loop: true, muted: true, playsinline: true, preload: "none", width: 400, height: 300 });
  const filmed = make("output");
  const about = make("p", { class: "silem-keys" });
  const screen = make("figure", { class: "silem-panel-one silem-film" },
    make("figcaption", {}, make("span", {}, "The policy on film"), filmed), film, about);
  place.replaceChildren(
    make("div", { class: "silem-fields" }, field("Study", study), field("Body", body), field("Run", run), field("Compare with", other)),
    make("div", { class: "silem-play" }, play, iteration, count), panels, transform, status);

  let shown, second, learned, checkpoint, drawn = [];
  const reached = (iterations, at) => iterations.findLast((one) => one <= at);
  const keyOf = (id) => data.runs.find((one) => one.id === id);
  const fillBodies = () => {
    const known = unique(data.runs.filter((one) => one.study === study.value).map((one) => one.body));
    body.replaceChildren(...options(known));
    fillRuns();
  };
  const fillRuns = () => {
    const known = data.runs.filter((one) => one.study === study.value && one.body === body.value);
    const entries = () => known.map((one) => make("option", { value: one.id }, one.label));
    run.replaceChildren(...entries());
    other.replaceChildren(make("option", { value: "" }, "nothing"), ...entries());
    const ours = known.filter((one) => one.method === "silem");
    const first = ours.find((one) => one.films) ?? ours[0] ?? known[0];
    run.value = first.id;
    pick();
  };

  // ------------------------------------------------------------ curves

  function nice(low, high) {
    const step = [1, 2, 2.5, 5, 10].map((m) => m * 10 ** Math.floor(Math.log10((high - low) / 4 || 1))).find((s) => (high - low) / s <= 4.5);
    const first = Math.floor(low / step + 1e-9) * step;
    const ticks = [];
    for (let tick = first; tick < high + step * 0.999; tick += step) ticks.push(Number(tick.toPrecision(12)));
    return ticks;
  }

  function panel([name, title, digits]) {
    const values = [shown, second].flatMap((one) => one?.curve[name] ?? []).filter((value) => value != null);
    if (!shown.curve[name]?.some((value) => value != null)) return null;
    const ticks = nice(Math.min(0, ...values), Math.max(...values, 1e-9));
    const [low, high] = [ticks[0], ticks.at(-1)];
    const last = Math.max(...[shown, second].map((one) => one?.curve.iteration.at(-1) ?? 0));
    const x = (value) => LEFT + (value / last) * (WIDTH - LEFT - RIGHT);
    const y = (value) => HEIGHT - BOTTOM - ((value - low) / (high - low)) * (HEIGHT - TOP - BOTTOM);
    const path = (one, upTo = Infinity) => {
      let text = "", pen = "M";
      one.curve[name].forEach((value, i) => {
        const at = one.curve.iteration[i];
        if (value == null || at > upTo) return;
        text += `${pen}${x(at).toFixed(1)} ${y(value).toFixed(1)}`;
        pen = "L";
      });
      return text;
    };
    const picture = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", class: "silem-chart" });
    const places = Math.max(...ticks.map((tick) => (String(tick).split(".")[1] ?? "").length));
    for (const tick of ticks) {
      picture.append(svg("line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y(tick), y2: y(tick), class: "silem-grid" }));
      picture.append(svg("text", { x: LEFT - 6, y: y(tick) + 4, "text-anchor": "end" }, written(tick, places)));
    }
    for (const [at, anchor] of [[0, "start"], [last, "end"]])
      picture.append(svg("text", { x: x(at), y: HEIGHT - 5, "text-anchor": anchor }, written(at, 0)));
    picture.append(svg("text", { x: x(last / 2), y: HEIGHT - 5, "text-anchor": "middle" }, "iteration"));
    if (second?.curve[name]) picture.append(svg("path", { d: path(second), class: "silem-second" }));
    picture.append(svg("path", { d: path(shown), class: "silem-whole" }));
    const line = svg("path", { class: "silem-line" });
    const dot = svg("circle", { r: 4, class: "silem-dot" });
    const cursor = svg("line", { y1: TOP, y2: HEIGHT - BOTTOM, class: "silem-cursor" });
    picture.append(cursor, line, dot);
    const value = make("output");
    const element = make("figure", { class: "silem-panel-one" }, make("figcaption", {}, make("span", {}, title), value), picture);
    const present = shown.curve[name].filter((one) => one != null);
    picture.setAttribute("aria-label", `${title} over ${last} iterations: from ${written(present[0], digits)} to ${written(present.at(-1), digits)}.`);
    const move = (row) => {
      const at = shown.curve.iteration[row];
      const now = shown.curve[name][row];
      line.setAttribute("d", path(shown, at));
      for (const end of ["x1", "x2"]) cursor.setAttribute(end, x(at));
      dot.toggleAttribute("hidden", now == null);
      dot.setAttribute("visibility", now == null ? "hidden" : "visible");
      if (now != null) { dot.setAttribute("cx", x(at)); dot.setAttribute("cy", y(now)); }
      value.textContent = written(now, digits);
    };
    return { element, move };
  }

  // ------------------------------------------------------------ the transform

  function bars(all, now, rest, names, title) {
    const far = Math.max(...all.flat().map((value) => Math.abs(value - rest)), 0.05) * 1.12;
    const values = all[now];
    const [row, left, wide] = [17, 150, 340];
    const x = (value) => left + ((value - rest + far) / (2 * far)) * (wide - left - 8);
    const height = values.length * row + 22;
    const picture = svg("svg", { viewBox: `0 0 ${wide} ${height}`, class: "silem-chart", role: "img",
      "aria-label": `${title}: ${names.map((name, i) => `${name} ${written(values[i], 2)}`).join(", ")}.` });
    values.forEach((value, i) => {
      const [a, b] = [x(rest), x(value)].sort((one, two) => one - two);
      const bar = svg("rect", { x: a, y: i * row + 3, width: Math.max(b - a, 0.5), height: row - 5, class: "silem-bar" });
      bar.append(svg("title", {}, `${names[i]}: ${written(value, 3)}`));
      picture.append(svg("text", { x: left - 8, y: i * row + 14, "text-anchor": "end" }, names[i]), bar);
    });
    picture.append(svg("line", { x1: x(rest), x2: x(rest), y1: 0, y2: height - 20, class: "silem-cursor" }));
    for (const [value, anchor] of [[rest - far, "start"], [rest, "middle"], [rest + far, "end"]])
      picture.append(svg("text", { x: x(value), y: height - 5, "text-anchor": anchor }, written(value, 2)));
    return make("figure", { class: "silem-panel-one" }, make("figcaption", {}, make("span", {}, title)), picture);
  }

  function pick() {
    shown = keyOf(run.value);
    second = keyOf(other.value);
    place.style.setProperty("--silem-run", shown.colour);
    place.style.setProperty("--silem-other", second?.colour ?? "none");
    drawn = PANELS.map(panel).filter(Boolean);
    panels.replaceChildren(...(shown.films ? [screen] : []), ...drawn.map((one) => one.element));
    iteration.max = shown.curve.iteration.length - 1;
    iteration.value = iteration.max;
    learned = shown.learned ?? (shown.A && { iteration: [shown.curve.iteration.at(-1)], A: [shown.A], b: [shown.b] });
    checkpoint = film.dataset.iteration = null;
    transform.replaceChildren();
    move();
  }
  /** Show T at the last checkpoint before an iteration; of most runs the record keeps only the last. */
  function moveTransform(at) {
    const now = learned.iteration.length > 1 ? reached(learned.iteration, at) : learned.iteration[0];
    if (now === checkpoint) return;
    checkpoint = now;
    const row = learned.iteration.indexOf(now);
    const names = data.features[shown.body];
    const why = learned.iteration.length > 1 ? "They move from checkpoint to checkpoint."
      : "The record keeps no earlier T, so these bars do not move with the slider; its loss does.";
    transform.replaceChildren(make("h3", {}, learned.iteration.length > 1 ? "The transform" : "The transform that it ended with"),
      make("p", {}, `T(g) = A g + b after ${written(now, 0)} iterations: bars leave the identity, A = 1 and b = 0. ${why}`),
      make("div", { class: "silem-panels" }, bars(learned.A, row, 1, names, "A, scale of each feature"), bars(learned.b, row, 0, names, "b, shift of each feature")));
  }
  /** Show the film of the last checkpoint before an iteration; whatever plays goes on playing. */
  function moveFilm(at) {
    const now = reached(shown.films, at);
    if (String(now) === film.dataset.iteration) return;
    const playing = !film.paused;
    const row = shown.curve.iteration.findIndex((one) => one >= now);
    film.dataset.iteration = now;
    const path = new URL(`../films/${shown.id}/${now}`, silem.root);
    film.poster = `${path}.jpg`;
    film.src = `${path}.mp4`;
    film.setAttribute("aria-label", `${shown.body} under the policy of ${shown.id} after ${written(now, 0)} iterations, five seconds in real time.`);
    filmed.textContent = now ? `iteration ${written(now, 0)}` : "before training";
    about.textContent = `${shown.id}, ${now ? `iteration ${written(now, 0)}: return ${written(shown.curve.return_mean[row], 0)} while it trained` : "before its first iteration"}. Films at ${shown.films.map((one) => written(one, 0)).join(", ")}.`;
    if (playing) film.play().catch(() => {});
  }
  function move() {
    const row = Number(iteration.value);
    for (const one of drawn) one.move(row);
    const at = shown.curve.iteration[row];
    if (learned) moveTransform(at);
    if (shown.films) moveFilm(at);
    count.textContent = `iteration ${written(at, 0)} of ${written(shown.curve.iteration.at(-1), 0)}`;
    iteration.setAttribute("aria-valuetext", `${count.textContent}, return ${written(shown.curve.return_mean[row], 0)}`);
    status.textContent = `${shown.id}; each point averages the iterations since the one before.`;
  }
  let timer = null;
  const stop = () => { clearInterval(timer); timer = null; play.textContent = "Play"; };
  play.addEventListener("click", () => {
    if (timer) return stop();
    if (iteration.value === iteration.max) iteration.value = 0;
    play.textContent = "Pause";
    const stride = Math.max(1, Math.round(iteration.max / 150));
    timer = setInterval(() => {
      iteration.value = Math.min(Number(iteration.max), Number(iteration.value) + stride);
      move();
      if (iteration.value === iteration.max) stop();
    }, 50);
  });
  iteration.addEventListener("input", () => { stop(); move(); });
  study.addEventListener("change", fillBodies);
  body.addEventListener("change", fillRuns);
  for (const control of [run, other]) control.addEventListener("change", pick);
  const asked = new URLSearchParams(location.search).get("run");
  const begin = keyOf(asked) ?? data.runs.find((one) => one.films) ?? data.runs.find((one) => one.study === "humanoids") ?? data.runs[0];
  study.value = begin.study;
  fillBodies();
  body.value = begin.body;
  fillRuns();
  run.value = begin.id;
  pick();
  place.dataset.state = "ready";
});
