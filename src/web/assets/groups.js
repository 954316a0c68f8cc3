// Plant view: groups of loops that share one oscillation, its cause, the followers, and the members over time.

import * as api from "./api.js";
import { fill, h, loading } from "./dom.js";
import * as format from "./format.js";
import { on } from "./store.js";

const link = (name) => h("a", { href: `#/loop/${encodeURIComponent(name)}` }, name);
const repaired = (source) => (source.kind === "loop" ? `${source.loop} is repaired` : "the source is repaired");

/** The cause of the oscillation, in a sentence. */
function headline(group) {
  const { source, same_record: twins } = group;
  if (twins?.length) return [twins.flatMap((name, k) => [k ? (k === twins.length - 1 ? " and " : ", ") : null, link(name)]), " have the same record, so no source is named: check their keys"];
  const p = format.probability(source.probability);
  if (source.kind === "loop") return [link(source.loop), ` causes the oscillation, p ${p}`];
  if (source.kind === "outside") return `None of these loops causes the oscillation, p ${p}: look upstream for a common load or a loop that is not recorded`;
  const likeliest = source.loop ? [": ", link(source.loop), " is the likeliest"] : null;
  if (source.kind === "several") return ["More than one of these loops may cause the oscillation", likeliest];
  return ["The windows do not show which loop causes the oscillation", likeliest];
}

function member(judged, group) {
  const follower = group.followers.find((f) => f.loop === judged.loop);
  const p = (value) => (value === null ? "not judged" : `p ${format.probability(value)}`);
  return h("tr", null, h("th", { scope: "row" }, link(judged.loop)),
    h("td", null, judged.cause ?? `${group.source.kind === "loop" && judged.loop === group.source.loop ? "causes the oscillation" : "may make it"}, p ${format.probability(judged.p_source)}`, judged.masked ? h("b", { class: "under-words" }, `not cleared: judge again once ${repaired(group.source)}`) : null),
    h("td", { class: "number" }, follower ? format.duration(follower.lag_s) : "–"),
    h("td", { class: "number" }, follower ? format.percent(follower.share) : "–"),
    h("td", { class: "number" }, p(judged.p_stiction)), h("td", { class: "number" }, p(judged.p_alone)));
}

function members(group) {
  const column = (words) => h("th", { scope: "col", class: "number" }, words);
  return h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": `Loops of the group of ${group.members[0]}` }, h("table", { class: "table" },
    h("thead", null, h("tr", null, h("th", { scope: "col" }, "loop"), h("th", { scope: "col" }, "part in the group"), column("lag"), column("share of its power"), column("stiction, with its group"), column("alone"))),
    h("tbody", null, group.judgements.map((judged) => member(judged, group)))));
}

/** Runs of comparisons with the same members and source. */
export function stretches(history) {
  const list = [];
  for (const { t_ms, members, source } of history) {
    const names = [...members].sort();
    const key = JSON.stringify([names, source]);
    const last = list.at(-1);
    if (last?.key === key) Object.assign(last, { to_ms: t_ms, count: last.count + 1 });
    else list.push({ key, names, source, from_ms: t_ms, to_ms: t_ms, count: 1 });
  }
  return list;
}

function change(stretch, before) {
  if (!before) return `first seen: ${stretch.names.join(", ")}`;
  const joined = stretch.names.filter((n) => !before.names.includes(n));
  const left = before.names.filter((n) => !stretch.names.includes(n));
  const source = stretch.source === before.source ? null : stretch.source ? `source: ${stretch.source}` : "no source is named any more";
  return [joined.length ? `${joined.join(", ")} joined` : null, left.length ? `${left.join(", ")} left` : null, source].filter(Boolean).join("; ");
}

function timeLine(history) {
  const list = stretches(history);
  return h("details", { class: "membership" }, h("summary", null, `Members over time: ${format.count(history.length, "comparison")}`),
    h("ol", null, list.map((s, k) => h("li", null, h("time", { datetime: new Date(s.from_ms).toISOString() }, format.recent(s.from_ms)), " ", change(s, list[k - 1])))));
}

function card({ id, document: group, history }) {
  const { source } = group;
  return h("article", { class: "card group", "data-group": String(id), "data-key": JSON.stringify(group.members), tabindex: "-1", "aria-labelledby": `group-${id}` },
    h("h2", { id: `group-${id}` }, headline(group)),
    h("p", { class: "soft" }, `${group.members.length} loops oscillate together, period ${format.duration(group.period_s)}; probability that chance links them ${format.probability(group.p_value)}. Window ${format.recent(format.millis(group.window.start))} to ${format.recent(format.millis(group.window.end))}.`),
    source.reasons.length ? h("ul", { class: "reasons" }, source.reasons.map((reason) => h("li", null, format.sentence(reason)))) : null,
    source.next_test ? h("p", { class: "todo" }, h("b", null, "Next test: "), source.next_test) : null,
    members(group), timeLine(history));
}

function none(compared_age_s) {
  const words = compared_age_s === null ? "The loops have not been compared yet." : "No loops share an oscillation. Each loop is judged on its own.";
  return h("p", { class: "note" }, words);
}

/** Shows the groups; `?loop=NAME` in the address scrolls to the group of that loop. */
export function show(root, { announce }) {
  const list = h("div", { class: "groups" });
  fill(root, h("h1", null, "Plant"), h("p", { class: "soft" }, "Loops that share an oscillation, and the loop that makes it. Repair the source first."), list);
  let wanted = new URLSearchParams(location.hash.split("?")[1]).get("loop");
  let before = null;
  const draw = ({ groups, compared_age_s }) => {
    // Announce only real changes: each comparison brings new figures for the same groups.
    const now = JSON.stringify(groups.map(({ id, document: { members, source } }) => [id, [...members].sort(), source.kind, source.loop]));
    const told = before !== null && now !== before;
    before = now;
    // Keep the focus and the open parts of cards.
    const open = new Set([...list.querySelectorAll("details[open]")].map((d) => d.closest("article").dataset.group));
    const active = list.contains(document.activeElement) ? document.activeElement : null;
    const at = active?.closest("article")?.dataset.group;
    const order = active && at !== undefined ? [...active.closest("article").querySelectorAll("a, summary, [tabindex]")].indexOf(active) : -1;
    fill(list, groups.length ? groups.map(card) : none(compared_age_s));
    for (const id of open) list.querySelector(`[data-group="${id}"] details`)?.setAttribute("open", "");
    const again = at === undefined ? null : list.querySelector(`[data-group="${at}"]`);
    if (again) (again.querySelectorAll("a, summary, [tabindex]")[order] ?? again).focus({ preventScroll: true });
    if (told) announce(groups.length ? `Groups changed: ${groups.length}` : "No loops share an oscillation any more");
    if (wanted === null) return;
    const mine = groups.find(({ document: group }) => group.members.includes(wanted));
    wanted = null;
    // After the view has taken the focus.
    if (mine) setTimeout(() => list.querySelector(`[data-group="${mine.id}"]`)?.focus());
  };
  const part = loading(list, () => api.get("/groups"), draw);
  part.run();
  const ends = [on("groups", () => part.run()), on("back", () => part.run(true))];
  return () => [part.end, ...ends].forEach((end) => end());
}
