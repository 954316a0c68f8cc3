// Why: the sentences behind the verdict, the limits of the window, the indicators and their sum, the model.

import { fill, h } from "./dom.js";
import * as format from "./format.js";
import { plain } from "./words.js";

const signed = (v) => (v > 0 ? "+" : v < 0 ? "" : "±") + format.number(v);

function bar(value, most) {
  const inside = h("span", { class: value > 0 ? "for" : "against" });
  inside.style.width = `${(Math.abs(value) / most) * 50}%`;
  return h("span", { class: "logit", "aria-hidden": "true" }, inside);
}

function indicators(list, estimate) {
  if (!list.length) return null;
  const most = Math.max(...list.map((i) => Math.abs(i.contribution ?? 0)), 1e-9);
  const sorted = [...list].sort((a, b) => Math.abs(b.contribution ?? 0) - Math.abs(a.contribution ?? 0));
  const vote = (i) => (i.vote === null || !i.contribution ? "not used" : i.vote ? "to sticking" : "away from it");
  const rows = sorted.map((i) => h("tr", null, h("th", { scope: "row" }, plain(i.name), h("small", { class: "soft asks" }, format.sentence(i.words))), h("td", { class: "number" }, format.number(i.score)), h("td", { class: "nowrap says" }, vote(i)), h("td", { class: "number" }, signed(i.contribution ?? 0)), h("td", null, bar(i.contribution ?? 0, most))));
  const { base, logit } = estimate?.explanation ?? {};
  const sum = logit === undefined ? null : h("p", { class: "soft" }, `The contributions are log-odds. They start from ${signed(base)} and add up to ${signed(logit)}, which is the probability ${format.probability(estimate.p_calibrated ?? estimate.p_stiction)} where half of the valves stick. ${assumed(estimate)}`, estimate.explanation.cuts ? `Decision threshold ${format.probability(estimate.explanation.cuts.called)}; a window counts towards an alarm at ${format.probability(estimate.explanation.cuts.alarm)} or more.` : "");
  return h("details", null, h("summary", null, "Indicators and log-odds"), h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Indicators" }, h("table", { class: "table indicators" },
    h("thead", null, h("tr", null, h("th", { scope: "col" }, "indicator"), h("th", { scope: "col", class: "number" }, "score"), h("th", { scope: "col", class: "says" }, "points"), h("th", { scope: "col", class: "number" }, "log odds"), h("td", null))),
    h("tbody", null, rows))), sum);
}

/** The assumption behind the displayed probability. Documents of earlier builds have only the calibrated one. */
const assumed = (e) => (e.prevalence === undefined ? "" : `Where ${format.percent(e.prevalence)} stick, as is assumed for this plant, it is ${format.probability(e.p_stiction)}. `);

function model(e, row) {
  const p = e?.process;
  if (!p) return null;
  const pv = row.pv_unit ?? "PV units";
  const op = row.op_unit ?? "OP units";
  const item = (term, value) => h("div", null, h("dt", null, term), h("dd", null, value));
  const c = e.controller;
  return [h("h3", null, "Model"), h("dl", { class: "facts" },
    ...(p.tested === false ? [item("Process", "not given: the record does not test a model")] : [
    item("Process", `order ${p.order}${p.integrating ? ", integrating" : ""}`),
    item("Gain", `${format.number(p.gain)} ${pv} per ${op}${p.integrating ? " and second" : ""}`),
    item("Time constants", p.time_constants_s.map((t) => format.duration(t)).join(", ") || "none"),
    item("Dead time", format.duration(p.dead_time_s)),
    item("Fit", `${format.number(p.fit_pct)} % of PV’s movement`)]),
    c ? item("Controller", `gain ${format.number(c.kc)}, ${c.ti_s === null ? "no integral action seen" : `integral time ${format.duration(c.ti_s)}`}${c.td_s ? `, derivative time ${format.duration(c.td_s)}` : ""}`) : null,
    c ? item("Read from the record", `explains ${format.percent(c.r2)} of OP’s moves`) : null)];
}

/** Fills the section from every new document. */
export function why(root, loop) {
  fill(root, h("p", { class: "soft" }, "…"));
  loop.onDocument(({ words, estimate, row }) => {
    if (!estimate) {
      fill(root, h("p", { class: "note" }, words?.verdict ?? "No window yet."));
      return;
    }
    fill(root,
      words.why.length ? h("ul", { class: "reasons" }, words.why.map((t) => h("li", null, format.sentence(t)))) : null,
      words.gates.length ? [h("h3", null, "Limits of this window"), h("ul", null, words.gates.map((g) => h("li", null, h("b", null, plain(g.name)), ": ", format.sentence(g.words))))] : h("p", { class: "soft" }, "No validity check limits this window."),
      indicators(words.indicators ?? [], estimate),
      model(estimate, row));
  });
}
