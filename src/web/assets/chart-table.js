// The chart's numbers as a table, created when it is opened: for screen readers, for copying, and where a picture does not help.

import { fill, h } from "./dom.js";
import * as format from "./format.js";

const MOST_ROWS = 60;

function summary(plan, columns, rows) {
  const cells = plan.flatMap((r, k) => {
    if (r.key !== r.of.key) return [];
    const values = rows.map((i) => columns[k][i]).filter((v) => v !== null && v !== undefined);
    if (!values.length) return [];
    const mean = values.reduce((a, b) => a + b, 0) / values.length;
    const [lo, hi] = values.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
    return [h("li", null, `${r.of.label}: ${format.reading(lo, hi - lo)} to ${format.reading(hi, hi - lo)}, mean ${format.reading(mean, hi - lo)}${r.of.unit ? ` ${r.of.unit}` : ""}`)];
  });
  return h("ul", null, cells);
}

function body({ rows, x, columns, plan }, options) {
  const every = Math.max(1, Math.ceil(rows.length / MOST_ROWS));
  const kept = rows.filter((_, k) => k % every === 0);
  const heads = plan.map((r, k) => ({ r, k })).filter(({ r, k }) => r.key === r.of.key && columns[k].some((v) => v !== null && v !== undefined));
  const cell = ({ r, k }, i) => {
    const value = columns[k][i];
    return r.of.lo ? format.estimate(value, [columns[k + 2][i], columns[k + 1][i]], "") : format.reading(value, Math.abs(value) || 1);
  };
  const xCell = (v) => (options.time ? `${format.day(v)}, ${format.time(v)}` : format.number(v));
  return [
    summary(plan, columns, rows),
    every > 1 ? h("p", { class: "soft" }, `Every ${every}th of ${format.count(rows.length, "point")} shown; zoom in for more.`) : null,
    h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": `Values: ${options.label}` }, h("table", { class: "table" },
      h("thead", null, h("tr", null, h("th", { scope: "col" }, options.time ? "time" : options.xLabel ?? "x"), heads.map(({ r }) => h("th", { scope: "col", class: "number" }, r.of.unit ? `${r.of.label}, ${r.of.unit}` : r.of.label)))),
      h("tbody", null, kept.map((i) => h("tr", null, h("th", { scope: "row" }, xCell(x[i])), heads.map((head) => h("td", { class: "number" }, cell(head, i)))))))),
  ];
}

/** A fold with the chart's data as a table; `fillEmpty` fills one that was opened before its data came. */
export function table(visible, options) {
  const inside = h("div", null);
  const details = h("details", { class: "as-table" }, h("summary", null, "Values as a table"), inside);
  const show = () => fill(inside, details.open ? body(visible(), options) : null);
  details.addEventListener("toggle", show);
  return { details, fillEmpty: () => details.open && !inside.querySelector("tbody tr") && show() };
}
