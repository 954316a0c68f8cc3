// The line under the header that is always visible: link, age of the data, data gaps, losses, faults.

import { fill, h } from "./dom.js";
import * as format from "./format.js";
import { on, store } from "./store.js";

/** Difference between the clocks that is worth a note, s. */
const OFF_S = 60;
/** Age above which data that keep coming are not called fresh, s. */
const PLAYED_S = 3600;

const item = (state, name, words, title) => h("span", { class: `health ${state}`, title }, h("span", { class: "dot", "aria-hidden": "true" }), h("b", null, name), " ", words);

function link(live) {
  const heard = live.heard_ms ? format.time(live.heard_ms + (store.skew_ms ?? 0)) : null;
  if (live.state === "live") return item("good", "Live", `last update ${heard}`);
  if (live.state === "connecting") return item("wait", "Connecting", "…");
  const since = heard ? `no update since ${heard}` : "no update yet";
  return item("bad", "Stale", `${since}, reconnecting (${live.why})`);
}

// The age comes with the site, since a loop's row is not sent again only for its age.
function age({ silent_loops: silent, oldest_loop: name, oldest_age_s: oldest }) {
  if (oldest === null || oldest === undefined) return item("wait", "Data", "none yet");
  const link = name && h("a", { href: `#/loop/${encodeURIComponent(name)}` }, name);
  if (silent) return item("warn", "Data", [`${format.count(silent, "loop")} silent; longest `, link, oldest > 0 ? ` for ${format.duration(oldest)}` : ""]);
  if (oldest < -OFF_S) return item("good", "Data", `fresh${store.site?.note ? "" : `; plant time is ${format.duration(-oldest)} ahead of the clock`}`);
  const words = `at most ${format.duration(Math.max(1, Math.ceil(oldest)))} old`;
  // Data that keep coming but are hours old are played back or late, which does not deserve a green light.
  return oldest > PLAYED_S ? item("wait", "Data", `${words}: played back, or late`) : item("good", "Data", words);
}

const gaps = ({ data_gaps: n }) => (n ? item("warn", "Data gaps", format.integer(n)) : item("good", "Data gaps", "none"));

const LOSSES = [
  ["dropped_input", "message dropped", "messages dropped"],
  ["fits_skipped", "fit skipped", "fits skipped"],
  ["dropped_output", "document not published", "documents not published"],
  ["recording_lost", "message not recorded", "messages not recorded"],
];

function drops({ dropped: samples }) {
  const parts = samples ? [format.count(samples, "sample")] : [];
  for (const [key, one, many] of LOSSES) {
    const n = store.site?.loss?.[key] ?? 0;
    if (n) parts.push(format.count(n, one, many));
  }
  return parts.length ? item("warn", "Dropped", parts.join(", "), "Dropped samples were duplicate, late, or had implausible timestamps. The other counts are since the start.") : item("good", "Dropped", "none");
}

function faults() {
  const all = store.site?.faults ?? [];
  if (!all.length) return item("good", "Faults", "none");
  return item("bad", format.count(all.length, "fault"), all.join("; "));
}

/** Keeps the line up to date. */
export function strip(root, live) {
  let said = live.state;
  const spoken = h("span", { class: "unseen", role: "status" });
  const inside = h("div", { class: "strip-in", tabindex: "0", role: "group", "aria-label": "Connection and data health" });
  root.append(inside, spoken);
  const draw = () => {
    root.hidden = store.site?.kind === "workbench";
    document.body.classList.toggle("stale", live.state === "lost");
    const data = store.site?.data ?? {};
    // Faults come first, where a narrow screen shows them.
    const rank = (node) => ["bad", "warn", "wait", "good"].findIndex((state) => node.classList.contains(state));
    const health = [age(data), gaps(data), drops(data), faults()].sort((a, b) => rank(a) - rank(b));
    if (store.site?.note) health.push(item("wait", "Note", store.site.note));
    const all = [link(live), ...health];
    while (inside.children.length > all.length) inside.lastChild.remove();
    all.forEach((node, k) => {
      const old = inside.children[k];
      // Replace only what changed, so that a focused link keeps the focus.
      if (!old) inside.append(node);
      else if (!old.isEqualNode(node)) old.replaceWith(node);
    });
    if (said !== live.state) {
      said = live.state;
      fill(spoken, said === "live" ? "The connection is back." : inside.firstChild.textContent);
    }
  };
  const soon = () => {
    if (!draw.waiting) draw.waiting = setTimeout(() => { draw.waiting = null; draw(); }, 100);
  };
  // Elements that stick below this line need its height.
  new ResizeObserver(() => document.documentElement.style.setProperty("--head", `${Math.floor(root.getBoundingClientRect().bottom)}px`)).observe(root);
  for (const name of ["site", "link"]) on(name, soon);
  setInterval(soon, 1000);
  draw();
}
