// Line charts with uPlot: a legend with values at the cursor, zoom, pan, linked ranges, keyboard, and a table as an alternative.

import { fill, h } from "./dom.js";
import * as format from "./format.js";
import { gestures } from "./chart-gestures.js";
import { table } from "./chart-table.js";
import { drawMarks, drawSpans } from "./chart-marks.js";
import { ink, sheer } from "./ink.js";
import { on } from "./store.js";

export { phase } from "./chart-phase.js";

const groups = new Map();
const DAY_MS = 864e5;
/** Scale of the lines with their axis on the right. */
const RIGHT = "right";
/** Widest chart in print, px. */
const PAPER_WIDTH = 660;

function timeLabels(u, splits) {
  const step = splits.length > 1 ? splits[1] - splits[0] : 1000;
  let before = null;
  return splits.map((ms) => {
    const day = format.shortDay(ms);
    const text = step >= DAY_MS ? day : step < 60_000 ? format.time(ms) : format.minute(ms);
    const label = day !== before && step < DAY_MS ? `${text}\n${day}` : text;
    before = day;
    return label;
  });
}

const axis = (label, extra) => ({
  stroke: () => ink("--soft"),
  grid: { stroke: () => ink("--faint"), width: 1 },
  ticks: { show: false },
  font: "12px system-ui, sans-serif",
  ...(label ? { label, labelSize: 18, labelGap: 0, labelFont: "12px system-ui, sans-serif" } : {}),
  ...extra,
});

// uPlot's series: one for each line, plus two invisible ones around a line with an interval.
function plan(series) {
  const rows = [];
  const bands = [];
  for (const s of series) {
    const line = rows.length + 1;
    rows.push({ key: s.key, of: s, options: {
      label: s.label,
      scale: s.right ? RIGHT : "y",
      stroke: () => ink(s.ink),
      width: s.width ?? 1.5,
      dash: s.dash,
      paths: s.stepped ? uPlot.paths.stepped({ align: 1 }) : undefined,
      points: { show: s.points ?? false, size: 5, fill: () => ink(s.ink) },
    } });
    if (!s.lo) continue;
    for (const key of [s.hi, s.lo]) rows.push({ key, of: s, options: { scale: s.right ? RIGHT : "y", stroke: null, width: 0, points: { show: false } } });
    bands.push({ series: [line + 1, line + 2], fill: () => sheer(s.ink, 0.18) });
  }
  return { rows, bands };
}

/** A line chart over time or over a number; for `options` see the calls. */
export function line(root, options) {
  const chart = new LineChart(root, options);
  const { key } = chart;
  if (!groups.has(key)) groups.set(key, new Set());
  groups.get(key).add(chart);
  return chart;
}

class LineChart {
  constructor(root, options) {
    this.options = { time: true, height: 220, series: [], ...options };
    this.key = options.sync ?? Symbol("alone");
    this.data = null;
    this.shown = null;
    this.whole = null;
    this.build(root);
    this.offTheme = on("theme", () => this.redraw());
  }

  build(root) {
    const { label, xLabel, yLabel, rightLabel, time, height, series } = this.options;
    const { rows, bands } = plan(series);
    this.rows = rows;
    this.keyRow = h("div", { class: "chart-key" }, series.map((s) => this.keyOf(s)));
    this.at = h("span", { class: "chart-at soft" });
    const tools = [["−", "Zoom out", () => this.zoom(1.6)], ["+", "Zoom in", () => this.zoom(0.625)], ["⤢", "Show all", () => this.reset(true)]]
      .map(([text, words, act]) => h("button", { class: "button quiet icon", type: "button", "aria-label": `${words}: ${label}`, title: words, onclick: act }, text));
    this.plot = h("div", { class: "chart-plot", tabindex: "0", role: "application", "aria-roledescription": "chart", "aria-label": `${label}. Arrow keys move the cursor, plus and minus zoom, Shift with arrows pans, 0 shows all.` });
    this.said = h("div", { class: "unseen", "aria-live": "polite" });
    const values = table(() => this.visible(), this.options);
    this.root = h("div", { class: "chart", role: "group", "aria-label": label },
      h("div", { class: "chart-head" }, this.keyRow, h("div", { class: "chart-tools" }, this.at, tools)),
      this.plot, this.said, values.details);
    root.append(this.root);
    const width = Math.max(200, this.plot.clientWidth || root.clientWidth || 600);
    this.u = new uPlot({
      width, height, ms: 1,
      tzDate: (ms) => uPlot.tzDate(new Date(ms), format.timeZone()),
      legend: { show: false },
      scales: { x: { time }, y: { range: (u, lo, hi) => this.rangeY(lo, hi) }, ...(rightLabel ? { [RIGHT]: { range: (u, lo, hi) => this.rangeY(lo, hi) } } : {}) },
      series: [{}, ...rows.map((r) => r.options)],
      bands,
      axes: [axis(xLabel, { ...(time ? { values: timeLabels } : {}), size: xLabel ? 30 : 34 }), axis(yLabel, { size: 52 }), ...(rightLabel ? [axis(rightLabel, { size: 52, scale: RIGHT, side: 1, grid: { show: false } })] : [])],
      cursor: {
        y: false,
        drag: { x: true, y: false, setScale: false },
        focus: { prox: -1 },
        points: { size: 6 },
        sync: { key: this.key, setSeries: false, filters: { pub: (type) => type === "mousemove" || type === "mouseleave" } },
        bind: {
          mousedown: (u, target, act) => (e) => { if (!e.shiftKey && e.button === 0) act(e); },
          dblclick: () => () => this.reset(true),
        },
      },
      hooks: {
        drawClear: [(u) => drawSpans(u, this.options.spans?.() ?? [])],
        draw: [(u) => drawMarks(u, this.options.marks?.() ?? []), values.fillEmpty],
        setCursor: [(u) => this.tellCursor(u.cursor.idx)],
        setSelect: [(u) => this.selected(u)],
      },
    }, [[], ...rows.map(() => [])], this.plot);
    this.size = new ResizeObserver(([entry]) => {
      const w = Math.floor(entry.contentRect.width);
      if (w > 0 && w !== this.u.width) this.u.setSize({ width: w, height });
    });
    this.size.observe(this.plot);
    this.offGestures = gestures(this);
    this.toPaper = () => this.u.setSize({ width: Math.min(this.u.width, PAPER_WIDTH), height });
    this.toScreen = () => this.u.setSize({ width: this.plot.clientWidth, height });
    addEventListener("beforeprint", this.toPaper);
    addEventListener("afterprint", this.toScreen);
  }

  keyOf(s) {
    const swatch = h("span", { class: `swatch${s.dash ? " dashed" : ""}` });
    swatch.style.setProperty("--ink", `var(${s.ink})`);
    const value = h("output", { class: "chart-value" });
    const node = h("button", { class: "chart-name", type: "button", "aria-pressed": "true", title: "Show or hide", onclick: () => this.toggle(s.key) }, swatch, s.label, value);
    s.node = node;
    s.value = value;
    return node;
  }

  rangeY(lo, hi) {
    if (lo === null || hi === null) return [0, 1];
    const { least } = this.options;
    const room = (hi - lo) * 0.06 || Math.abs(hi) * 0.02 || 0.5;
    return [least === undefined ? lo - room : Math.min(least, lo), hi + room];
  }

  /** New data; keeps the reader's range if asked, else shows everything. */
  setData(data, { keepView = false } = {}) {
    this.data = data;
    const x = data.x ?? [];
    this.whole = x.length ? [x[0], x[x.length - 1]] : null;
    const columns = this.rows.map((r) => data[r.key] ?? x.map(() => null));
    this.u.batch(() => {
      this.u.setData([x, ...columns], false);
      const range = keepView && this.shown ? this.shown : this.whole;
      if (range && range[1] > range[0]) this.u.setScale("x", { min: range[0], max: range[1] });
      else if (range) this.u.setScale("x", { min: range[0] - 1, max: range[1] + 1 });
    });
    for (const s of this.options.series) s.node.hidden = !(data[s.key]?.some((v) => v !== null && v !== undefined));
    this.tellCursor(null);
  }

  /** The displayed range of x. */
  view() {
    const { min, max } = this.u.scales.x;
    return [min, max];
  }

  /** Whether the reader zoomed or panned. */
  get zoomed() {
    return this.shown !== null;
  }

  /** Shows a range of x in this chart and those linked with it. */
  setView(from, to, { byUser = false } = {}) {
    if (!(to > from)) return;
    for (const chart of groups.get(this.key) ?? [this]) {
      chart.shown = [from, to];
      chart.u.setScale("x", { min: from, max: to });
    }
    if (byUser) this.options.onView?.(from, to);
  }

  /** Shows all data. */
  reset(byUser = false) {
    for (const chart of groups.get(this.key) ?? [this]) {
      chart.shown = null;
      if (chart.whole) chart.u.setScale("x", { min: chart.whole[0], max: chart.whole[1] });
    }
    if (byUser) this.options.onReset?.();
  }

  zoom(factor, at = null) {
    const [from, to] = this.view();
    const centre = at ?? (from + to) / 2;
    if (this.whole && (to - from) * factor >= this.whole[1] - this.whole[0]) return this.reset(true);
    this.setView(centre - (centre - from) * factor, centre + (to - centre) * factor, { byUser: true });
    return undefined;
  }

  pan(share) {
    const [from, to] = this.view();
    const by = (to - from) * share;
    this.setView(from + by, to + by, { byUser: true });
  }

  selected(u) {
    if (u.select.width < 4) return;
    const from = u.posToVal(u.select.left, "x");
    const to = u.posToVal(u.select.left + u.select.width, "x");
    u.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
    if (this.options.onSelect) this.options.onSelect(from, to);
    else this.setView(from, to, { byUser: true });
  }

  toggle(key) {
    const first = this.rows.findIndex((r) => r.key === key);
    const show = !this.u.series[first + 1].show;
    this.rows.forEach((r, k) => r.of.key === key && this.u.setSeries(k + 1, { show }));
    this.rows[first].of.node.setAttribute("aria-pressed", String(show));
  }

  xText(x) {
    if (!this.options.time) return `${this.options.xLabel ?? "at"} ${format.number(x)}`;
    const [from, to] = this.view();
    return to - from > DAY_MS / 2 ? format.dateTime(x) : format.time(x);
  }

  /** Values next to the names: at the cursor, else the last ones. */
  tellCursor(idx) {
    const x = this.u.data[0];
    fill(this.at, idx === null || idx === undefined || !x.length ? "" : this.xText(x[idx]));
    for (const s of this.options.series) {
      const { min, max } = this.u.scales[s.right ? RIGHT : "y"] ?? {};
      const k = this.rows.findIndex((r) => r.key === s.key) + 1;
      const column = this.u.data[k] ?? [];
      const at = idx ?? column.findLastIndex((v) => v !== null && v !== undefined);
      const value = column[at];
      const around = s.lo && [this.u.data[k + 2]?.[at], this.u.data[k + 1]?.[at]];
      fill(s.value, s.lo ? format.estimate(value, around, s.unit) : `${format.reading(value, max - min)}${s.unit ? ` ${s.unit}` : ""}`);
    }
  }

  /** Moves the cursor to a sample from the keyboard, and announces its values. */
  cursorTo(idx) {
    const x = this.u.data[0];
    if (!x.length) return;
    const at = Math.max(0, Math.min(x.length - 1, idx));
    this.u.setCursor({ left: this.u.valToPos(x[at], "x"), top: 10 });
    const values = this.options.series.filter((s) => !s.node.hidden).map((s) => `${s.label} ${s.value.textContent}`);
    fill(this.said, `${this.xText(x[at])}: ${values.join(", ")}`);
  }

  /** The displayed data, for the table. */
  visible() {
    const [from, to] = this.view();
    const x = this.u.data[0];
    const rows = [];
    for (let k = 0; k < x.length; k++) if (x[k] >= from && x[k] <= to) rows.push(k);
    return { rows, x, columns: this.u.data.slice(1), plan: this.rows };
  }

  redraw() {
    this.u.redraw(true, true);
  }

  destroy() {
    this.offTheme();
    this.offGestures();
    removeEventListener("beforeprint", this.toPaper);
    removeEventListener("afterprint", this.toScreen);
    this.size.disconnect();
    groups.get(this.key)?.delete(this);
    this.u.destroy();
    this.root.remove();
  }
}
