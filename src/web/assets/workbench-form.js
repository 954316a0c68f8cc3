// The options as a form. Every change is one step of the history.

import { FIELDS } from "./workbench-help.js";

let serial = 0;

/** Options that determine the form's layout. */
const SHAPING = ["kind", "solver", "downsample", "without"];

/** The form of options. `runs()` lists runs whose estimate can be a base. */
export class Form {
  constructor(root, { dom }, choices, options, runs) {
    Object.assign(this, { root, choices, options, runs, h: dom.h, fill: dom.fill });
    this.draw();
  }

  /** Takes a change that the user made here. */
  set(patch, words) {
    this.own = true;
    this.choices.change(patch, words);
    this.own = false;
  }

  /** Follows a change. An entry made here is displayed already, unless the form's layout depends on it. */
  update(now, before) {
    if (!this.own) this.draw();
    // Later, after the focus has moved.
    else if (SHAPING.some((key) => now[key] !== before[key])) setTimeout(() => this.draw());
  }

  /** The runs that can be a base have changed. */
  updateBases() {
    const bases = JSON.stringify(this.runs());
    if (this.choices.now.kind === "gap" && bases !== this.bases) this.draw();
  }

  draw() {
    const { h, fill } = this;
    const now = this.choices.now;
    const active = this.root.contains(document.activeElement) ? document.activeElement : null;
    const focused = active && (active.name || active.dataset.name);
    this.bases = JSON.stringify(this.runs());
    const kinds = [["analyze", "Estimate", "Stiction of the valve"], ["gap", "Gap", "What the model misses"]].map(([id, words, title]) =>
      h("button", { class: "button", type: "button", name: `kind-${id}`, title, "aria-pressed": String(now.kind === id), onclick: () => this.set({ kind: id }, words) }, words));
    fill(this.root, h("div", { class: "row segments", role: "group", "aria-label": "Kind of run" }, kinds),
      this.data(now), now.kind === "gap" ? this.gap(now) : this.estimate(now));
    if (focused) this.root.querySelector(`[name="${focused}"], [data-name="${focused}"]`)?.focus();
  }

  field(label, control, hint) {
    const id = `wb-${++serial}`;
    control.id = id;
    const note = hint && this.h("small", { class: "soft", id: `${id}-hint` }, hint);
    if (note) control.setAttribute("aria-describedby", note.id);
    return this.h("div", { class: "field", title: FIELDS[control.name]?.[1] ?? null }, this.h("label", { for: id }, label), control, note);
  }

  select(key, label, all, hint) {
    const { h } = this;
    const now = this.choices.now[key];
    const options = all.map((o) => h("option", { value: o.id, selected: o.id === now }, o.words));
    const words = (value) => all.find((o) => o.id === value)?.words ?? value;
    return this.field(label, h("select", { name: key, onchange: (e) => this.set({ [key]: e.target.value }, `${label}: ${words(e.target.value)}`) }, options), hint);
  }

  number(key, label, bounds, hint) {
    const { h } = this;
    const value = this.choices.now[key];
    const input = h("input", { type: "number", name: key, step: "any", min: bounds.min ?? null, max: bounds.max ?? null, placeholder: bounds.default === null || bounds.default === undefined ? (bounds.none ?? "") : String(bounds.default), value: value ?? "" });
    input.addEventListener("change", () => {
      if (!input.reportValidity()) return;
      const given = input.value.trim() === "" ? null : Number(input.value);
      this.set({ [key]: given }, given === null ? `${label}: default` : `${label}: ${given}`);
    });
    return this.field(bounds.unit ? `${label}, ${bounds.unit}` : label, input, hint);
  }

  check(key, label, hint) {
    const { h } = this;
    const input = h("input", { type: "checkbox", name: key, checked: this.choices.now[key], onchange: (e) => this.set({ [key]: e.target.checked }, `${label}: ${e.target.checked ? "yes" : "no"}`) });
    return h("label", { class: "wb-check", title: hint ?? FIELDS[key]?.[1] ?? null }, input, " ", label);
  }

  group(title, ...children) {
    return this.h("fieldset", null, this.h("legend", null, title), children);
  }

  estimate(now) {
    const { h, options } = this;
    const delay = h("input", { type: "text", name: "delay", value: now.delay, pattern: "auto|[0-9.]+s?", title: "auto, samples such as 3, or seconds such as 12s" });
    delay.addEventListener("change", () => {
      const text = delay.value.trim() || "auto";
      delay.value = text;
      if (delay.reportValidity()) this.set({ delay: text }, `Dead time: ${text}`);
    });
    return [
      this.group("Model",
        this.select("model", "Process", options.models),
        this.field("Dead time", delay, "auto, samples such as 3, or seconds such as 12s"),
        this.select("valve", "Valve law", options.valves)),
      this.group("OP's range",
        h("div", { class: "wb-pair" }, this.number("op_low", "From", { none: "0" }), this.number("op_high", "To", { none: "100" })),
        h("small", { class: "soft" }, "For sizes in % of travel")),
      this.number("prevalence", "Share that sticks", options.prevalence, "Share of such loops that stick, which p assumes; verdicts do not depend on it"),
      h("details", { class: "wb-more", open: now.solver !== "" || this.moreOpen, ontoggle: (e) => (this.moreOpen = e.target.open) },
        h("summary", { "data-name": "more" }, "Solver, fineness, seed"),
        this.select("solver", "Additional solver", options.solvers),
        now.solver ? this.number("evaluations", "Most models evaluated", { ...options.evaluations, unit: "" }) : null,
        this.number("fineness", "Fineness", options.fineness, "Step of the contour grid, % of OP's span"),
        this.number("seed", "Seed", { min: 0, default: options.seed })),
    ];
  }

  gap(now) {
    const { h, options } = this;
    const runs = this.runs().map((run) => ({ id: run.base, words: `Estimate of run ${run.number}: ${run.words}` }));
    const stages = new Map();
    for (const effect of options.effects) stages.set(effect.stage, [...(stages.get(effect.stage) ?? []), effect]);
    const effect = (e) => h("label", { class: "wb-check" }, h("input", { type: "checkbox", name: `effect-${e.id}`, checked: !now.without.includes(e.id), onchange: (event) => {
      const others = this.choices.now.without.filter((id) => id !== e.id);
      const without = event.target.checked ? others : [...others, e.id];
      this.set({ without }, `${event.target.checked ? "With" : "Without"} ${e.words}`);
    } }), " ", e.words.replace(/^an? /, ""));
    const left = now.without.length;
    return [
      this.group("Model", this.select("base", "Base", [...options.bases, ...runs], "Model that the gap is measured from")),
      h("details", { class: "wb-more", open: this.effectsOpen ?? false, ontoggle: (e) => (this.effectsOpen = e.target.open) },
        h("summary", { "data-name": "effects" }, left ? `Effects: ${options.effects.length - left} of ${options.effects.length}` : `Effects: all ${options.effects.length}`),
        [...stages].map(([stage, effects]) => this.group(`${stage.replaceAll("_", " ")}`, effects.map(effect))),
        left ? h("button", { class: "button", type: "button", name: "all-effects", onclick: () => this.set({ without: [] }, "All effects") }, "All effects") : null),
      this.group("Search",
        this.check("pairs", "Also search pairs of effects when one explains the gap"),
        this.number("budget_s", "Time", { ...options.budget_s, none: "about 5" }),
        this.number("seed", "Seed", { min: 0, default: options.gap_seed })),
    ];
  }

  data(now) {
    return this.group("Data",
      this.number("downsample", "One point for every", { ...options_of(this.options.downsample), none: "sample" }, "Samples per point; 2.5 is allowed. Empty: every sample"),
      now.downsample !== null ? this.check("like_toolbox", "Drop samples, as the toolbox does", "May alias; otherwise bins are averaged") : null,
      this.select("detrend", "Trend of PV", this.options.detrends));
  }
}

// A ratio of 1 would not be downsampling.
const options_of = (number) => ({ ...number, min: 1.0001, unit: "" });

/** The history as a list of steps to return to. */
export function history(root, { dom }, choices) {
  const { h, fill } = dom;
  const step = (s, k) => h("li", null, h("button", { class: "wb-step", type: "button", "aria-current": k === choices.at ? "step" : null, "data-later": k > choices.at, onclick: () => choices.goTo(k) }, s.words));
  const steps = choices.steps.map(step).reverse();
  const back = choices.at > 0;
  const on = choices.at < choices.steps.length - 1;
  fill(root,
    h("div", { class: "row" },
      h("button", { class: "button", type: "button", disabled: !back, title: "Ctrl-Z", onclick: () => choices.undo() }, "↶ Undo"),
      h("button", { class: "button", type: "button", disabled: !on, title: "Ctrl-Shift-Z", onclick: () => choices.redo() }, "↷ Redo")),
    h("details", null, h("summary", null, `History: ${choices.steps.length - 1} ${choices.steps.length === 2 ? "step" : "steps"}`), h("ol", { class: "wb-history", reversed: true }, steps)));
}
