// What every page shares: packs of data that script tags load, since a page from the disk may not
// fetch. A pack is a script that says silem.packs[name] = "<base64>"; see silem/report/web.py.
window.silem = window.silem || {};
silem.packs = {};
silem.root = new URL("web/", document.currentScript.src);

/** Load a script from beside the pages; a promise. */
silem.script = (name) =>
  new Promise((resolve, reject) => {
    const tag = document.createElement("script");
    tag.src = new URL(name, silem.root);
    tag.onload = resolve;
    tag.onerror = () => reject(new Error(`${name} is not in this copy of the book`));
    document.head.append(tag);
  });

/** Return a pack's bytes, those of a gzip file uncompressed. */
silem.bytes = async (name) => {
  if (!(name in silem.packs)) await silem.script(`${name}.js`);
  const bytes = Uint8Array.from(atob(silem.packs[name]), (letter) => letter.charCodeAt(0));
  if (bytes[0] !== 0x1f || bytes[1] !== 0x8b) return bytes;
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
};

/** Return a pack that is JSON. */
silem.json = async (name) => JSON.parse(new TextDecoder().decode(await silem.bytes(name)));

/** Make an element: attributes, and children that are elements or text. */
silem.make = (tag, attributes = {}, ...children) => {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value != null) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
};

/** Run when the page is read. */
silem.ready = (run) =>
  document.readyState === "loading" ? addEventListener("DOMContentLoaded", run) : run();

// ------------------------------------------------------------ under figures

/** Give every tracing line its buttons, and every figure with the paper's numbers its switch. */
silem.ready(async () => {
  const { make } = silem;
  for (const line of document.querySelectorAll(".silem-links")) {
    // the figures since the line before: they stand in the cells above this one
    const pictures = [];
    let cell = line.closest(".cell");
    while ((cell = cell?.previousElementSibling) && !cell.querySelector(".silem-trace") && !/^H\d$/.test(cell.tagName))
      pictures.unshift(...cell.querySelectorAll("img[src$='.svg']"));
    const link = (picture, i) => make("a", { href: picture.src, download: `${line.dataset.name}.svg`, target: "_blank" },
      pictures.length > 1 ? `figure ${i + 1} (SVG)` : "figure (SVG)");
    for (const [i, picture] of pictures.entries()) line.firstElementChild.after(" ", link(picture, pictures.length - 1 - i));
    const commands = [...line.parentElement.querySelectorAll("details:first-of-type li code:last-child")];
    const copy = line.querySelector(".silem-copy");
    copy.addEventListener("click", async () => {
      const text = commands.map((code) => code.textContent).join("\n");
      try {
        await navigator.clipboard.writeText(text);
      } catch { // a page from the disk has no clipboard in some browsers
        const field = make("textarea", {}, text);
        document.body.append(field);
        field.select();
        document.execCommand("copy");
        field.remove();
      }
      copy.textContent = `copied ${commands.length}`;
      setTimeout(() => (copy.textContent = "copy the commands"), 2000);
    });
  }

  const figures = [...document.querySelectorAll("img[src*='_images/'][src$='.svg']")];
  if (!figures.length) return;
  await silem.script("figures.js").catch(() => (silem.withPaper = []));
  const name = (picture) => picture.src.split("/").at(-1).split("#")[0];
  const ghosts = figures.filter((picture) => silem.withPaper.includes(name(picture)));
  const switches = [];
  const show = (visible) => {
    for (const picture of ghosts) picture.src = picture.src.split("#")[0] + (visible ? "" : "#without-paper");
    for (const box of switches) box.checked = visible;
    try { localStorage.setItem("silem-paper", visible ? "" : "hidden"); } catch { /* nothing is kept */ }
  };
  for (const picture of ghosts) {
    const box = make("input", { type: "checkbox", checked: true, onchange: () => show(box.checked) });
    switches.push(box);
    (picture.closest("figure, .cell_output") ?? picture).append(make("label", { class: "silem-check silem-paper" }, box, "show the paper's numbers"));
  }
  let kept = "";
  try { kept = localStorage.getItem("silem-paper"); } catch { /* nothing was kept */ }
  if (kept === "hidden") show(false);
});
