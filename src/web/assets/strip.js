// The line under the header that is always in sight: link, age of the data, holes, losses, faults.

import { fill, h } from "./dom.js";
import * as format from "./format.js";
import { on, store } from "./store.js";

/** Age from which data count as old, s. */
const OLD_S = 60;

const item = (state, name, words, title) => h("span", { class: `health ${state}`, title }, h("span", { class: "dot", "aria-hidden": "true" }), h("b", null, name), " ", words);

function link(live) {
  const heard = live.heard_ms ? format.time(live.heard_ms + (store.skew_ms ?? 0)) : null;
  if (live.state === "live") return item("good", "Live", `last news ${heard}`);
  if (live.state === "connecting") return item("wait", "Connecting", "…");
  const since = heard ? `no news since ${heard}` : "no news yet";
  return item("bad", "Stale", `${since}, reconnecting (${live.why})`);
}

function age(rows) {
  const aged = rows.filter((r) => r.data_age_s !== null);
  if (!aged.length) return item("wait", "Data age", "no data yet");
  const worst = aged.reduce((a, b) => (b.data_age_s > a.data_age_s ? b : a));
  const old = aged.filter((r) => r.data_age_s > OLD_S).length;
  if (!old) return item("good", "Data", `at most ${format.duration(Math.max(1, Math.ceil(worst.data_age_s)))} old`);
  return item("warn", "Data", [`${format.count(old, "loop")} older than ${format.duration(OLD_S)}; worst `,
    h("a", { href: `#/loop/${encodeURIComponent(worst.name)}` }, worst.name), ` ${format.duration(worst.data_age_s)}`]);
}

function holes(rows) {
  const holed = rows.filter((r) => r.data_gaps > 0);
  const n = holed.reduce((sum, r) => sum + r.data_gaps, 0);
  return n ? item("warn", "Holes", `${format.integer(n)} in ${format.count(holed.length, "loop")}`) : item("good", "Holes", "none");
}

const LOSSES = [
  ["dropped_input", "message not taken in", "messages not taken in"],
  ["fits_skipped", "fit skipped", "fits skipped"],
  ["dropped_output", "document not sent", "documents not sent"],
  ["recording_lost", "record lost", "records lost"],
];

function drops(rows) {
  const samples = rows.reduce((sum, r) => sum + (r.dropped ?? 0), 0);
  const parts = samples ? [format.count(samples, "sample")] : [];
  for (const [key, one, many] of LOSSES) {
    const n = store.site?.loss?.[key] ?? 0;
    if (n) parts.push(format.count(n, one, many));
  }
  return parts.length ? item("warn", "Dropped", parts.join(", "), "Samples dropped: double, late, or stamped far off. The other counts are since the start.") : item("good", "Dropped", "none");
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
  const inside = h("div", { class: "strip-in" });
  root.append(inside, spoken);
  const draw = () => {
    root.hidden = store.site?.kind === "workbench";
    document.body.classList.toggle("stale", live.state === "lost");
    const rows = [...store.rows.values()];
    // What is wrong stands in front, where a narrow screen shows it.
    const rank = (node) => ["bad", "warn", "wait", "good"].findIndex((state) => node.classList.contains(state));
    const health = [age(rows), holes(rows), drops(rows), faults()].sort((a, b) => rank(a) - rank(b));
    [link(live), ...health].forEach((node, k) => {
      const old = inside.children[k];
      // Only what changed is replaced: a link that has the focus keeps it.
      if (!old) inside.append(node);
      else if (!old.isEqualNode(node)) old.replaceWith(node);
    });
    if (said !== live.state) {
      said = live.state;
      fill(spoken, said === "live" ? "The link is back." : inside.firstChild.textContent);
    }
  };
  const soon = () => {
    if (!draw.waiting) draw.waiting = setTimeout(() => { draw.waiting = null; draw(); }, 100);
  };
  for (const name of ["rows", "site", "link"]) on(name, soon);
  setInterval(soon, 1000);
  draw();
}
