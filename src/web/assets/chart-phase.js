// Phase plot: PV over OP, as SVG, so that it takes the page's colours.

import { fill, h, svg } from "./dom.js";
import * as format from "./format.js";

const WIDTH = 420;
const HEIGHT = 320;
const EDGE = { left: 52, right: 10, top: 10, bottom: 38 };

/** Four to seven round numbers between two values. */
export function ticks(lo, hi) {
  const raw = (hi - lo) / 5 || 1;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw);
  const all = [];
  for (let v = Math.ceil(lo / step) * step; v <= hi + step * 1e-9; v += step) all.push(Math.abs(v) < step * 1e-9 ? 0 : v);
  return { all, digits: Math.max(0, -Math.floor(Math.log10(step) + 1e-9)) };
}

function range(lists) {
  let [lo, hi] = [Infinity, -Infinity];
  for (const v of lists.flat()) {
    if (v === null || v === undefined) continue;
    if (v < lo) lo = v;
    if (v > hi) hi = v;
  }
  if (!(hi >= lo)) return [0, 1];
  const room = (hi - lo) * 0.05 || 0.5;
  return [lo - room, hi + room];
}

function path(x, y, toX, toY) {
  const parts = [];
  let pen = "M";
  for (let k = 0; k < x.length; k++) {
    if (x[k] === null || y[k] === null || x[k] === undefined || y[k] === undefined) {
      pen = "M";
      continue;
    }
    parts.push(`${pen}${toX(x[k]).toFixed(1)} ${toY(y[k]).toFixed(1)}`);
    pen = "L";
  }
  return parts.join("");
}

/** A phase plot; `set({ x, y, other: { x, y } or null })` draws. */
export function phase(root, { label, xLabel, yLabel }) {
  const picture = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "phase", role: "img", "aria-label": label });
  const holder = h("div", { class: "phase-holder" }, picture);
  root.append(holder);

  const set = ({ x, y, other = null }) => {
    const [x0, x1] = range(other ? [x, other.x] : [x]);
    const [y0, y1] = range(other ? [y, other.y] : [y]);
    const toX = (v) => EDGE.left + ((v - x0) / (x1 - x0)) * (WIDTH - EDGE.left - EDGE.right);
    const toY = (v) => HEIGHT - EDGE.bottom - ((v - y0) / (y1 - y0)) * (HEIGHT - EDGE.top - EDGE.bottom);
    const across = ticks(x0, x1);
    const up = ticks(y0, y1);
    fill(picture,
      across.all.map((v) => svg("path", { class: "grid", d: `M${toX(v)} ${EDGE.top}V${HEIGHT - EDGE.bottom}` })),
      up.all.map((v) => svg("path", { class: "grid", d: `M${EDGE.left} ${toY(v)}H${WIDTH - EDGE.right}` })),
      across.all.map((v) => svg("text", { x: toX(v), y: HEIGHT - EDGE.bottom + 14, "text-anchor": "middle" }, v.toFixed(across.digits))),
      up.all.map((v) => svg("text", { x: EDGE.left - 6, y: toY(v) + 4, "text-anchor": "end" }, v.toFixed(up.digits))),
      svg("text", { x: (EDGE.left + WIDTH - EDGE.right) / 2, y: HEIGHT - 6, "text-anchor": "middle" }, xLabel),
      svg("text", { x: 12, y: (EDGE.top + HEIGHT - EDGE.bottom) / 2, "text-anchor": "middle", transform: `rotate(-90 12 ${(EDGE.top + HEIGHT - EDGE.bottom) / 2})` }, yLabel),
      svg("path", { class: "orbit", d: path(x, y, toX, toY) }),
      other && svg("path", { class: "orbit other", d: path(other.x, other.y, toX, toY) }));
    picture.setAttribute("aria-label", `${label}: OP from ${format.number(x0)} to ${format.number(x1)}, PV from ${format.number(y0)} to ${format.number(y1)}.`);
  };
  return { set, destroy: () => holder.remove() };
}
