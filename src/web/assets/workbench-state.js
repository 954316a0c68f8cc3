// The chosen options with their history: undo, redo, return to any step.

/** Steps kept. */
const MOST = 200;

/** The program's default options; both orders, as in the toolbox. */
export const DEFAULTS = {
  file: null,
  loop: null,
  sections: [],
  kind: "analyze",
  downsample: null,
  like_toolbox: false,
  detrend: "",
  model: "both",
  delay: "auto",
  valve: "auto",
  solver: "",
  evaluations: null,
  fineness: null,
  seed: null,
  op_low: null,
  op_high: null,
  prevalence: null,
  base: "refit",
  without: [],
  pairs: false,
  budget_s: null,
  axes: "apart",
};

const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);

/** The options with their history. `onChange(now, before)` is called after every change. */
export class Choices {
  constructor() {
    this.steps = [{ words: "Start", now: structuredClone(DEFAULTS) }];
    this.at = 0;
    this.onChange = () => {};
  }

  get now() {
    return this.steps[this.at].now;
  }

  /** Applies a change; `words` describe it. Undone steps are forgotten. */
  change(patch, words) {
    const before = this.now;
    const now = { ...before, ...structuredClone(patch) };
    if (same(now, before)) return;
    this.steps.splice(this.at + 1);
    this.steps.push({ words, now });
    if (this.steps.length > MOST) this.steps.shift();
    this.at = this.steps.length - 1;
    this.onChange(now, before);
  }

  goTo(step) {
    if (step < 0 || step >= this.steps.length || step === this.at) return null;
    const before = this.now;
    const words = this.steps[Math.max(step, this.at)].words;
    this.at = step;
    this.onChange(this.now, before);
    return words;
  }

  undo() {
    return this.goTo(this.at - 1);
  }

  redo() {
    return this.goTo(this.at + 1);
  }
}

/** The request for the program from the options; `baseOf` gives the document of a chosen run. */
export function order(now, baseOf) {
  const common = {
    kind: now.kind,
    file: now.file,
    loop: now.loop,
    samples: now.sections.length ? now.sections.map((s) => [s.from, s.to]) : null,
    downsample: now.downsample,
    like_toolbox: now.like_toolbox && now.downsample !== null,
    detrend: now.detrend || null,
    seed: now.seed,
  };
  if (now.kind === "gap") {
    const base = now.base.startsWith("run:") ? baseOf(now.base) : now.base;
    return { ...common, base, without: now.without, pairs: now.pairs, budget_s: now.budget_s };
  }
  return {
    ...common,
    model: now.model,
    delay: now.delay,
    valve: now.valve,
    fineness: now.fineness,
    solver: now.solver || null,
    evaluations: now.solver ? now.evaluations : null,
    op_range: now.op_low !== null && now.op_high !== null ? [now.op_low, now.op_high] : null,
    prevalence: now.prevalence,
  };
}

/** The options from which a request was made, so that a run can be repeated or varied. */
export function choicesOf(request, sections) {
  const [op_low, op_high] = request.op_range ?? [null, null];
  return {
    file: request.file,
    loop: request.loop,
    sections,
    kind: request.kind,
    downsample: request.downsample ?? null,
    like_toolbox: request.like_toolbox ?? false,
    detrend: request.detrend ?? "",
    seed: request.seed ?? null,
    ...(request.kind === "gap"
      ? { base: typeof request.base === "string" ? request.base : "refit", without: request.without, pairs: request.pairs, budget_s: request.budget_s ?? null }
      : { model: request.model, delay: request.delay ?? "auto", valve: request.valve, fineness: request.fineness ?? null, solver: request.solver ?? "", evaluations: request.evaluations ?? null, prevalence: request.prevalence ?? null, op_low, op_high }),
  };
}

/** Handles the keys for undo and redo, except in text fields, which have their own. Returns a function that removes them. */
export function undoKeys(choices, said) {
  const key = (e) => {
    if (!(e.ctrlKey || e.metaKey) || e.altKey) return;
    const letter = e.key.toLowerCase();
    if (letter !== "z" && letter !== "y") return;
    if (e.target.closest("input:not([type=checkbox]):not([type=radio]), textarea, dialog")) return;
    e.preventDefault();
    const back = letter === "z" && !e.shiftKey;
    const words = back ? choices.undo() : choices.redo();
    said(words ? `${back ? "Undone" : "Redone"}: ${words}` : `Nothing to ${back ? "undo" : "redo"}`);
  };
  document.addEventListener("keydown", key);
  return () => document.removeEventListener("keydown", key);
}
