// Builds elements. Text is inserted as text, never as markup, so no name or message can become code.

const SVG = "http://www.w3.org/2000/svg";

function build(node, props, children) {
  for (const [key, value] of Object.entries(props ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (key === "value" || key === "checked" || key === "disabled" || key === "open") node[key] = value;
    else node.setAttribute(key, value === true ? "" : value);
  }
  add(node, children);
  return node;
}

function add(node, children) {
  for (const child of children.flat(Infinity)) {
    if (child === null || child === undefined || child === false) continue;
    node.append(child);
  }
}

/** An HTML element; properties that begin with `on` are listeners; null and false are left out. */
export const h = (tag, props, ...children) => build(document.createElement(tag), props, children);

/** An SVG element. */
export const svg = (tag, props, ...children) => build(document.createElementNS(SVG, tag), props, children);

/** Replaces a node's children. */
export function fill(node, ...children) {
  node.replaceChildren();
  add(node, children);
  return node;
}

/** A table cell with a number and its interval below it. */
export const figureCell = ([value, interval]) => h("td", { class: "number" }, value, interval ? h("small", { class: "soft under" }, interval) : null);

/** Grey placeholder lines for text. */
export function skeleton(lines = 3) {
  const rows = Array.from({ length: lines }, () => h("span", { class: "bone" }));
  return h("div", { class: "skeleton", "aria-hidden": "true" }, rows);
}

/** Pause between two automatic loads of the same thing, ms. */
const CALM_MS = 5000;

/** Runs one load at a time. Requests during a load cause one more afterwards: at once if `soon`, else after a pause. */
export function single(load, calm_ms = CALM_MS) {
  let busy = false;
  let again = null;
  return async function run(soon = false) {
    if (busy) {
      again = Math.min(again ?? calm_ms, soon ? 0 : calm_ms);
      return;
    }
    busy = true;
    await load();
    busy = false;
    if (again !== null) setTimeout(run, again);
    again = null;
  };
}

/** A part of the page that loads: placeholder, then content, or the error in words with a button to try again. */
export function loading(root, load, show, { lines = 4, calm_ms = CALM_MS } = {}) {
  let ended = false;
  const run = single(async () => {
    if (ended) return;
    if (!root.hasChildNodes()) fill(root, skeleton(lines));
    root.setAttribute("aria-busy", "true");
    try {
      const data = await load();
      if (!ended) show(data);
    } catch (error) {
      if (!ended) fill(root, problem(error.message, error.status === 422 || error.status === 404 ? null : run));
    }
    root.removeAttribute("aria-busy");
  }, calm_ms);
  return { run, end: () => (ended = true) };
}

/** Text with code in `backticks`. */
export const prose = (text) => text.split("`").map((part, k) => (k % 2 ? h("code", null, part) : part));

/** An error in words, and a button to try again. */
export function problem(words, again) {
  const button = again && h("button", { class: "button quiet", type: "button", onclick: again }, "Try again");
  return h("p", { class: "problem" }, words, " ", button);
}

/** Calls `near` once: when a node comes near the screen, or through `now`. `end` stops watching. */
export function whenNear(node, near) {
  let waits = true;
  const watch = new IntersectionObserver((entries) => entries.some((e) => e.isIntersecting) && now(), { rootMargin: "300px" });
  const end = () => {
    waits = false;
    watch.disconnect();
  };
  const now = () => {
    if (!waits) return;
    end();
    near();
  };
  watch.observe(node);
  return { now, end };
}
