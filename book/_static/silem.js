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
