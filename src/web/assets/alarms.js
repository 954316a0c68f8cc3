// Alarm list: ISA-18.2 states, who did what and until when, acknowledge, shelve, confirm, mark as false.

import * as api from "./api.js";
import { buttons, said } from "./actions.js";
import { fill, h, loading, prose } from "./dom.js";
import * as format from "./format.js";
import { on } from "./store.js";
import { EVENTS, METHODS, PRIORITIES, STATES, VERDICTS, symbol } from "./words.js";

const ORDER = ["unack", "rtn_unack", "acked", "shelved", "suppressed", "out_of_service", "normal"];

/** The filters, each with the alarms that it shows. */
const VIEWS = {
  open: { label: "open", has: (a) => ["unack", "rtn_unack", "acked"].includes(a.state) },
  unack: { label: "unacknowledged", has: (a) => a.state === "unack" || a.state === "rtn_unack" },
  acked: { label: "acknowledged", has: (a) => a.state === "acked" },
  shelved: { label: "shelved", has: (a) => a.state === "shelved" },
  away: { label: "suppressed or out of service", has: (a) => a.state === "suppressed" || a.state === "out_of_service" },
  normal: { label: "back to normal", has: (a) => a.state === "normal" },
  all: { label: "all", has: () => true },
};

const rank = (a) => ORDER.indexOf(a.state) * 100 + (PRIORITIES.indexOf(a.priority) + 1 || 9) * 10;

function held(alarm) {
  const acts = [["acknowledged", alarm.acknowledged], ["shelved", alarm.shelved], ["suppressed", alarm.suppressed], ["out of service", alarm.out_of_service]];
  return acts.filter(([, act]) => act).map(([word, act]) => {
    const until = act.until ? `, until ${format.recent(format.millis(act.until))}` : "";
    return h("li", null, `${word} by ${act.by}, ${format.recent(format.millis(act.at))}${until}`, act.why ? h("q", null, act.why) : null);
  });
}

function reviewed(review) {
  if (!review) return null;
  return h("li", null, `${said(review).replace(/^./, (c) => c.toLowerCase())} ${review.by}, ${METHODS[review.method] ?? review.method}, ${format.recent(review.at_ms)}`, review.why ? h("q", null, review.why) : null);
}

/** The figures of the newest window with an answer. */
function figures(alarm) {
  const limit = alarm.limit ? `counts from ${alarm.limit}` : null;
  const parts = [VERDICTS[alarm.verdict]?.short ?? alarm.verdict, alarm.class, alarm.size ? `s ${alarm.size}` : null, limit, alarm.probability];
  return `Newest answer: ${parts.filter(Boolean).join(", ")}`;
}

function entry(alarm, done) {
  const since = format.millis(alarm.since);
  const changed = `${EVENTS[alarm.event] ?? alarm.event}${alarm.by ? ` by ${alarm.by}` : ""}, ${format.recent(format.millis(alarm.changed))}`;
  const ne = alarm.ne107;
  return h("li", { class: `alarm ${alarm.state}${alarm.active ? " active" : ""}`, "data-loop": alarm.loop },
    h("div", { class: "alarm-main" },
      h("h2", null, symbol(ne, 20), h("a", { href: `#/loop/${encodeURIComponent(alarm.loop)}` }, alarm.loop),
        alarm.priority ? h("span", { class: `priority ${alarm.priority}` }, `maintenance priority ${alarm.priority}`) : null,
        h("span", { class: "state" }, STATES[alarm.state] ?? alarm.state)),
      h("p", { class: "alarm-figures" }, figures(alarm)),
      alarm.why ? h("p", { class: "soft" }, `When raised: ${alarm.why}`) : null,
      alarm.what_to_do ? h("p", null, h("b", null, "To do: "), prose(alarm.what_to_do)) : null),
    h("div", { class: "alarm-side" },
      h("ul", { class: "acts" },
        since ? h("li", null, `since ${format.recent(since)}${since < Date.now() ? ` (${format.duration(Math.round((Date.now() - since) / 1000))})` : ""}`) : null,
        h("li", null, `last change: ${changed}`), held(alarm), reviewed(alarm.review)),
      h("p", { class: "soft" }, [alarm.area, alarm.equipment, alarm.criticality ? `criticality ${alarm.criticality}` : null].filter(Boolean).join(" · "))),
    buttons(alarm, { done }));
}

/** Shows the alarm list; returns a cleanup function. */
export function show(root, { announce }) {
  const state = { view: "open", text: "" };
  const alarms = new Map();
  const chips = h("div", { class: "chips", role: "group", "aria-label": "Filter by state" });
  const list = h("div");
  const search = h("input", { id: "find", type: "search", placeholder: "loop, area, name", oninput: (e) => { state.text = e.target.value.trim().toLowerCase(); draw(); } });
  const exported = h("a", { class: "button", href: api.url("/reviews.csv"), download: "reviews.csv" }, "Save reviews (CSV)");
  fill(root, h("h1", null, "Alarms"),
    h("p", { class: "soft" }, "Maintenance alerts (ISA-18.2), not process alarms. Priority ranks valves for planning; no alert needs action within minutes."),
    h("section", { class: "filters", "aria-label": "Filter" }, chips, h("div", { class: "row" }, h("label", { class: "inline", for: "find" }, "Find ", search, h("kbd", null, "/")), exported)),
    list);

  const text = (a) => [a.loop, a.area, a.equipment, a.verdict, a.acknowledged?.by, a.shelved?.by].join(" ").toLowerCase();
  const done = (document, review) => {
    const loop = document?.loop ?? review.loop;
    const old = alarms.get(loop) ?? {};
    alarms.set(loop, document ? { ...document, review: old.review ?? null } : { ...old, review });
    announce(document ? `${loop}: ${STATES[document.state]}` : `${loop}: kept`);
    draw();
    list.querySelector(`[data-loop="${CSS.escape(loop)}"] a`)?.focus();
  };

  function drawChips() {
    fill(chips, Object.entries(VIEWS).map(([key, { label, has }]) => {
      const n = [...alarms.values()].filter(has).length;
      return h("button", { class: "chip", type: "button", "aria-pressed": String(state.view === key), onclick: () => { state.view = key; draw(); chips.querySelector("[aria-pressed=true]")?.focus(); } }, label, h("b", null, String(n)));
    }));
  }

  function draw() {
    drawChips();
    const shown = [...alarms.values()].filter((a) => VIEWS[state.view].has(a) && text(a).includes(state.text));
    shown.sort((a, b) => rank(a) - rank(b) || format.millis(b.changed) - format.millis(a.changed));
    const none = alarms.size ? "No alarm in this state." : "No alarms, and no changes in the last day.";
    const focus = document.activeElement?.closest?.(".alarm") && [document.activeElement.closest(".alarm").dataset.loop, document.activeElement.getAttribute("aria-label")];
    fill(list, shown.length ? h("ul", { class: "alarms" }, shown.map((a) => entry(a, done))) : h("p", { class: "note" }, none));
    const again = focus && list.querySelector(`[data-loop="${CSS.escape(focus[0])}"]`);
    if (again) (focus[1] && again.querySelector(`[aria-label="${CSS.escape(focus[1])}"]`) || again.querySelector("a")).focus({ preventScroll: true });
  }

  const part = loading(list, () => api.get("/alarms"), (answer) => {
    alarms.clear();
    for (const alarm of answer.alarms) alarms.set(alarm.loop, alarm);
    draw();
  }, { lines: 8 });
  part.run();
  const busy = () => document.querySelector("dialog[open]");
  const off = [
    on("alarm", (alarm) => {
      alarms.set(alarm.loop, { ...alarm, review: alarms.get(alarm.loop)?.review ?? null });
      if (!busy()) draw();
    }),
    on("back", () => part.run(true)),
    on("gone", () => part.run(true)),
  ];
  return () => {
    part.end();
    off.forEach((f) => f());
  };
}
