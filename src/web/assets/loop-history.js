// One valve over many windows: bands with intervals, pooled estimate, changes, windows that contradict.

import * as api from "./api.js";
import { line } from "./charts.js";
import { fill, h, loading } from "./dom.js";
import * as format from "./format.js";
import { on, store } from "./store.js";
import { opUnit } from "./words.js";

const KINDS = { repaired: "no longer detected", better: "better since", worse: "worse since" };
/** Pause between two automatic loads from the recordings, ms. */
const CALM_MS = 30_000;
const PARTS = ["s", "fs", "fd"];

function columns(windows) {
  const data = { x: windows.map((w) => w.end_ms), p: windows.map((w) => w.p_stiction) };
  for (const key of PARTS) {
    data[key] = windows.map((w) => w[key] ?? null);
    data[`${key}_lo`] = windows.map((w) => w[`${key}_interval`]?.[0] ?? null);
    data[`${key}_hi`] = windows.map((w) => w[`${key}_interval`]?.[1] ?? null);
  }
  return data;
}

function pooledWords(over, unit) {
  const { pooled } = over;
  if (!pooled) return null;
  const since = over.since_ms ? ` since ${format.day(over.since_ms)}` : "";
  return h("dl", { class: "facts" },
    h("div", null, h("dt", null, h("i", null, "s"), `, pooled over ${format.count(pooled.windows, "window")}${since}`), h("dd", null, format.estimate(pooled.s, pooled.s_interval, unit))),
    h("div", null, h("dt", null, h("i", null, "j"), ", pooled"), h("dd", null, format.estimate(pooled.j, pooled.j_interval, unit))));
}

function changes(over, unit) {
  if (!over.changes.length) return null;
  return h("ul", { class: "changes" }, over.changes.map((c) => h("li", { class: c.kind },
    h("b", null, `${c.kind === "repaired" ? "No longer detected" : c.kind === "better" ? "Better" : "Worse"}`),
    `: s changed from ${format.number(c.s_before)} to ${format.number(c.s_after)} ${unit} between ${format.dateTime(c.from_ms)} and ${format.dateTime(c.to_ms)} (p ${format.probability(c.p)}).`)));
}

function contradicting(over, unit) {
  if (!over.contradicting.length) return null;
  return h("details", null, h("summary", null, `${format.count(over.contradicting.length, "window contradicts", "windows contradict")} the others (ringed)`),
    h("ul", null, over.contradicting.map((c) => h("li", null, `${format.dateTime(c.end_ms)}: s ${format.estimate(c.s, c.s_interval, unit)}; ${c.why}`))));
}

/** Fills the section; returns a cleanup function. */
export function overTime(root, loop) {
  let charts = [];
  let over = null;
  const unit = () => opUnit(store.rows.get(loop.name) ?? loop.document?.row);
  const said = h("div", { class: "over-words" });
  const words = () => (over ? [over.sentences.map((t) => h("p", { class: "lead" }, format.sentence(t))), pooledWords(over, unit()), changes(over, unit()), contradicting(over, unit())] : null);
  const destroy = () => {
    charts.forEach((c) => c.destroy());
    charts = [];
  };
  const marks = () => (over?.changes ?? []).map((c) => ({ x: c.at_ms, label: KINDS[c.kind], ink: c.kind === "worse" ? "--error" : "--fit" }));
  const rings = () => (over?.contradicting ?? []).map((c) => ({ x: c.end_ms, y: c.s, ink: "--error" }));
  const spans = () => (over?.changes ?? []).map((c) => ({ from: c.from_ms, to: c.to_ms, ink: c.kind === "worse" ? "--error" : "--fit" }));

  let drawn = null;

  function build(history) {
    const { windows } = history;
    const data = columns(windows);
    const has = (key) => data[key].some((v) => v !== null);
    const shape = JSON.stringify([windows.length > 0, ...["s", "fs", "p"].map(has), history.complete]);
    if (shape === drawn && charts.length) {
      // The same charts with newer windows, so keep the reader's zoom.
      fill(said, words());
      charts.forEach((c) => c.setData(data, { keepView: true }));
      return;
    }
    drawn = shape;
    destroy();
    if (!windows.length) {
      fill(root, h("p", { class: "note" }, "No window yet. The first window needs enough periods of the oscillation."));
      return;
    }
    fill(said, words());
    const left = h("div", { class: "over-charts" });
    const missing = history.complete ? null : h("p", { class: "soft small" }, "The recordings do not go back to the start.");
    fill(root, said, left, missing);
    const sync = `history ${loop.name}`;
    const band = (key, label, ink) => ({ key, label, ink, unit: unit(), points: windows.length < 60, lo: `${key}_lo`, hi: `${key}_hi` });
    charts = [
      has("s") && line(left, { label: "s over time with its interval", height: 190, sync, least: 0, yLabel: unit(), marks: () => [...marks(), ...rings()], spans, series: [band("s", "s", "--error")] }),
      has("fs") && line(left, { label: "fs and fd over time with their intervals", height: 190, sync, least: 0, yLabel: unit(), marks, spans, series: [band("fs", "fs", "--op"), band("fd", "fd", "--mv")] }),
      has("p") && line(left, { label: "Probability of stiction over time", height: 120, sync, least: 0, yLabel: "p", series: [{ key: "p", label: "p of stiction", ink: "--pv", points: windows.length < 60 }] }),
    ].filter(Boolean);
    charts.forEach((c) => c.setData(data));
  }

  const load = async () => {
    const [history, pooled] = await Promise.all([api.get(loop.path("/history")), api.get(loop.path("/over-time")).catch(() => null)]);
    over = pooled;
    return history;
  };
  const part = loading(root, load, build, { lines: 6, calm_ms: CALM_MS });
  part.run();
  const off = on("estimate", (e) => e.loop === loop.name && part.run());
  return () => {
    off();
    part.end();
    destroy();
  };
}
