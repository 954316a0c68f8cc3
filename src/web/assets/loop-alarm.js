// Every change of a loop's alarm, newest first.

import * as api from "./api.js";
import { fill, h, loading } from "./dom.js";
import * as format from "./format.js";
import { on } from "./store.js";
import { EVENTS, STATES } from "./words.js";

/** Fills the section; returns what cleans up. */
export function alarms(root, loop) {
  const row = (a) => h("tr", null,
    h("th", { scope: "row", class: "nowrap" }, format.dateTime(format.millis(a.changed))),
    h("td", null, EVENTS[a.event] ?? a.event), h("td", null, STATES[a.state] ?? a.state),
    h("td", { class: "number" }, a.s === null || a.s === undefined ? "–" : format.estimate(a.s, a.s_interval, a.unit)),
    h("td", { class: "number" }, format.probability(a.p)),
    h("td", null, a.by ?? "the program"), h("td", null, a.detail ?? (a.event === "raised" ? a.why : "") ?? ""));
  const show = ({ changes, complete }) => {
    if (!changes.length) return void fill(root, h("p", { class: "note" }, "This loop never had an alarm."));
    return void fill(root, h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Changes of the alarm" }, h("table", { class: "table" },
      h("thead", null, h("tr", null, ["when", "what", "state"].map((t) => h("th", { scope: "col" }, t)), h("th", { scope: "col", class: "number" }, "s"), h("th", { scope: "col", class: "number" }, "p"), ["who", "words"].map((t) => h("th", { scope: "col" }, t)))),
      h("tbody", null, changes.map(row)))),
      complete ? null : h("p", { class: "soft small" }, "Older changes are not in the recordings."));
  };
  const part = loading(root, () => api.get(loop.path("/alarms")), show, 4);
  part.run();
  const off = on("alarm", (a) => a.loop === loop.name && part.run());
  return () => {
    off();
    part.end();
  };
}
