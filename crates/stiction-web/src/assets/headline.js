// The overview's answer in a sentence: is anything wrong, where to begin, how sure, what to do.

import * as format from "./format.js";
import { neOf, opUnit, seen, severity, sizeOf } from "./words.js";

/** `{ state, words, first: row or null, more: [sentences] }` for these rows. */
export function headline(rows, site) {
  if (!rows.length) {
    const prefix = site?.prefix ? ` under ${site.prefix}` : "";
    return { state: "wait", words: `No loop yet: waiting for data${prefix}.`, first: null, more: [] };
  }
  const of = (key) => rows.filter((r) => neOf(r) === key);
  const need = of("M").sort((a, b) => severity(b) - severity(a));
  const soon = rows.filter((r) => neOf(r) === "S" && r.stiction).sort((a, b) => severity(b) - severity(a));
  const all = format.count(rows.length, "valve");
  const more = [];
  let words = `No stiction alarm in ${all}.`;
  if (need.length === 1) words = `1 of ${all} needs maintenance: ${need[0].name}.`;
  if (need.length > 1) words = `${need.length} of ${all} need maintenance; ${need[0].name} first.`;
  if (rows.length === 1 && !need.length) words = `No stiction alarm for ${rows[0].name}.`;
  const first = need[0] ?? null;
  if (first) more.push(`${first.name}: ${evidence(first)}`);
  const waiting = need.filter((r) => r.unacknowledged).length;
  if (waiting) more.push(`${format.count(waiting, "alarm waits", "alarms wait")} for an acknowledgement.`);
  if (soon.length) more.push(`${format.count(soon.length, "valve shows", "valves show")} stiction without an alarm yet.`);
  const other = of("S").length - soon.length;
  if (other > 0) more.push(`${format.count(other, "loop oscillates", "loops oscillate")} for another reason.`);
  if (of("F").length) more.push(`${format.count(of("F").length, "signal has", "signals have")} failed.`);
  if (of("none").length === rows.length) words = `No answer yet: ${format.count(rows.length, "loop is", "loops are")} still collecting a first window.`;
  else if (of("none").length) more.push(`${format.count(of("none").length, "loop is", "loops are")} still collecting a first window.`);
  return { state: need.length ? "act" : soon.length || of("F").length ? "watch" : "good", words, first, more };
}

/** A loop's status with its figures, in one line. */
export function evidence(row) {
  const parts = [row.status];
  const size = sizeOf(row, opUnit(row));
  if (size) parts.push(`s ${size}`);
  if (row.p_stiction !== null && row.p_stiction !== undefined) parts.push(seen(row.p_stiction, row.stiction));
  return `${parts.join(", ")}.`;
}
