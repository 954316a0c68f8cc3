// Trend of a loop, live or from the recordings, and its phase plot.

import * as api from "./api.js";
import { line, phase } from "./charts.js";
import { fill, h, problem, single } from "./dom.js";
import * as format from "./format.js";
import { on, store } from "./store.js";
import { opUnit } from "./words.js";

const RANGES = [["window", "Live window", null], ["1h", "1 h", 3600], ["8h", "8 h", 28800], ["1d", "1 d", 86400], ["7d", "7 d", 604800], ["30d", "30 d", 2592000]];
const POINTS = 1600;
/** Time range of the chart for a loop without a window, ms. */
const LEAST_SPAN_MS = 600_000;
/** Samples of the stream that are kept while a window is being loaded. */
const KEPT = 2000;
/** Missing sampling times that count as a data gap. */
const HOLE_STEPS = 5;
/** Pause after a zoom before finer data are requested, ms. */
const SETTLE_MS = 350;

const COLUMNS = ["pv", "sp", "pv_fit", "op", "valve", "mv"];

class Trend {
  constructor(root, loop) {
    this.loop = loop;
    this.range = RANGES[0];
    this.data = null;
    this.kept = [];
    this.turn = 0;
    const row = store.rows.get(loop.name);
    const sync = `trend ${loop.name}`;
    const refine = (from, to) => this.refine(from, to);
    const onReset = () => this.range[2] && this.load(true);
    this.note = h("p", { class: "soft small", "aria-live": "off" });
    this.buttons = h("div", { class: "row segments", role: "group", "aria-label": "Range" });
    const left = h("div", { class: "trend-charts" });
    const right = h("div", { class: "trend-phase" });
    fill(root, h("div", { class: "row spread" }, this.buttons, this.note), h("div", { class: "trend-parts" }, left, right));
    this.failed = h("div");
    left.append(this.failed);
    this.pv = line(left, { label: `Process variable of ${loop.name}`, height: 210, sync, onView: refine, onReset, yLabel: row?.pv_unit ?? "PV", series: [
      { key: "sp", label: "SP", ink: "--sp", dash: [5, 4], stepped: true, unit: row?.pv_unit },
      { key: "pv", label: "PV", ink: "--pv", width: 1.5, unit: row?.pv_unit },
      { key: "pv_fit", label: "PV fitted", ink: "--fit", width: 1.2, unit: row?.pv_unit }] });
    this.op = line(left, { label: `Controller output of ${loop.name}`, height: 190, sync, onView: refine, onReset, yLabel: opUnit(row), series: [
      { key: "op", label: "OP", ink: "--op", unit: row?.op_unit },
      { key: "mv", label: "valve measured", ink: "--other", unit: row?.op_unit },
      { key: "valve", label: "valve fitted", ink: "--mv", stepped: true, unit: row?.op_unit }] });
    left.append(h("p", { class: "soft small hint" }, "Drag to zoom, Shift-drag to pan, click then scroll to zoom, double-click to show all."));
    this.phase = new Phase(right, loop);
    this.drawButtons();
    const renew = single(() => this.load());
    this.off = [on("samples", (samples) => this.append(samples)), on("estimate", (e) => e.loop === loop.name && !this.range[2] && renew()), on("back", () => renew(true))];
    this.load();
  }

  drawButtons() {
    fill(this.buttons, RANGES.map((range) => h("button", { class: "button", type: "button", "aria-pressed": String(range === this.range), onclick: () => this.choose(range) }, range[1])));
  }

  choose(range) {
    this.range = range;
    this.drawButtons();
    this.buttons.querySelector("[aria-pressed=true]").focus();
    this.load(true);
  }

  /** End of the ranges, ms: now, or the newest sample if plant time is ahead of the clock. */
  newest() {
    const row = store.rows.get(this.loop.name);
    return Math.max(Date.now() + (store.skew_ms ?? 0), row?.window_end_ms ?? 0, this.last ?? 0);
  }

  async load(whole = false) {
    const to = Math.ceil(this.newest());
    const path = this.range[2] ? `/trend?from_ms=${to - this.range[2] * 1000}&to_ms=${to}&points=${POINTS}` : "/window";
    await this.fetch(path, !whole);
  }

  /** Loads finer data for the visible range, with room on both sides for panning. */
  refine(from, to) {
    clearTimeout(this.settle);
    if (!this.range[2]) return;
    this.settle = setTimeout(() => {
      const room = (to - from) / 2;
      const [start, end] = [Math.floor(from - room), Math.ceil(to + room)];
      this.fetch(`/trend?from_ms=${start}&to_ms=${end}&points=${POINTS * 2}`, true);
    }, SETTLE_MS);
  }

  async fetch(path, keepView) {
    const mine = ++this.turn;
    const { range } = this;
    fill(this.note, this.data ? "loading …" : "");
    try {
      const answer = await api.get(this.loop.path(path));
      // Use the answer unless a later one is already shown or another range was chosen.
      if (this.ended || mine < (this.taken ?? 0) || range !== this.range) return;
      this.taken = mine;
      fill(this.failed);
      this.take(answer, keepView);
    } catch (error) {
      if (this.ended || range !== this.range) return;
      fill(this.note);
      fill(this.failed, problem(error.message, () => this.load(true)));
    }
  }

  take(answer, keepView) {
    this.data = { x: answer.t_ms, ...Object.fromEntries(COLUMNS.map((c) => [c, answer[c] ?? null])) };
    const points = answer.t_ms.length;
    this.last = Math.max(this.last ?? 0, answer.t_ms[points - 1] ?? 0);
    const words = !points ? "No samples yet." : answer.complete === false ? "The recordings cover only part of this range." : answer.valve ? "The fitted valve comes from the last fit." : "";
    fill(this.note, words);
    this.step_ms = answer.ts_s ? answer.ts_s * 1000 : null;
    this.draw(keepView);
    if (this.range[2]) return;
    if (points) this.phase.take(answer);
    for (const samples of this.kept) this.grow(samples);
  }

  draw(keepView) {
    const columns = Object.fromEntries(Object.entries(this.data).filter(([, v]) => v));
    for (const chart of [this.pv, this.op]) chart.setData(columns, { keepView });
  }

  /** Appends new samples on the right and removes as many on the left. */
  append(samples) {
    this.last = Math.max(this.last ?? 0, samples.t_ms[samples.t_ms.length - 1] ?? 0);
    this.keep(samples);
    if (this.data && !this.range[2]) this.grow(samples);
  }

  /** Keeps the newest samples, since the window may be loaded after samples that follow it. */
  keep(samples) {
    this.kept.push(samples);
    let n = this.kept.reduce((sum, s) => sum + s.t_ms.length, 0);
    while (n > KEPT) n -= this.kept.shift().t_ms.length;
  }

  grow(samples) {
    const { x } = this.data;
    const last = x[x.length - 1] ?? -Infinity;
    const span = Math.max(last - x[0] || 0, LEAST_SPAN_MS);
    samples.t_ms.forEach((t, k) => {
      const before = x[x.length - 1] ?? -Infinity;
      if (t <= before) return;
      if (this.step_ms && t - before > HOLE_STEPS * this.step_ms && x.length) this.hole(before + this.step_ms);
      x.push(t);
      for (const c of COLUMNS) this.data[c]?.push(samples[c]?.[k] ?? null);
    });
    while (x.length > 2 && x[x.length - 1] - x[0] > span && x[x.length - 1] - x[1] >= span) {
      x.shift();
      for (const c of COLUMNS) this.data[c]?.shift();
    }
    if (!(x[x.length - 1] > last)) return;
    fill(this.note, `Live: newest sample ${format.stamp(x[x.length - 1])}.${this.data.valve ? " The fitted valve comes from the last fit." : ""}`);
    this.draw(true);
  }

  /** Interrupts lines where data are missing. */
  hole(t) {
    this.data.x.push(t);
    for (const c of COLUMNS) this.data[c]?.push(null);
  }

  end() {
    clearTimeout(this.settle);
    this.ended = true;
    this.off.forEach((off) => off());
    this.pv.destroy();
    this.op.destroy();
  }
}

class Phase {
  constructor(root, loop) {
    this.loop = loop;
    const row = store.rows.get(loop.name);
    this.out = h("output", { for: "lag" });
    this.slider = h("input", { id: "lag", type: "range", min: "0", max: "60", value: "0", oninput: () => { this.moved = true; this.draw(); } });
    this.fitted = h("input", { type: "checkbox", onchange: () => this.draw() });
    this.fittedLabel = h("label", { class: "inline", hidden: true }, this.fitted, " fitted valve");
    root.append(h("h3", null, "Phase plot of the live window"));
    this.plot = phase(root, { label: "Phase plot, PV over OP", xLabel: `OP${row?.op_unit ? `, ${row.op_unit}` : ""}`, yLabel: `PV${row?.pv_unit ? `, ${row.pv_unit}` : ""}` });
    root.append(h("div", { class: "row" }, h("label", { for: "lag" }, "Shift PV back by "), this.slider, this.out), this.fittedLabel,
      h("p", { class: "soft small" }, "The process lag opens this plot whether or not the valve sticks. With PV shifted back, OP of a sticking valve gives a parallelogram where the lag is short against the period; over the fitted valve position only the lag is left."));
  }

  take(window) {
    this.window = window;
    const period = this.loop.document?.row?.period_s;
    this.slider.max = String(Math.max(10, Math.min(400, Math.round((period ? period / window.ts_s : 120) * 0.75))));
    if (!this.moved) this.slider.value = String(window.lag_points ?? 0);
    this.fittedLabel.hidden = !window.valve;
    this.draw();
  }

  draw() {
    if (!this.window) return;
    const { op, pv, valve, ts_s } = this.window;
    const lag = Number(this.slider.value);
    const words = `${lag} × ${format.duration(ts_s)} = ${format.duration(lag * ts_s)}`;
    fill(this.out, ` ${lag ? words : "nothing"}`);
    this.slider.setAttribute("aria-valuetext", lag ? format.duration(lag * ts_s) : "nothing");
    const shifted = pv.slice(lag);
    const cut = (list) => list.slice(0, shifted.length);
    this.plot.set({ x: cut(op), y: shifted, other: this.fitted.checked && valve ? { x: cut(valve), y: shifted } : null });
  }
}

/** Fills the section; returns a cleanup function. */
export function trend(root, loop) {
  const view = new Trend(root, loop);
  return () => view.end();
}
