// Every change of a loop's alarm, newest first.

import { said } from "./actions.js";
import * as api from "./api.js";
import { fill, h, loading } from "./dom.js";
import * as format from "./format.js";
import { on } from "./store.js";
import { EVENTS, METHODS, STATES } from "./words.js";

/** Fills the section; returns a cleanup function. */
export function alarms(root, loop) {
  const row = (a) => h("tr", null,
    h("th", { scope: "row", class: "nowrap" }, format.dateTime(format.millis(a.changed))),
    h("td", null, EVENTS[a.event] ?? a.event), h("td", null, STATES[a.state] ?? a.state),
    h("td", { class: "number" }, a.size ?? "–"),
    h("td", { class: "number" }, a.probability ?? "–"),
    h("td", null, a.by ?? "the program"), h("td", null, a.detail ?? (a.event === "raised" ? a.why : "") ?? ""));
  const reviewed = (r) => h("li", null, h("b", null, said(r)), ` ${r.by} on ${format.dateTime(r.at_ms)} (${METHODS[r.method] ?? r.method}), window to ${format.dateTime(r.window_end_ms)}`, r.why ? [": ", h("q", null, r.why)] : null);
  const load = async () => {
    const [answer, kept] = await Promise.all([api.get(loop.path("/alarms")), api.get("/reviews").catch(() => ({ reviews: [] }))]);
    return { ...answer, reviews: kept.reviews.filter((r) => r.loop === loop.name) };
  };
  const show = ({ changes, complete, reviews }) => {
    const judged = reviews.length ? h("ul", null, reviews.map(reviewed)) : null;
    if (!changes.length) return void fill(root, judged, h("p", { class: "note" }, complete === false ? "The available recordings contain no change of this alarm." : "This loop has had no alarm."));
    return void fill(root, judged, h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Changes of the alarm" }, h("table", { class: "table" },
      h("thead", null, h("tr", null, ["when", "what", "state"].map((t) => h("th", { scope: "col" }, t)), h("th", { scope: "col", class: "number" }, "s"), h("th", { scope: "col", class: "number" }, "p"), ["who", "words"].map((t) => h("th", { scope: "col" }, t)))),
      h("tbody", null, changes.map(row)))),
      complete ? null : h("p", { class: "soft small" }, "Older changes are not in the available recordings."));
  };
  const part = loading(root, load, show);
  part.run();
  const off = on("alarm", (a) => a.loop === loop.name && part.run());
  return () => {
    off();
    part.end();
  };
}
