// Result of a gap diagnosis: which effect, how far it closes the gap, PV with the free run before and after.

import { bySection, ways } from "./workbench-result.js";

/** Effects shown in the table at first. */
const MOST = 8;

function figures(h, format, d, unit) {
  const n = format.number;
  const pv = unit ?? "PV units";
  const closed = d.effects.find((e) => e.id === d.cause.id);
  const rows = [
    ["Gap above the noise", `${n(d.gap.gap)} ${pv}${d.gap.relative === null ? "" : `, ${n(100 * d.gap.relative)} % of PV's standard deviation`}`],
    ["RMS error, noise floor", `${n(d.gap.rmse)}, ${d.gap.noise_floor === null ? "not known" : n(d.gap.noise_floor)} ${pv}`],
    ["Closed by the effect", closed?.closed_pct !== undefined && closed.closed_pct !== null ? `${format.estimate(closed.closed_pct, closed.closed_interval, "%")}` : "–"],
    ["Forward prediction", d.forward ? `${n(d.forward.gap_before)} before, ${n(d.forward.gap_after)} after` : "–"],
    ["Model responses", `${format.integer(d.evaluations)}${d.stopped_early ? ", search stopped early" : ""}`],
  ];
  return h("dl", { class: "facts" }, rows.map(([name, value]) => h("div", null, h("dt", null, name), h("dd", null, value))));
}

function effects(h, format, d) {
  if (!d.effects.length) return null;
  const n = format.number;
  const row = (e) => h("tr", { class: e.id === d.cause.id ? "wb-named" : null },
    h("th", { scope: "row" }, e.id.replaceAll("_", " "), e.id === d.cause.id ? h("small", { class: "soft under" }, "named") : null),
    h("td", null, e.stage), h("td", { class: "number" }, n(e.evidence)),
    h("td", { class: "number" }, e.closed_pct === null ? "–" : format.estimate(e.closed_pct, e.closed_interval, "%")),
    h("td", null, Object.entries(e.parameters).map(([name, q]) => `${name.replaceAll("_", " ")} ${n(q.value)} ${q.unit ?? ""}`.trim()).join("; ") || "–"),
    h("td", null, e.confusable_with.map((id) => id.replaceAll("_", " ")).join(", ") || "–"));
  const table = (list, caption) => h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption }, h("table", { class: "table" }, h("caption", { class: "soft" }, caption),
    h("thead", null, h("tr", null, ["Effect", "Acts in", "Evidence", "Closes", "Parameters", "Indistinguishable from"].map((t, k) => h("th", { scope: "col", class: k === 2 || k === 3 ? "number" : null }, t)))),
    h("tbody", null, list.map(row))));
  const rest = d.effects.slice(MOST);
  return [table(d.effects.slice(0, MOST), "Best first; share closed on held-out blocks, with 90 % intervals"),
    rest.length ? h("details", null, h("summary", null, `${rest.length} more effects`), table(rest, "The others")) : null];
}

/** Ranges that no model was fitted to. */
function heldOut({ t_ms, held_out }) {
  const spans = [];
  let from = null;
  held_out.forEach((held, k) => {
    if (held && from === null) from = t_ms[k];
    if (!held && from !== null) {
      spans.push({ from, to: t_ms[k - 1], ink: "--other" });
      from = null;
    }
  });
  if (from !== null) spans.push({ from, to: t_ms[t_ms.length - 1], ink: "--other" });
  return spans;
}

/** The chart of PV with the free runs; returns a function that removes it. */
function runs(root, { api, charts, h, fill, units, problem }, result, name) {
  let chart = null;
  let ended = false;
  api.get(result.predictions_url.replace(/^.*\/api\/v1/, "")).then((data) => {
    if (ended) return;
    fill(root);
    const spans = heldOut(data);
    const unit = units[1];
    chart = charts.line(root, { label: `PV of ${name} with the free run before and after`, time: true, height: 260, yLabel: unit ? `PV, ${unit}` : "PV", spans: () => spans, series: [
      { key: "pv", label: "PV measured", ink: "--pv", unit },
      { key: "before", label: "Free run before", ink: "--other", unit, dash: [5, 4] },
      { key: "after", label: "Free run after", ink: "--fit", unit },
    ] });
    const same = data.pv_base.every((v, k) => v === data.pv_after[k]);
    chart.setData({ x: data.t_ms, pv: data.pv, before: data.pv_base, ...(same ? {} : { after: data.pv_after }) });
    root.append(h("p", { class: "soft" }, "Tinted: held-out stretches; only they count. ", same ? "No effect was added, so there is only one free run." : null));
  }, (error) => !ended && fill(root, problem(error.message)));
  return () => {
    ended = true;
    chart?.destroy();
  };
}

/** The answer in a few words. */
export function answer(format, d) {
  const p = `(p ${format.probability(d.cause.probability)})`;
  if (d.cause.id === "none") return `No effect needed: the base explains this record ${p}`;
  if (d.cause.id === "unknown") return `The record differs from the base, and no effect explains it ${p}`;
  const name = d.cause.id.replaceAll("_", " ");
  return `${name.charAt(0).toUpperCase()}${name.slice(1)} ${p}`;
}

/** Shows a diagnosis' results; returns a function that removes its charts. */
export function showGap(root, context, job) {
  const { h, fill, format, api, pictures } = context;
  const ends = [];
  const sections = bySection(job.results).map(([result]) => {
    const d = result.document;
    const title = job.results.length > 1 ? h("h3", null, result.section || "The whole record") : null;
    const notes = result.notes.map((note) => h("p", { class: d ? "note" : "problem" }, note));
    if (!d) return h("section", { class: "wb-section" }, title, notes);
    const short = result.words.find((w) => w.about === "In short")?.text;
    const below = job.results.length > 1 ? "h4" : "h3";
    const chart = h("div", { class: "wb-runs" });
    const drawn = h("div");
    if (result.pictures.length) pictures.show(drawn, result.pictures);
    else fill(drawn, h("p", { class: "soft" }, "Drawing the pictures."));
    const section = h("section", { class: "wb-section" }, title,
      h("p", { class: "wb-headline" }, answer(format, d)), h("p", { class: "lead" }, short), notes,
      figures(h, format, d, context.units[1]), chart,
      h(below, null, "Effects"), effects(h, format, d), h(below, null, "Pictures"), drawn,
      h("details", null, h("summary", null, "Output of the command"), h("pre", { tabindex: "0" }, result.text)),
      result.predictions_url ? h("a", { class: "button quiet", href: api.url(result.predictions_url.replace("/predictions?", "/predictions.csv?")), download: "predictions.csv" }, "Save free runs (CSV)") : null);
    if (result.predictions_url) ends.push(runs(chart, context, result, job.request.loop));
    return section;
  });
  fill(root, sections, ways(context, job, job.results));
  return () => ends.forEach((end) => end());
}
