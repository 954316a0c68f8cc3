// The head of a loop's page: verdict, certainty, what to do, the main numbers, commands and downloads.

import * as api from "./api.js";
import { buttons, said } from "./actions.js";
import { fill, h, prose } from "./dom.js";
import * as format from "./format.js";
import { store } from "./store.js";
import { NE107, STATES, VERDICTS, neOf, opUnit, plain, symbol, verdictOf } from "./words.js";

const fact = (term, ...value) => h("div", null, h("dt", null, term), h("dd", null, value));

function facts(row, estimate, words) {
  if (!estimate) return null;
  const unit = opUnit(row);
  const level = Math.round((estimate.interval_level ?? 0.9) * 100);
  // Sizes are shown in % of travel if OP's range is known.
  const [low, high] = estimate.op_range ?? [0, 100];
  const told = (v) => (v === null || v === undefined ? v : (100 * v) / Math.abs(high - low));
  const sizes = estimate.op_range ? "% of travel" : unit;
  const band = (key) => format.estimate(told(estimate[key]), estimate[`${key}_interval`]?.map(told), sizes);
  const list = [];
  if (row.probability) list.push(fact("Stiction", row.probability));
  list.push(fact("Grade", words?.grade ?? "–"));
  if (estimate.s !== null && estimate.stiction !== false) list.push(fact([h("i", null, "s"), " dead band plus stick band"], row.size ?? band("s")), fact([h("i", null, "j"), " slip jump"], estimate.j_identifiable === false ? `${band("j")}, not identifiable` : band("j")), fact([h("i", null, "fs"), " static band"], band("fs")), fact([h("i", null, "fd"), " kinetic band"], band("fd")));
  if (estimate.stiction_index !== null) list.push(fact("Stiction index", format.number(estimate.stiction_index)));
  if (estimate.severity_by_range && estimate.stiction) list.push(fact("Size", `${estimate.severity_by_range}, relative to travel`));
  else if (estimate.stiction && estimate.s_over_span) list.push(fact("Share of OP’s swing", format.percent(estimate.s_over_span)));
  if (estimate.s_detectable !== null && estimate.s_detectable !== undefined) list.push(fact("Detection limit of s", `${format.number(told(estimate.s_detectable))} ${sizes}`));
  if (estimate.oscillation?.period_s) list.push(fact("Period", `${format.duration(estimate.oscillation.period_s)}, ${format.number(estimate.oscillation.periods)} in the window`));
  const w = estimate.window;
  list.push(fact("Window", `${format.recent(format.millis(w.start))} to ${format.recent(format.millis(w.end))}, every ${format.duration(w.ts_s)}`));
  return h("div", null, h("dl", { class: "facts" }, list), estimate.s === null ? null : h("p", { class: "soft small" }, `${level} % intervals in brackets.`));
}

function todo(words, alarm) {
  const text = words?.what_to_do ?? (alarm?.active ? alarm.what_to_do : null);
  if (!text) return null;
  return h("div", { class: "todo" }, h("p", null, h("b", null, "What to do: "), prose(format.sentence(text))), words?.test ? h("details", { class: "test" }, h("summary", null, "Bump test"), h("ol", null, words.test.split("\n").map((step) => h("li", null, step.replace(/^\d+\. /, ""))))) : null);
}

// The verdict's sentence, if it says more than the title, and the size.
function lead(words, row) {
  const verdict = words?.verdict && words.verdict !== row.status ? `${row.stale ? "The last window" : "The newest window"}: ${words.verdict}` : null;
  const list = [verdict, words?.size].filter(Boolean);
  return list.length ? h("p", { class: "lead" }, list.map(format.sentence).join(" ")) : null;
}

function state(alarm) {
  if (!alarm || (alarm.state === "normal" && !alarm.active)) return h("span", { class: "soft" }, "no alarm");
  return h("span", { class: `state ${alarm.state}` }, `alarm ${STATES[alarm.state] ?? alarm.state}${alarm.priority ? `, ${alarm.priority} priority` : ""}`);
}

function downloads(loop) {
  const to = (rest, words, extra) => h("a", { class: "button", href: api.url(loop.path(rest)), ...extra }, words);
  return h("div", { class: "row buttons" },
    to("/window.csv", "Window as CSV", { download: "" }), to("/window.mcap", "Window as MCAP", { download: "" }),
    to("/sheet", "Evidence sheet", { target: "_blank", rel: "noopener" }));
}

/** Redraws the head if something changed. */
export function head(root, loop) {
  const { estimate, alarm, words, row: first } = loop.document;
  const row = store.rows.get(loop.name) ?? first;
  const key = JSON.stringify([estimate?.window?.end_ns, alarm?.event_id, row.ne107, row.status, row.stale, row.probability, row.size, row.driven, row.gates, loop.review, words]);
  if (key === root.dataset.key) return;
  const focus = document.activeElement && root.contains(document.activeElement) ? document.activeElement.getAttribute("aria-label") : null;
  root.dataset.key = key;
  const ne = neOf(row);
  const done = (_, review) => {
    if (review) loop.review = review;
    loop.announce(review ? "Kept." : "Done.");
    loop.reload(true);
  };
  const verdict = format.sentence(row.status || VERDICTS[verdictOf(row)].words);
  fill(root,
    h("p", { class: "crumbs" }, h("a", { href: "#/" }, "Overview"), " / ", row.area ? [h("a", { href: `#/?area=${encodeURIComponent(row.area)}` }, row.area), " / "] : null, row.name),
    h("div", { class: "loop-title" }, symbol(ne, 34), h("div", null, h("h1", null, row.name, h("span", { class: "headline-verdict" }, ` ${verdict}`)),
      h("p", null, h("span", { class: `ne-words ne-${ne}` }, NE107[ne].name), " · ", state(alarm), row.equipment ? ` · ${row.equipment}` : "", row.criticality ? ` · criticality ${row.criticality}` : ""))),
    row.driven ? h("p", { class: "driven" }, format.sentence(row.driven), " ", h("a", { href: `#/groups?loop=${encodeURIComponent(row.name)}` }, "Its group")) : null,
    lead(words, row),
    row.gates?.length ? h("p", { class: "warning" }, "Limits of this window: ", row.gates.map(plain).join(", "), ".") : null,
    todo(words, alarm),
    loop.review ? h("p", { class: "note" }, `${said(loop.review)} ${loop.review.by}.`) : null,
    h("div", { class: row.stale ? "old-answer" : null }, facts(row, estimate, words)),
    h("div", { class: "loop-acts" }, buttons(alarm ?? { loop: loop.name, state: "normal" }, { done, sticks: estimate?.stiction ?? null, window: Boolean(estimate) }), estimate ? downloads(loop) : null));
  if (focus) root.querySelector(`[aria-label="${CSS.escape(focus)}"]`)?.focus();
}
