// The data that a run would analyse, shown beforehand: the sections as recorded, and after downsampling and detrending.

/** Options that change the analysed data. */
const DATA = ["kind", "file", "loop", "sections", "downsample", "like_toolbox", "detrend"];
/** Pause after a change before the preview is requested, ms. */
const SETTLE_MS = 200;

/** The preview below the trend. */
export class Preview {
  constructor(root, { api, charts, dom, format }) {
    Object.assign(this, { root, api, charts, format, h: dom.h, fill: dom.fill });
    this.turn = 0;
    this.at = 0;
    this.drawn = [];
  }

  /** Follows the options. `one` is the loop, or null; `order` the request of a run. */
  show(one, now, order) {
    const key = JSON.stringify(DATA.map((name) => now[name]));
    if (key === this.key) return;
    Object.assign(this, { key, one });
    clearTimeout(this.settling);
    const mine = ++this.turn;
    if (!one) return void this.clear();
    this.settling = setTimeout(async () => {
      const { kind, file, loop, samples, downsample, like_toolbox, detrend } = order;
      try {
        const { sections } = await this.api.post("/workbench/preview", { kind, file, loop, samples, downsample, like_toolbox, detrend });
        if (mine === this.turn) this.take(sections);
      } catch (error) {
        if (mine === this.turn) this.clear(this.h("p", { class: "problem" }, error.message));
      }
    }, SETTLE_MS);
    return undefined;
  }

  clear(...children) {
    for (const chart of this.drawn) chart.destroy();
    this.drawn = [];
    this.fill(this.root, ...children);
  }

  take(sections) {
    this.sections = sections;
    this.at = Math.min(this.at, sections.length - 1);
    this.draw();
  }

  draw() {
    const { h, format, sections } = this;
    const found = sections[this.at];
    const buttons = sections.map((_, k) => h("button", { class: "button", type: "button", "aria-pressed": String(k === this.at), onclick: () => {
      this.at = k;
      this.draw();
    } }, `Section ${k + 1}`));
    this.clear(h("div", { class: "row spread" }, h("h3", null, "Preview: what a run analyses"),
      sections.length > 1 ? h("div", { class: "row segments", role: "group", "aria-label": "Section of the preview" }, buttons) : null));
    if (found.error) return void this.root.append(h("p", { class: "problem" }, found.error));
    const { before, after } = found;
    const changed = before.count !== after.count || differ(before, after);
    const size = ({ count, point_s }) => `${format.count(count, "point")}, one every ${format.number(point_s)} s`;
    if (changed) this.panel("As recorded", size(before), before);
    this.panel(changed ? "As analysed" : "As recorded and as analysed", size(after), after);
    const unit = this.one.units[0] ?? "OP units";
    const s0 = found.s0 === null ? "OP does not move here, so nothing can be estimated." : [h("b", null, `S0 = ${format.number(found.s0)} ${unit}`), ": OP's span here. The estimate searches fs + fd up to S0."];
    this.root.append(h("p", { class: "wb-s0" }, s0), ...found.notes.map((note) => h("p", { class: "note" }, note)));
    return undefined;
  }

  /** Trend and phase plot of one version of the data. */
  panel(title, size, { t_ms, op, pv }) {
    const { h, one } = this;
    const [opUnit, pvUnit] = one.units;
    const [ofOp, ofPv] = [opUnit ? `OP, ${opUnit}` : "OP", pvUnit ? `PV, ${pvUnit}` : "PV"];
    const trend = h("div");
    const orbit = h("div", { class: "wb-orbit" });
    this.root.append(h("div", { class: "wb-panel" }, h("p", { class: "wb-panel-title" }, h("b", null, title), ": ", size, "."), h("div", { class: "wb-panel-plots" }, trend, orbit)));
    const chart = this.charts.line(trend, { label: `${title}: trend`, time: true, height: 220, yLabel: ofPv, rightLabel: ofOp, series: [
      { key: "pv", label: "PV", ink: "--pv", unit: pvUnit },
      { key: "op", label: "OP", ink: "--op", unit: opUnit, stepped: true, right: true },
    ] });
    chart.setData({ x: t_ms, pv, op });
    const phase = this.charts.phase(orbit, { label: `${title}: phase plot`, xLabel: ofOp, yLabel: ofPv });
    phase.set({ x: op, y: pv });
    this.drawn.push(chart, phase);
  }

  end() {
    clearTimeout(this.settling);
    this.turn++;
    this.clear();
  }
}

const differ = (before, after) => before.pv.some((v, k) => v !== after.pv[k]);
