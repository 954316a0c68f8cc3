// The whole record, and the sections chosen on it: by dragging, by keys at the cursor, by numbers.

const POINTS = 1600;
/** Pause after zooming before finer data are requested, ms. */
const SETTLE_MS = 180;
const SYNC = "wb-trend";
/** How PV and OP share axes: separate charts, one chart with two axes, one chart with one axis. */
const AXES = [["apart", "Two charts"], ["double", "Two axes"], ["single", "One axis"]];

/** The trend of the chosen loop. `on.sections(sections, words)` and `on.axes(axes, words)` are called after every change. */
export class Trend {
  constructor(root, { api, charts, dom, format, announce }, on) {
    Object.assign(this, { root, api, charts, format, announce, on, h: dom.h, fill: dom.fill, problem: dom.problem, skeleton: dom.skeleton });
    this.sections = [];
    this.whole = null;
    this.drags = "select";
    this.axes = "apart";
    this.turn = 0;
    this.mark = null;
  }

  /** Shows a loop of a file, or nothing. */
  async show(file, one, sections) {
    const mine = ++this.turn;
    this.end();
    this.sections = sections;
    Object.assign(this, { file, one, whole: null, mark: null });
    if (!one) {
      this.fill(this.root);
      return;
    }
    this.fill(this.root, this.skeleton(8));
    try {
      const whole = await this.fetch(null, null);
      if (mine !== this.turn) return;
      this.whole = whole;
      this.build();
    } catch (error) {
      if (mine === this.turn) this.fill(this.root, this.problem(error.message, () => this.show(file, one, this.sections)));
    }
  }

  fetch(from, to, points = POINTS) {
    const query = new URLSearchParams({ loop: this.one.name, points });
    if (from !== null) query.set("from_ms", from);
    if (to !== null) query.set("to_ms", to);
    return this.api.get(`/workbench/files/${this.file.id}/record?${query}`);
  }

  build() {
    const { h, fill } = this;
    this.plots = h("div", { class: "wb-plots" });
    this.list = h("div", { class: "wb-sections" });
    fill(this.root,
      h("div", { class: "row" },
        this.segments("What dragging does", [["select", "Drag to select a section"], ["zoom", "Drag to zoom"]], "drags"),
        this.axisButtons = this.segments("Axes of PV and OP", AXES, "axes", (id, words) => this.on.axes(id, `Axes: ${words.toLowerCase()}`)),
        h("span", { class: "soft hint" }, h("kbd", null, "["), " and ", h("kbd", null, "]"), " start and end a section at the cursor; ", h("kbd", null, "Shift"), "-drag moves the view")),
      this.plots, this.list);
    this.plots.addEventListener("keydown", (e) => this.key(e));
    this.draw();
    this.drawList();
  }

  /** Buttons for one of several values, kept in `this[name]`. */
  segments(label, all, name, chosen = () => {}) {
    const { h } = this;
    const buttons = all.map(([id, words]) => h("button", { class: "button", type: "button", "aria-pressed": String(this[name] === id), onclick: (e) => {
      this[name] = id;
      for (const other of e.target.parentNode.children) other.setAttribute("aria-pressed", String(other === e.target));
      chosen(id, words);
    } }, words));
    return h("div", { class: "row segments", role: "group", "aria-label": label }, buttons);
  }

  /** The charts; the shown range stays. */
  draw() {
    const [opUnit, pvUnit] = this.one.units;
    const view = this.drawn?.[0].zoomed ? this.drawn[0].view() : null;
    this.removeCharts();
    const common = { sync: SYNC, time: true, height: 200, spans: () => this.spans(), marks: () => this.marks(), onSelect: (from, to) => this.selected(from, to), onView: () => this.viewed(), onReset: () => this.viewed(true) };
    const right = this.axes === "double";
    const [ofPv, ofOp] = [pvUnit ? `PV, ${pvUnit}` : "PV", opUnit ? `OP, ${opUnit}` : "OP"];
    const pv = [{ key: "sp", label: "SP", ink: "--sp", unit: pvUnit, stepped: true, dash: [5, 4] }, { key: "pv", label: "PV", ink: "--pv", unit: pvUnit }];
    const op = [{ key: "op", label: "OP", ink: "--op", unit: opUnit, stepped: true, right }, { key: "mv", label: "MV", ink: "--mv", unit: opUnit, right }];
    const chart = (options) => this.charts.line(this.plots, { ...common, ...options });
    this.drawn = this.axes === "apart"
      ? [chart({ label: `Process variable of ${this.one.name}`, yLabel: ofPv, series: pv }), chart({ label: `Controller output of ${this.one.name}`, yLabel: ofOp, series: op, height: 170 })]
      : [chart({ label: `Process variable and controller output of ${this.one.name}`, yLabel: right ? ofPv : `${ofPv}; ${ofOp}`, rightLabel: right ? ofOp : null, series: [...pv, ...op], height: 320 })];
    this.setData(this.whole, false);
    if (view) this.drawn[0].setView(...view, { byUser: true });
  }

  setData(record, keepView) {
    const { t_ms: x, op, pv, sp, mv } = record;
    const data = { x, op, pv, ...(sp ? { sp } : {}), ...(mv ? { mv } : {}) };
    for (const chart of this.drawn) chart.setData(data, { keepView });
  }

  /** After zooming: loads the same range with as many points as the screen has. */
  viewed(all = false) {
    clearTimeout(this.settling);
    this.settling = setTimeout(async () => {
      const mine = this.turn;
      if (all) return this.setData(this.whole, false);
      const [from, to] = this.drawn[0].view();
      const room = (to - from) / 2;
      try {
        const finer = await this.fetch(from - room, to + room, POINTS * 2);
        if (mine === this.turn && this.drawn && finer.t_ms.length > 1) this.setData(finer, true);
      } catch {
        // The coarser curve stays.
      }
      return undefined;
    }, SETTLE_MS);
  }

  /** Time of a sample, interpolated between known samples. */
  timeOf(sample) {
    const { index, t_ms } = this.whole;
    let before = 0;
    for (let k = 0; k < index.length; k++) {
      if (index[k] === null) continue;
      if (index[k] >= sample) {
        const wide = index[k] - index[before];
        return wide > 0 ? t_ms[before] + ((t_ms[k] - t_ms[before]) * (sample - index[before])) / wide : t_ms[k];
      }
      before = k;
    }
    return t_ms[t_ms.length - 1];
  }

  spans() {
    return this.sections.map((s) => ({ from: this.timeOf(s.from), to: this.timeOf(s.to), ink: "--fit" }));
  }

  marks() {
    const numbered = this.sections.length > 1 ? this.sections.map((s, k) => ({ x: this.timeOf(s.from), label: String(k + 1), ink: "--fit" })) : [];
    return this.mark === null ? numbered : [...numbered, { x: this.mark, label: "start", ink: "--other" }];
  }

  async selected(from, to) {
    if (this.drags === "zoom") return this.drawn[0].setView(from, to, { byUser: true });
    try {
      const { range } = await this.fetch(from, to, 10);
      if (range) this.add(range[0], range[1]);
    } catch (error) {
      this.announce(error.message);
    }
    return undefined;
  }

  key(e) {
    if (e.key !== "[" && e.key !== "]") return;
    const { u } = this.drawn.find((chart) => chart.plot === e.target) ?? this.drawn[0];
    const at = u.cursor.idx;
    if (at === null || at === undefined) return;
    e.preventDefault();
    const x = u.data[0][at];
    if (e.key === "[") {
      this.mark = x;
      this.announce(`Section starts at ${this.format.time(x)}; press ] to end it`);
    } else if (this.mark !== null && x > this.mark) {
      const from = this.mark;
      this.mark = null;
      const drags = this.drags;
      this.drags = "select";
      this.selected(from, x).then(() => (this.drags = drags));
    }
    this.redraw();
  }

  words(from, to) {
    return `samples ${from} to ${to}`;
  }

  add(from, to) {
    const sections = [...this.sections, { from, to }].sort((a, b) => a.from - b.from);
    this.on.sections(sections, `Section added: ${this.words(from, to)}`);
    this.announce(`Section added: ${this.words(from, to)}`);
  }

  /** Other axes, as a button or undo brings them. */
  setAxes(axes) {
    this.axes = axes;
    if (!this.drawn) return;
    AXES.forEach(([id], k) => this.axisButtons.children[k].setAttribute("aria-pressed", String(id === axes)));
    this.draw();
  }

  /** New sections, as undo brings them. */
  setSections(sections) {
    this.sections = sections;
    if (this.drawn) {
      this.redraw();
      this.drawList();
    }
  }

  redraw() {
    for (const chart of this.drawn) chart.redraw();
  }

  edit(k, end, input) {
    const value = Math.round(Number(input.value));
    const changed = this.sections.map((s, n) => (n === k ? { ...s, [end]: value } : s));
    const one = changed[k];
    const wrong = !Number.isFinite(value) || one.from < 1 || one.to > this.whole.samples || one.to - one.from < 29;
    input.setCustomValidity(wrong ? `From 1 to ${this.whole.samples}, at least 30 samples` : "");
    if (input.reportValidity()) this.on.sections(changed, `Section ${k + 1}: ${this.words(one.from, one.to)}`);
  }

  row(section, k) {
    const { h, format } = this;
    const number = (end, words) => h("input", { class: "wb-number", type: "number", min: "1", max: String(this.whole.samples), value: section[end], "aria-label": `Section ${k + 1}, ${words} sample`, onchange: (e) => this.edit(k, end, e.target) });
    const seconds = (this.timeOf(section.to) - this.timeOf(section.from)) / 1000;
    return h("li", { class: "row" }, h("b", { class: "wb-section-number" }, String(k + 1)),
      h("span", null, "samples ", number("from", "first"), " to ", number("to", "last")),
      h("span", { class: "soft" }, `${format.count(section.to - section.from + 1, "sample")}, ${format.duration(seconds)} from ${format.dateTime(this.timeOf(section.from))}`),
      h("button", { class: "button quiet", type: "button", onclick: () => this.lookAt(section) }, "Show"),
      h("button", { class: "button quiet icon", type: "button", "aria-label": `Remove section ${k + 1}`, title: "Remove", onclick: () => this.on.sections(this.sections.filter((_, n) => n !== k), `Section ${k + 1} removed`) }, "×"));
  }

  lookAt(section) {
    const [from, to] = [this.timeOf(section.from), this.timeOf(section.to)];
    const room = (to - from) * 0.05;
    this.drawn[0].setView(from - room, to + room, { byUser: true });
  }

  drawList() {
    const { h, fill, format } = this;
    const shown = () => {
      const [from, to] = this.drawn[0].view();
      return this.fetch(from, to, 10).then(({ range }) => range && this.add(range[0], range[1]), (error) => this.announce(error.message));
    };
    const byNumbers = () => this.add(1, Math.min(this.whole.samples, Math.max(30, Math.round(this.whole.samples / 2))));
    const buttons = h("div", { class: "row" },
      h("button", { class: "button", type: "button", onclick: shown }, "Add visible range"),
      h("button", { class: "button", type: "button", onclick: byNumbers }, "Add by sample numbers"),
      this.sections.length ? h("button", { class: "button quiet", type: "button", onclick: () => this.on.sections([], "All sections removed") }, "Whole record") : null);
    const none = h("p", null, h("b", null, "The whole record"), ` is analysed: ${format.count(this.whole.samples, "sample")}${this.whole.ts_s ? ` of ${format.number(this.whole.ts_s)} s` : ""}. Drag over the trend to select sections.`);
    fill(this.list, h("div", { class: "row spread" }, h("h3", null, "Sections"), buttons),
      this.sections.length ? h("ol", { class: "wb-section-list" }, this.sections.map((s, k) => this.row(s, k))) : none);
  }

  removeCharts() {
    clearTimeout(this.settling);
    for (const chart of this.drawn ?? []) chart.destroy();
    this.drawn = null;
  }

  end() {
    this.removeCharts();
  }
}
