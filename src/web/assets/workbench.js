// The workbench: open files, choose sections and options, run, view, compare. The numbers are those of the commands.

import { Files, called } from "./workbench-files.js";
import { Form, history } from "./workbench-form.js";
import { showGap } from "./workbench-gap.js";
import { help } from "./workbench-help.js";
import { Preview } from "./workbench-preview.js";
import { showEstimate } from "./workbench-result.js";
import { Runs, over } from "./workbench-runs.js";
import { Choices, choicesOf, order, undoKeys } from "./workbench-state.js";
import { Trend } from "./workbench-trend.js";

/** The options survive a visit to another view. */
const choices = new Choices();

/** Shows the workbench; returns a function that ends it. */
export function show(root, context) {
  const bench = new Bench(root, context);
  bench.start();
  return () => bench.end();
}

/** Facts about a loop before any run. */
function processFacts({ h }, format, one) {
  const units = one.units.some(Boolean) ? one.units.map((unit, k) => `${["OP", "PV"][k]} ${unit ?? "–"}`).join(", ") : null;
  const rows = [
    ["Loop", called(one)],
    ["Sampling time", one.ts_s === null ? "–" : `${format.number(one.ts_s)} s`],
    ["Samples", format.integer(one.samples)],
    ["Length", one.start_ms === null ? "–" : format.duration((one.end_ms - one.start_ms) / 1000)],
    ["Start", format.dateTime(one.start_ms)],
    ["Signals", one.columns.map((name) => name.toUpperCase()).join(", ")],
    ["Units", units],
    ["Tags and note", one.about],
  ];
  return rows.filter(([, value]) => value).map(([name, value]) => h("div", null, h("dt", null, name), h("dd", null, value)));
}

class Bench {
  constructor(root, context) {
    Object.assign(this, { root, context, api: context.api, dom: context.dom, announce: context.announce, h: context.dom.h, fill: context.dom.fill });
    this.endResult = null;
    this.build();
  }

  build() {
    const { h } = this;
    const part = (name, label, title) => {
      this[name] = h("div");
      return h("section", { class: `card wb-part wb-${name}`, "aria-label": label }, title ? h("h2", null, title) : null, this[name]);
    };
    this.note = h("p", { class: "problem", role: "alert", hidden: true });
    this.unfold = h("button", { class: "button wb-unfold", type: "button", "aria-expanded": "false", onclick: () => this.fold(!this.setup.classList.contains("open")) }, "Choices");
    this.toResult = h("button", { class: "button quiet", type: "button", hidden: true, onclick: () => this.look() }, "Result");
    this.go = h("button", { class: "button primary wb-go", type: "button", onclick: () => this.run() }, "Run estimate");
    this.full = h("button", { class: "button", type: "button", "aria-pressed": "false", onclick: () => this.fullScreen() }, "Full screen");
    this.progress = h("div", { class: "wb-under-way" });
    this.side = h("div", { class: "wb-side" }, part("files", "Files", "Files"), this.setup = h("section", { class: "card wb-part wb-setup", "aria-label": "Settings" },
      h("h2", null, "Choices"), this.unfold,
      h("div", { class: "wb-choices" }, this.form = h("div", { class: "wb-form" }), this.steps = h("div", { class: "wb-steps" })),
      h("div", { class: "row wb-run" }, this.go, this.toResult),
      h("div", { class: "wb-status" }, this.note, this.progress)));
    this.title = h("h2", null, "Result");
    this.main = h("div", { class: "wb-main" },
      this.empty = h("section", { class: "card wb-empty", "aria-label": "Getting started" }),
      this.tablePart = h("section", { class: "card wb-part", "aria-label": "Runs compared" }, this.table = h("div")),
      this.trendPart = h("section", { class: "card wb-part", "aria-label": "Trend and sections" }, this.trendTitle = h("h2", null, "Trend"),
        this.facts = h("dl", { class: "facts wb-process", "aria-label": "Process information" }), this.trend = h("div"), this.preview = h("div", { class: "wb-preview" })),
      this.resultPart = h("section", { class: "card wb-part", "aria-label": "Result" }, this.title, this.result = h("div", { class: "wb-result" })));
    this.page = h("div", { class: "wb" },
      h("div", { class: "row spread wb-head" }, h("h1", null, "Workbench"), h("div", { class: "row" }, h("button", { class: "button", type: "button", title: "Key: ?", onclick: () => this.help() }, "Help"), this.full)),
      h("div", { class: "wb-body" }, this.side, this.main));
    this.fill(this.root, this.page);
    this.fill(this.empty, h("h2", null, "Open a file to start"),
      h("ol", { class: "lead" },
        h("li", null, "Open a recording, a compact store (.mat) or an export from a historian."),
        h("li", null, "Select a loop, and drag over its trend to select sections."),
        h("li", null, "Run an estimate, with first and second order side by side, or the gap diagnosis.")),
      h("p", { class: "soft" }, "Files stay on the machine that serves this page. The numbers are identical to those of the commands analyze and gap."));
  }

  async start() {
    const { context } = this;
    this.listen();
    this.fileList = new Files(this.files, context, { chosen: (file, one) => this.chooseLoop(file, one), changed: () => this.arrange() });
    this.trends = new Trend(this.trend, context, { sections: (sections, words) => choices.change({ sections }, words), axes: (axes, words) => choices.change({ axes }, words) });
    this.previews = new Preview(this.preview, context);
    this.runs = new Runs(this.progress, this.table, context, { shown: (job) => this.showResult(job), looked: () => this.look(), called: (job) => this.called(job), changed: () => this.runsChanged(), again: (job) => this.again(job) });
    this.arrange();
    try {
      this.options = await this.api.get("/workbench/options");
      this.forms = new Form(this.form, context, choices, this.options, () => this.runs.bases());
      choices.onChange = (now, before) => this.changed(now, before);
      history(this.steps, context, choices);
      await this.fileList.load();
      await this.runs.load();
      const { file, loop } = choices.now;
      const known = this.fileList.find(file);
      if (known) this.showLoop(known, known.loops.find((one) => one.name === loop));
      else if (this.fileList.files[0]?.loops.length) this.chooseLoop(this.fileList.files[0], this.fileList.files[0].loops[0]);
    } catch (error) {
      if (!this.ended) this.fill(this.root, this.dom.problem(error.message, () => location.reload()));
    }
  }

  listen() {
    this.ends = [
      undoKeys(choices, (words) => this.announce(words)),
      this.on(document, "fullscreenchange", () => this.full.setAttribute("aria-pressed", String(document.fullscreenElement !== null))),
      this.on(document, "keydown", (e) => {
        if (e.target.closest("dialog")) return;
        if (e.key === "Enter" && (e.ctrlKey || e.metaKey) && !this.go.disabled) this.run();
        if (e.key === "?" && !e.target.closest("input:not([type=checkbox]), textarea, select")) this.help();
      }),
    ];
  }

  on(target, name, act) {
    target.addEventListener(name, act);
    return () => target.removeEventListener(name, act);
  }

  fullScreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else this.page.requestFullscreen().catch((error) => this.announce(`Full screen is not available: ${error.message}`));
  }

  /** Opens the help. */
  help() {
    const one = this.loop();
    help(this.dom, one?.samples ?? 0, (patch, words) => choices.change(patch, words));
  }

  /** The chosen loop. */
  loop() {
    const { file, loop } = choices.now;
    return this.fileList?.find(file)?.loops.find((one) => one.name === loop);
  }

  /** Name of a run's loop. */
  called(job) {
    const one = this.fileList?.find(job.request.file)?.loops.find((l) => l.name === job.request.loop);
    return one ? called(one) : job.request.loop;
  }

  /** If there is no room for the options next to the charts, they fold. */
  fold(open) {
    this.setup.classList.toggle("open", open);
    this.unfold.setAttribute("aria-expanded", String(open));
  }

  /** Scrolls to the result. */
  look() {
    this.resultPart.scrollIntoView({ block: "start" });
  }

  /** The user chose a loop, or closed the file of the current one. */
  chooseLoop(file, one) {
    const words = one ? `Loop ${one.name}` : "File closed";
    choices.change({ file: file?.id ?? null, loop: one?.name ?? null, sections: [] }, words);
  }

  showLoop(file, one) {
    this.fileList.choose(file?.id ?? null, one?.name ?? null);
    this.fill(this.trendTitle, one ? `Trend of ${called(one)}` : "Trend");
    this.fill(this.facts, one ? processFacts(this.dom, this.context.format, one) : null);
    this.trends.show(file, one ?? null, choices.now.sections);
    this.arrange();
  }

  /** The options were changed by the user, by undo, or by adopting those of a run. */
  changed(now, before) {
    if (now.file !== before.file || now.loop !== before.loop) {
      const file = this.fileList.find(now.file);
      this.showLoop(file, file?.loops.find((one) => one.name === now.loop));
    } else if (now.sections !== before.sections) {
      this.trends.setSections(now.sections);
    }
    if (now.axes !== before.axes) this.trends.setAxes(now.axes);
    this.forms.update(now, before);
    history(this.steps, this.context, choices);
    this.arrange();
  }

  runsChanged() {
    this.forms?.updateBases();
    this.arrange();
  }

  again(job) {
    const sections = (job.request.samples ?? []).map(([from, to]) => ({ from, to }));
    choices.change(choicesOf(job.request, sections), `Settings of run ${this.runs.number(job)}`);
    this.announce(`The settings of run ${this.runs.number(job)} are applied`);
  }

  /** Shows only the parts that can be used. */
  arrange() {
    const one = this.loop();
    const there = Boolean(one);
    this.previews?.show(one ?? null, choices.now, order(choices.now, () => "refit"));
    const runs = this.runs?.jobs.length > 0;
    this.empty.hidden = there || runs;
    this.trendPart.hidden = !there;
    this.setup.hidden = !there;
    this.resultPart.hidden = !runs;
    this.tablePart.hidden = !runs;
    this.toResult.hidden = !runs;
    this.go.disabled = !there;
    this.go.textContent = choices.now.kind === "gap" ? "Diagnose the gap" : "Run estimate";
  }

  async run() {
    this.note.hidden = true;
    this.go.disabled = true;
    try {
      // Include an entry in a field that still has the focus.
      document.activeElement?.dispatchEvent(new Event("change", { bubbles: true }));
      await this.runs.order(order(choices.now, (base) => this.runs.document(base)));
      this.fold(false);
      this.announce("The run has started");
    } catch (error) {
      this.fill(this.note, error.message).hidden = false;
    }
    this.go.disabled = false;
  }

  showResult(job) {
    this.endResult?.();
    this.endResult = null;
    const { h, fill } = this;
    // Keep the page's height during redrawing, so that the scroll position stays.
    this.result.style.minHeight = `${this.result.offsetHeight}px`;
    setTimeout(() => (this.result.style.minHeight = ""), 1000);
    if (!job) return fill(this.result);
    fill(this.title, `Run ${this.runs.number(job)}: ${job.request.kind === "gap" ? "gap" : "estimate"} of ${this.called(job)}`);
    const one = this.fileList?.find(job.request.file)?.loops.find((l) => l.name === job.request.loop);
    const context = { ...this.context, h, fill, problem: this.dom.problem, units: one?.units ?? [null, null] };
    if (job.error) return fill(this.result, h("p", { class: "problem" }, job.error));
    if (!job.results?.length) return fill(this.result, over(job) ? h("p", { class: "note" }, "This run was cancelled before its first result.") : this.dom.skeleton(6));
    if (job.request.kind === "gap") this.endResult = showGap(this.result, context, job);
    else showEstimate(this.result, context, job);
    return undefined;
  }

  end() {
    this.ended = true;
    choices.onChange = () => {};
    this.endResult?.();
    this.ends.forEach((end) => end());
    this.fileList.end();
    this.trends.end();
    this.previews.end();
    this.runs.end();
  }
}
