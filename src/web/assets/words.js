// The words of the page: verdicts, NE 107, alarm states, gates, and the order of what matters.

import { svg } from "./dom.js";
import { SIGNS, VERDICTS as LISTED } from "./verdicts.js";

export const VERDICTS = { ...LISTED, none: { short: "no window yet", words: "no window yet" } };

export const verdictOf = (row) => row.verdict ?? "none";

/** NAMUR NE 107, most urgent first, and loops without an answer. */
export const NE107 = { ...SIGNS, wait: { name: "no answer", says: "no window yet, or none that can answer" } };

export const neOf = (row) => row.ne107 ?? "wait";

const SHAPES = {
  M: [["rect", { x: 2, y: 2, width: 20, height: 20, rx: 3 }], 16.3],
  F: [["circle", { cx: 12, cy: 12, r: 10.5 }], 16.3],
  S: [["path", { d: "M12 1.5 L23 22 H1 Z" }], 19.6],
  C: [["path", { d: "M12 22.5 L23 2 H1 Z" }], 13.2],
  none: [["circle", { cx: 12, cy: 12, r: 9.5 }], 0],
  wait: [["circle", { cx: 12, cy: 12, r: 9.5 }], 0],
};

/** The symbol: a different shape for every status, with its letter; it always appears with a word. */
export function symbol(key, size = 22) {
  const [[tag, props], baseline] = SHAPES[key] ?? SHAPES.wait;
  const inner = [svg(tag, { ...props, class: "shape" })];
  if (baseline) inner.push(svg("text", { x: 12, y: baseline, "text-anchor": "middle", class: "letter" }, key));
  if (key === "none") inner.push(svg("path", { d: "M8 12 H16", class: "tick" }));
  if (key === "wait") inner.push(svg("path", { d: "M12 7 V12 L15.5 14", class: "tick" }));
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

/** A name with underscores as words; unknown names are shown as they are. */
export const plain = (name) => GATES[name] ?? String(name ?? "").replaceAll("_", " ");

/** Unit of OP. */
export const opUnit = (row) => row?.op_unit ?? "OP units";
