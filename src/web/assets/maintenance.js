// Maintenance: which valves to work on first, as a table with details on click; and whether earlier work helped.

import * as api from "./api.js";
import { figureCell, fill, h, loading, prose } from "./dom.js";
import * as format from "./format.js";
import { on } from "./store.js";
import { METHODS } from "./words.js";

/** Pause between two loads of the daemon's list while rows change or figures are computed, ms. */
const PAUSE_MS = 10000;
const NO_AREA = "No area";

const link = (name) => h("a", { href: `#/loop/${encodeURIComponent(name)}` }, name);

/** The list in groups: a single one by rank, or one for each area, ordered by the best rank. */
export function groups(work, byArea) {
  if (!byArea) return work.length ? [{ title: null, work }] : [];
  const areas = new Map();
  for (const item of work) {
    const title = item.area ?? NO_AREA;
    areas.set(title, [...(areas.get(title) ?? []), item]);
  }
  return [...areas].map(([title, list]) => ({ title, work: list }));
}

const COLUMNS = ["rank", "valve", "s", "stiction", "benefit of a repair", "next step"];

/** A valve's row, and its sentences below it. */
function entry(item) {
  const place = [item.equipment, item.area, item.alarm ? "alarm active" : null].filter(Boolean).join(", ");
  const line = (words, text) => h("p", null, h("b", null, `${words}: `), prose(format.sentence(text)));
  const texts = h("div", { class: "work-texts" }, line("Do", item.what_to_do), line("Why", item.why), line("How sure", item.sure));
  const more = h("button", { class: "button quiet", type: "button", "aria-expanded": "false", "aria-label": `Details of ${item.loop}`, onclick: () => {
    below.hidden = !below.hidden;
    const words = below.hidden ? "Details" : "Less";
    more.setAttribute("aria-expanded", String(!below.hidden));
    more.setAttribute("aria-label", `${words} of ${item.loop}`);
    fill(more, words);
  } }, "Details");
  const cell = (k, ...inside) => h("td", { "data-label": COLUMNS[k] }, inside);
  const below = h("tr", { class: "work-more", hidden: true }, h("td", { colspan: String(COLUMNS.length) }, texts));
  return [h("tr", { class: "work", "data-loop": item.loop },
    cell(0, String(item.rank)),
    h("th", { scope: "row" }, link(item.loop), place ? h("small", { class: "soft under-words" }, place) : null),
    cell(2, item.size ?? "–"), cell(3, item.probability ?? "–"), cell(4, item.benefit ?? "–"),
    cell(5, h("span", null, item.next_step ?? "–"), " ", more)), below];
}

const section = ({ title, work }) => h("section", { class: "work-group" }, title ? h("h2", null, title) : null,
  h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": `Valves to work on${title ? `, ${title}` : ""}` }, h("table", { class: "table stacked works" },
    h("thead", null, h("tr", null, COLUMNS.map((words) => h("th", { scope: "col" }, words)))),
    h("tbody", null, work.flatMap(entry)))));

const both = (outcome, key, show) => figureCell(outcome ? [`${show(outcome.before[key])} → ${show(outcome.after[key])}`, ""] : ["–", ""]);

function reviewedRow(review) {
  const { outcome } = review;
  const how = [review.label === "repaired" ? "repaired" : METHODS[review.method] ?? review.method, review.by].filter(Boolean).join(", ");
  return h("tr", { "data-loop": review.loop }, h("th", { scope: "row" }, link(review.loop)),
    h("td", null, format.day(review.work_at_ms ?? review.at_ms), h("small", { class: "soft under-words" }, how)),
    both(outcome, "p", format.probability), both(outcome, "s", format.number), both(outcome, "pv_sd", format.number),
    h("td", null, outcome ? format.sentence(outcome.words) : "Being compared.", review.complete ? null : " Not all recordings could be read."));
}

function reviewedTable(reviewed) {
  const column = (words, props) => h("th", { scope: "col", ...props }, words);
  const number = { class: "number" };
  return [h("h2", null, "Before and after a repair or review"),
    h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Before and after a repair or review, table" }, h("table", { class: "table reviewed" },
      h("thead", null, h("tr", null, column("loop"), column("date"), column("probability", number), column("s, OP units", number), column("standard deviation of PV", number), column("since then"))),
      h("tbody", null, reviewed.map(reviewedRow))))];
}

/** Shows the list; returns a cleanup function. */
export function show(root) {
  let answer = null;
  let byArea = false;
  const list = h("div");
  const past = h("div");
  const figure = h("p", { role: "status" });
  const button = (words, area) => h("button", { class: "chip", type: "button", "aria-pressed": String(byArea === area), onclick: () => { byArea = area; draw(); chips.querySelector("[aria-pressed=true]").focus(); } }, words);
  const chips = h("div", { class: "chips", role: "group", "aria-label": "Grouping" });
  fill(root, h("h1", null, "Maintenance"),
    h("p", { class: "soft" }, "Valves that may need work, the costliest to leave first. A valve that is missing here is not proven healthy. OP is the controller's output, PV is what the loop controls, and s is how far OP must move before the valve follows."),
    h("div", { class: "filters" }, h("div", { class: "row spread" }, chips, h("div", { class: "row" },
      h("a", { class: "button", href: api.url("/maintenance?format=csv"), download: "maintenance.csv" }, "Save (CSV)"),
      h("button", { class: "button", type: "button", onclick: () => print() }, "Print")))),
    figure, list, past);

  function draw() {
    const open = new Set([...list.querySelectorAll(".work button[aria-expanded=true]")].map((b) => b.closest("tr").dataset.loop));
    const held = root.contains(document.activeElement) ? document.activeElement.getAttribute("href") : null;
    fill(chips, button("By valve", false), button("By area", true));
    const { work, reviewed, pending } = answer;
    fill(figure, work.length ? `${format.count(work.length, "valve")}.` : "No valve is listed.", pending ? ` Still computing: ${format.integer(pending)}.` : null);
    fill(list, groups(work, byArea).map(section));
    for (const name of open) list.querySelector(`[data-loop="${CSS.escape(name)}"] button`)?.click();
    fill(past, reviewed.length ? reviewedTable(reviewed) : null);
    if (held) root.querySelector(`a[href="${CSS.escape(held)}"]`)?.focus({ preventScroll: true });
  }

  let later = null;
  const soon = () => { later ??= setTimeout(() => { later = null; part.run(true); }, PAUSE_MS); };
  const part = loading(list, () => api.get("/maintenance"), (found) => {
    answer = found;
    draw();
    if (found.pending) soon();
  });
  part.run();
  const ends = [on("rows", soon), on("back", () => part.run(true))];
  return () => {
    clearTimeout(later);
    [part.end, ...ends].forEach((end) => end());
  };
}
