// One loop: what is wrong, how certain it is, what to do, and the evidence.

import * as api from "./api.js";
import { fill, h, loading, problem, single, skeleton, whenNear } from "./dom.js";
import * as pictures from "./pictures.js";
import { alarms } from "./loop-alarm.js";
import { gap } from "./loop-gap.js";
import { head } from "./loop-head.js";
import { overTime } from "./loop-history.js";
import { repair } from "./loop-repair.js";
import { trend } from "./loop-trend.js";
import { why } from "./loop-why.js";
import { on, store } from "./store.js";

const SECTIONS = [
  ["trend", "Trend and phase"],
  ["history", "Over time"],
  ["why", "Why"],
  ["repair", "Benefit of a repair"],
  ["gap", "Gap: what the model misses"],
  ["pictures", "Pictures"],
  ["alarms", "Alarm history"],
];

/** Sections that load when they come near the screen. */
const LATE = new Set(["history", "repair", "pictures", "alarms"]);

/** Shows a loop; returns a cleanup function. */
export function show(root, { name, live, announce }) {
  const ends = [];
  const loop = { name, path: (rest) => api.loopPath(name, rest), announce, document: null, listeners: [] };
  const headRoot = h("header", { class: "loop-head" }, skeleton(4));
  const parts = Object.fromEntries(SECTIONS.map(([id, title]) => [id, section(id, title)]));
  document.title = `${name} · stictiond`;
  const late = {};
  // Sections that load above it may move the section before it is seen.
  const jump = (id) => () => {
    late[id]?.now();
    parts[id].section.scrollIntoView({ behavior: matchMedia("(prefers-reduced-motion: reduce)").matches ? "auto" : "smooth" });
    parts[id].title.focus({ preventScroll: true });
  };
  fill(root, headRoot,
    h("nav", { class: "jump", "aria-label": "On this page" }, SECTIONS.map(([id, title]) => h("button", { class: "button quiet", type: "button", onclick: jump(id) }, title))),
    h("div", { class: "loop-parts" }, parts.trend.section,
      h("div", { class: "column" }, parts.history.section, parts.why.section), h("div", { class: "column" }, parts.repair.section, parts.gap.section),
      parts.pictures.section, parts.alarms.section));

  const takeDocument = (document) => {
    loop.document = document;
    head(headRoot, loop);
    for (const listener of loop.listeners) listener(document);
  };
  const reload = single(async () => {
    try {
      takeDocument(await api.get(loop.path()));
    } catch (error) {
      if (loop.document) return;
      if (error.status === 404) fill(root, h("h1", null, name), problem(error.message), h("p", null, h("a", { href: "#/" }, "Back to the overview")));
      else fill(headRoot, h("h1", null, name), problem(error.message, reload));
    }
  });
  loop.reload = reload;
  loop.onDocument = (listener) => {
    loop.listeners.push(listener);
    if (loop.document) listener(loop.document);
  };

  ends.push(trend(parts.trend.body, loop));
  why(parts.why.body, loop);
  gap(parts.gap.body, loop);
  const near = (id, start) => {
    late[id] = whenNear(parts[id].section, start);
    ends.push(late[id].end);
  };
  near("history", () => ends.push(overTime(parts.history.body, loop)));
  near("repair", () => ends.push(repair(parts.repair.body, loop)));
  near("alarms", () => ends.push(alarms(parts.alarms.body, loop)));
  near("pictures", () => ends.push(drawings(parts.pictures.body, loop)));

  // A new window changes nearly everything; the stream announces it.
  const mine = (document) => document.loop === name && reload();
  ends.push(on("estimate", mine), on("alarm", mine), on("gap", mine), on("back", () => reload(true)));
  ends.push(on("rows", (names) => (names === null || names.has(name)) && store.rows.has(name) && loop.document && head(headRoot, loop)));
  ends.push(on("gone", (names) => names.has(name) && fill(headRoot, h("h1", null, name),
    h("p", { class: "note" }, "The daemon no longer watches this loop: no sample came for a long time. It appears again with its next sample."))));
  live.open(name);
  reload();
  return () => ends.forEach((end) => end?.());
}

// Pictures take the program seconds to draw, so they stay until the reader asks for those of a newer window.
function drawings(root, loop) {
  const list = h("div");
  const renew = h("button", { class: "button", type: "button", hidden: true, onclick: () => part.run(true) }, "Newer window available: redraw");
  let drawn = null;
  fill(root, renew, list);
  const end = () => loop.document?.estimate?.window.end_ns ?? null;
  const load = async () => {
    renew.disabled = true;
    drawn = end();
    const answer = await api.get(loop.path("/pictures")).finally(() => (renew.disabled = false));
    root.removeAttribute("aria-busy");
    renew.hidden = end() === drawn;
    return answer;
  };
  const part = loading(list, load, (answer) => pictures.show(list, answer.pictures), { lines: 8 });
  loop.onDocument(({ estimate }) => {
    if (!estimate) {
      fill(list, h("p", { class: "note" }, "No window yet: nothing to draw."));
      root.removeAttribute("aria-busy");
    } else if (drawn === null) {
      fill(list);
      part.run();
    } else renew.hidden = list.hasAttribute("aria-busy") || end() === drawn;
  });
  return part.end;
}

function section(id, words) {
  const title = h("h2", { id: `part-${id}`, tabindex: "-1" }, words);
  const body = h("div", { class: "part-body", "aria-busy": LATE.has(id) ? "true" : null });
  return { title, body, section: h("section", { class: `card part part-${id}`, "aria-labelledby": `part-${id}` }, title, body) };
}
