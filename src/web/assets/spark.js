// A small chart of the recent windows' probability.

import { svg } from "./dom.js";

const WIDTH = 92;
const HEIGHT = 26;

/** p of the recent windows, from 0 to 1, with a line at one half; a dot marks the last one. */
export function spark(recent) {
  const picture = svg("svg", { class: "spark", viewBox: `0 0 ${WIDTH} ${HEIGHT}`, width: WIDTH, height: HEIGHT, "aria-hidden": "true" });
  const values = recent.map((w) => w.p);
  if (values.length < 2) return picture;
  const x = (k) => 3 + (k / (values.length - 1)) * (WIDTH - 7);
  const y = (v) => HEIGHT - 3 - v * (HEIGHT - 6);
  let d = "";
  let pen = "M";
  values.forEach((v, k) => {
    if (v === null) return void (pen = "M");
    d += `${pen}${x(k).toFixed(1)} ${y(v).toFixed(1)}`;
    pen = "L";
    return undefined;
  });
  picture.append(svg("path", { class: "ground", d: `M2 ${HEIGHT - 2.5}H${WIDTH - 2}M2 ${HEIGHT / 2}H${WIDTH - 2}` }), svg("path", { class: "line", d }));
  const last = values.findLastIndex((v) => v !== null);
  if (last >= 0) picture.append(svg("circle", { cx: x(last), cy: y(values[last]), r: 2.2 }));
  return picture;
}
