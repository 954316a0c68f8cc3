// Benefit of a repair: the closed loop simulated as it is, with a free valve, and with half the gain.

import * as api from "./api.js";
import { figureCell, fill, h, loading } from "./dom.js";
import * as format from "./format.js";
import { store } from "./store.js";
import { opUnit } from "./words.js";

/** Pause between two automatic simulations, ms. */
const CALM_MS = 30_000;

const CASES = [["now", "now"], ["repaired", "valve repaired"], ["half_gain", "half the gain instead"]];

const oscillates = (value) => (value === null || value === undefined ? "–" : value ? "yes" : "no");

/** Fills the section; returns a cleanup function. */
export function repair(root, loop) {
  const rows = () => {
    const row = store.rows.get(loop.name) ?? loop.document?.row;
    const pv = row?.pv_unit ?? "PV units";
    const op = opUnit(row);
    return [
      ["Standard deviation of PV", "pv_sd", pv],
      ["Mean distance from SP", "pv_mean_abs_error", pv],
      ["Valve travel a day", "travel_per_day", op],
      ["Reversals a day", "reversals_per_day", ""],
    ];
  };
  // A range far beyond the loop's present behaviour is meaningless.
  const vague = (item, now) => now && item.interval[1] > 3 * Math.max(now.value, item.value);
  // The same digits as in the sentences above the table.
  const told = ({ value, interval: [low, high] }) => {
    const range = `${format.rough(low)} to ${format.rough(high)}`;
    return high > 3 * low ? [range, ""] : [format.rough(value), range];
  };
  const cell = (item, now) => figureCell(!item ? ["–", ""] : vague(item, now) ? ["not known", ""] : told(item));
  const show = (answer) => fill(root,
    answer.sentences.map((t) => h("p", { class: "lead" }, t)),
    h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Benefit of a repair, table" }, h("table", { class: "table" },
      h("caption", { class: "soft" }, "The closed loop, simulated; 90 % intervals in brackets."),
      h("thead", null, h("tr", null, h("td", null), CASES.map(([, words]) => h("th", { scope: "col", class: "number" }, words)))),
      h("tbody", null, rows().map(([words, key, unit]) => h("tr", null, h("th", { scope: "row" }, words, unit ? h("span", { class: "soft" }, `, ${unit}`) : null), CASES.map(([id]) => cell(answer[id]?.[key], id === "now" ? null : answer.now[key])))),
        h("tr", null, h("th", { scope: "row" }, "Oscillates"), CASES.map(([id]) => h("td", { class: "number" }, oscillates(answer[id]?.oscillates))))))),
    answer.assumptions?.length ? h("details", null, h("summary", null, "Assumptions"), h("ul", null, answer.assumptions.map((t) => h("li", null, t)))) : null);
  const part = loading(root, () => api.get(loop.path("/repair")), show, { lines: 5, calm_ms: CALM_MS });
  let window = null;
  // Each window has a separate answer; one without a fit has none and is not requested.
  loop.onDocument(({ estimate }) => {
    const name = estimate?.window?.end_ns ?? 0;
    if (name === window) return;
    window = name;
    if (estimate?.s === null || !estimate) {
      fill(root, h("p", { class: "note" }, "The last window has no fit, so there is no closed loop to simulate."));
      root.removeAttribute("aria-busy");
    } else part.run();
  });
  return part.end;
}
