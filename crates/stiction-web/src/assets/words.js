// The words of the page: verdicts, NE 107, alarm states, gates, and the order of what matters.

import { svg } from "./dom.js";
import { estimate, number, probability } from "./format.js";
import { VERDICTS as LISTED } from "./verdicts.js";

export const VERDICTS = { ...LISTED, none: { short: "no window yet", words: "no window yet" } };

export const verdictOf = (row) => row.verdict ?? "none";

/** NAMUR NE 107, most pressing first on this page: what a valve needs, then what hides the answer. */
export const NE107 = {
  M: { name: "maintenance required", says: "stiction alarm" },
  F: { name: "failure of the signal", says: "signal frozen, bad or missing" },
  S: { name: "out of specification", says: "oscillates, or sticks without an alarm yet" },
  C: { name: "function check", says: "in manual or out of service" },
  none: { name: "no window yet", says: "collecting a first window" },
  ok: { name: "OK", says: "no sign of stiction found" },
};

export const neOf = (row) => row.ne107 ?? "none";

const SHAPES = {
  M: [["rect", { x: 2, y: 2, width: 20, height: 20, rx: 3 }], 16.3],
  F: [["circle", { cx: 12, cy: 12, r: 10.5 }], 16.3],
  S: [["path", { d: "M12 1.5 L23 22 H1 Z" }], 19.6],
  C: [["path", { d: "M12 22.5 L23 2 H1 Z" }], 13.2],
  ok: [["circle", { cx: 12, cy: 12, r: 9.5 }], 0],
  none: [["circle", { cx: 12, cy: 12, r: 9.5 }], 0],
};

/** The symbol: a shape of its own for every status, with its letter; a word is always beside it. */
export function symbol(key, size = 22) {
  const [[tag, props], baseline] = SHAPES[key] ?? SHAPES.none;
  const inner = [svg(tag, { ...props, class: "shape" })];
  if (baseline) inner.push(svg("text", { x: 12, y: baseline, "text-anchor": "middle", class: "letter" }, key));
  if (key === "ok") inner.push(svg("path", { d: "M7 12.5 L10.7 16 L17 8.7", class: "tick" }));
  if (key === "none") inner.push(svg("path", { d: "M12 7 V12 L15.5 14", class: "tick" }));
  return svg("svg", { class: `ne ne-${key}`, width: size, height: size, viewBox: "0 0 24 24", "aria-hidden": "true", focusable: "false" }, inner);
}

/** ISA-18.2 states. */
export const STATES = {
  unack: "active, unacknowledged",
  rtn_unack: "cleared, unacknowledged",
  acked: "active, acknowledged",
  shelved: "shelved",
  suppressed: "suppressed by design",
  out_of_service: "out of service",
  normal: "normal",
};

export const EVENTS = {
  raised: "raised",
  worse: "got worse",
  cleared: "cleared",
  acknowledged: "acknowledged",
  shelved: "shelved",
  unshelved: "taken off the shelf",
  shelf_ended: "shelf time ended",
  suppressed: "suppressed",
  unsuppressed: "no longer suppressed",
  out_of_service: "taken out of service",
  in_service: "back in service",
  removed: "ended: the loop was removed",
  restored: "repeated after a restart",
};

export const PRIORITIES = ["urgent", "high", "medium", "low"];

export const METHODS = {
  stroke_test: "stroke test",
  inspection: "inspection",
  false_alarm: "false alarm",
  other: "other",
};

const GATES = {
  manual: "in manual",
  bad_quality: "bad quality",
  frozen_pv: "PV frozen",
  frozen_op: "OP frozen",
  no_response: "PV does not answer OP",
  op_scale: "OP looks like a fraction",
  swapped: "OP and PV swapped",
  saturated: "OP at a limit",
  too_few_samples: "too few samples",
  rate_too_low: "sampled too slowly to judge",
  skipped: "fit skipped",
  too_few_periods: "too few periods",
  too_coarse: "sampled too coarsely",
  too_few_reversals: "too few reversals of the stem",
  setpoint_steps: "set point moved",
  quantised: "coarse resolution",
  compressed: "compressed history",
  irregular: "uneven sampling",
  excursion: "a single event left out",
  step_or_upset: "a step or an upset, kept",
};

/** A name with underscores as words; what is not known is shown as it is. */
export const plain = (name) => GATES[name] ?? String(name ?? "").replaceAll("_", " ");

/** How far an answer may be trusted. */
export const GRADES = {
  A: "grade A: very good",
  B: "grade B: good",
  C: "grade C: with reservations",
  D: "grade D: no answer",
};

const NE_RANK = { M: 5, F: 3, S: 2, C: 1.5, none: 1, ok: 0 };
const PRIORITY_RANK = { urgent: 4, high: 3, medium: 2, low: 1 };
const CLASS_RANK = { strong: 3, moderate: 2, weak: 1 };

/** How pressing a loop is; greater comes first. */
export function severity(row) {
  const rank = NE_RANK[neOf(row)] + (row.ne107 === "S" && row.stiction ? 2 : 0);
  const weight = PRIORITY_RANK[row.priority] ?? 0;
  return rank * 1e4 + weight * 1e3 + (row.unacknowledged ? 500 : 0) + (CLASS_RANK[row.class] ?? 0) * 100 + (row.p_stiction ?? 0) * 100 + Math.min(row.s ?? 0, 99) / 10;
}

/** Unit of s. */
export const opUnit = (row) => row?.op_unit ?? "OP units";

/** The probability as it is shown: below the decision threshold "not seen", with the figure behind it. */
export const seen = (p, stiction) => (stiction === false ? `not seen (p ${probability(p)})` : `p ${probability(p)}`);

/** s of a loop or estimate whose valve sticks; a lower bound where the estimate reaches its own; null otherwise. */
export function sizeOf(found, unit) {
  if (found.stiction !== true || found.s === null || found.s === undefined) return null;
  if (atBound(found)) return `at least ${number(found.s_interval?.[0] ?? found.s)} ${unit}`;
  return estimate(found.s, found.s_interval, unit);
}

// Where the estimate or its interval ends at OP's span, s was not measured upwards; rows of lists say so themselves.
function atBound(found) {
  if (found.s_at_least !== undefined) return found.s_at_least;
  const span = found.s_over_span ? found.s / found.s_over_span : Infinity;
  return Math.max(found.s, found.s_interval?.[1] ?? 0) >= 0.999 * span;
}
