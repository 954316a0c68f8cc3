// The runs so far: requests, progress, cancellation, and a table to compare them.

import { badge, saveText } from "./workbench-result.js";

const STATES = { queued: "Waiting", running: "Running", done: "Done", failed: "Failed", cancelled: "Cancelled" };
/** Pause before reconnecting a lost stream, ms. */
const AGAIN_MS = 1500;

/** All runs. `on`: `shown(job)` draws one, `looked()` brings it into view, `called(job)` is its loop, `changed()` hears of every change, `again(job)` takes its choices. */
export class Runs {
  constructor(root, table, { api, dom, format, announce }, on) {
    Object.assign(this, { root, table, api, format, announce, on, h: dom.h, fill: dom.fill, cell: dom.figureCell });
    this.jobs = [];
    this.chosen = null;
    this.streams = new Map();
    this.timers = new Set();
  }

  /** Loads the runs that the program knows. */
  async load() {
    this.jobs = (await this.api.get("/workbench/jobs")).jobs;
    for (const job of this.jobs) if (!over(job)) this.follow(job.id);
    if (this.jobs.length) this.choose(this.jobs[this.jobs.length - 1].id);
    this.draw();
  }

  find(id) {
    return this.jobs.find((job) => job.id === id);
  }

  number(job) {
    return Number(job.id.slice(1));
  }

  /** Runs with an estimate, as possible bases. */
  bases() {
    const all = this.jobs.filter((job) => job.request.kind === "analyze" && job.results?.some((r) => r.document?.process));
    return all.flatMap((job) => job.results.map((r, k) => ({ r, k })).filter(({ r }) => r.document?.process).map(({ r, k }) => ({
      base: `run:${job.id}:${k}`, number: this.number(job), words: [job.request.loop, r.section, r.model === "auto" ? "" : r.model].filter(Boolean).join(", "),
    })));
  }

  /** The document of a chosen base. */
  document(base) {
    const [, id, k] = base.split(":");
    return this.find(id)?.results?.[Number(k)]?.document ?? "refit";
  }

  async order(request) {
    const { id } = await this.api.post("/workbench/jobs", request);
    this.jobs.push(await this.api.get(`/workbench/jobs/${id}`));
    this.choose(id);
    this.follow(id);
    this.draw();
  }

  /** Listens to a job until it ends. */
  follow(id) {
    let seen = -1;
    const close = this.api.stream(`/workbench/jobs/${id}/events`, {
      onEvent: (name, told) => {
        const job = this.find(id);
        if (name !== "job" || !job) return;
        const { results } = job;
        Object.assign(job, told, { results });
        const news = told.finished[0] + 100 * told.finished[1] + (over(job) ? 1e6 : 0);
        this.drawProgress();
        if (news !== seen) this.fetch(id);
        seen = news;
      },
      onEnd: () => {
        this.streams.delete(id);
        const job = this.find(id);
        if (!job || over(job)) return;
        const timer = setTimeout(() => this.timers.delete(timer) && this.follow(id), AGAIN_MS);
        this.timers.add(timer);
      },
    });
    this.streams.set(id, close);
  }

  async fetch(id) {
    try {
      const job = await this.api.get(`/workbench/jobs/${id}`);
      const at = this.jobs.findIndex((other) => other.id === id);
      if (at < 0) return;
      const before = this.jobs[at];
      this.jobs[at] = job;
      if (over(job) && before.told !== job.state) this.announce(`Run ${this.number(job)}: ${STATES[job.state].toLowerCase()}${job.error ? `: ${job.error}` : ""}`);
      job.told = job.state;
      if (this.chosen === id) this.on.shown(job);
      this.draw();
    } catch (error) {
      this.announce(error.message);
    }
  }

  choose(id) {
    this.chosen = id;
    const job = this.find(id);
    if (job) this.on.shown(job);
    this.draw();
  }

  async remove(job) {
    try {
      const { state } = await this.api.del(`/workbench/jobs/${job.id}`);
      if (over(job)) this.jobs = this.jobs.filter((other) => other !== job);
      else Object.assign(job, { state });
    } catch (error) {
      this.announce(error.message);
    }
    if (this.chosen === job.id && !this.find(job.id)) {
      const last = this.jobs[this.jobs.length - 1];
      this.chosen = last?.id ?? null;
      this.on.shown(last ?? null);
    }
    this.draw();
  }

  draw() {
    this.drawProgress();
    this.drawTable();
    this.on.changed();
  }

  drawProgress() {
    const { h, fill, format } = this;
    const under = this.jobs.filter((job) => !over(job));
    // A focused button must not be replaced at every step.
    const focused = this.root.contains(document.activeElement) ? document.activeElement.dataset.job : null;
    fill(this.root, under.map((job) => {
      const { done, of, words } = job.progress;
      const cancel = h("button", { class: "button", type: "button", "data-job": job.id, onclick: () => this.remove(job) }, "Cancel");
      return h("div", { class: "row wb-progress" }, h("b", null, `Run ${this.number(job)}`),
        h("progress", { max: of ?? 1, value: of ? done : null, "aria-label": `Progress of run ${this.number(job)}` }),
        h("span", { class: "wb-progress-words" }, words), h("span", { class: "soft" }, job.state === "running" ? format.duration(job.elapsed_ms / 1000) : ""), cancel);
    }));
    if (focused) this.root.querySelector(`[data-job="${focused}"]`)?.focus();
  }

  cells(job, result) {
    const { h, format } = this;
    const d = result?.document;
    const n = (v, minor) => h("td", { class: minor ? "number wb-minor" : "number" }, v);
    // On narrow screens, where rows are folded, every figure shows its name.
    const named = (name, cell) => {
      cell.dataset.name = name;
      return cell;
    };
    if (!d) return [h("td", { colspan: "7", class: job.state === "failed" ? null : "soft" }, job.error ?? result?.notes?.join(" ") ?? STATES[job.state])];
    if (job.request.kind === "gap") {
      const cause = d.effects.find((e) => e.id === d.cause.id);
      const answer = { none: "no effect needed", unknown: "not explained" }[d.cause.id] ?? d.cause.id.replaceAll("_", " ");
      return [h("td", null, answer), named("p", n(format.probability(d.cause.probability))),
        h("td", { colspan: "5" }, `gap ${format.number(d.gap.gap)}${cause?.closed_pct ? `, closed ${format.estimate(cause.closed_pct, cause.closed_interval, "%")}` : ""}`)];
    }
    const p = d.process;
    return [h("td", null, badge(h, d.verdict)), named("p", n(format.probability(d.p_stiction))),
      named("s", this.cell(format.parts(d.s, d.s_interval))), named("j", this.cell(format.parts(d.j, d.j_interval))), n(format.number(d.stiction_index), true),
      n(p ? format.number(p.fit_pct) : "–", true), n(p ? format.duration(p.dead_time_s) : "–", true)];
  }

  drawTable() {
    const { h, fill } = this;
    if (!this.jobs.length) return fill(this.table);
    const heads = ["Run", "What", "Answer", "p", "s", "j", "Index", "Fit, %", "Dead time", ""];
    const body = [...this.jobs].reverse().flatMap((job) => {
      const results = job.results?.length ? job.results : [null];
      return results.map((result, k) => h("tr", { class: this.chosen === job.id ? "wb-chosen" : null },
        k === 0 ? h("th", { scope: "row", rowspan: String(results.length) }, h("button", { class: "button quiet", type: "button", "aria-pressed": String(this.chosen === job.id), title: "Show its result", onclick: () => {
          this.choose(job.id);
          this.on.looked();
        } }, `Run ${this.number(job)}`)) : null,
        h("td", { class: "wb-what" }, what(job, result, this.on.called(job))), this.cells(job, result),
        k === 0 ? h("td", { rowspan: String(results.length), class: "number" },
          h("button", { class: "button quiet", type: "button", title: "Use the settings of this run", "aria-label": `Use the settings of run ${this.number(job)}`, onclick: () => this.on.again(job) }, "Settings"),
          over(job) ? h("button", { class: "button quiet icon", type: "button", "aria-label": `Remove run ${this.number(job)}`, title: "Remove", onclick: () => this.remove(job) }, "×") : null) : null));
    });
    return fill(this.table, h("div", { class: "row spread" }, h("h2", null, "Runs compared"),
      h("button", { class: "button quiet", type: "button", onclick: () => this.save() }, "Save table (CSV)")),
      h("div", { class: "scroll wb-compare-scroll", tabindex: "0", role: "region", "aria-label": "Table of runs" }, h("table", { class: "table wb-compare" }, h("caption", { class: "unseen" }, "Runs made so far, newest first"),
        h("thead", null, h("tr", null, heads.map((t, k) => h("th", { scope: "col", class: `${k > 2 ? "number" : ""}${k > 5 && k < 9 ? " wb-minor" : ""}` || null }, t || h("span", { class: "unseen" }, "Actions"))))), h("tbody", null, body))));
  }

  save() {
    const quote = (v) => (v === null || v === undefined ? "" : /[",\n]/.test(String(v)) ? `"${String(v).replaceAll('"', '""')}"` : String(v));
    const head = ["run", "kind", "loop", "section", "model", "verdict", "p_stiction", "s", "s_low", "s_high", "j", "j_low", "j_high", "fs", "fd", "stiction_index", "fit_pct", "gain", "dead_time_s", "cause", "gap", "command"];
    const lines = this.jobs.flatMap((job) => (job.results ?? []).filter((r) => r.document).map((r) => {
      const d = r.document;
      const [s, j] = [d.s_interval ?? [], d.j_interval ?? []];
      return [this.number(job), job.request.kind, job.request.loop, r.section, r.model, d.verdict, d.p_stiction, d.s, s[0], s[1], d.j, j[0], j[1], d.fs, d.fd, d.stiction_index, d.process?.fit_pct, d.process?.gain, d.process?.dead_time_s, d.cause?.id, d.gap?.gap, job.command];
    }));
    saveText(this.h, "runs.csv", "text/csv", [head, ...lines].map((line) => line.map(quote).join(",")).join("\n") + "\n");
  }

  end() {
    for (const close of this.streams.values()) close();
    for (const timer of this.timers) clearTimeout(timer);
  }
}

/** Whether a job has ended. */
export const over = (job) => ["done", "failed", "cancelled"].includes(job.state);

function what(job, result, name) {
  const { request } = job;
  const parts = [name, result?.section || (request.samples ? `${request.samples.length} sections` : "whole record")];
  if (request.kind === "gap") parts.push("gap", request.base && request.base !== "refit" ? (typeof request.base === "string" ? `base ${request.base}` : "given base") : null, request.without.length ? `without ${request.without.length}` : null);
  else parts.push({ fopdt: "first order", sopdt: "second order" }[result?.model ?? request.model] ?? null, request.valve !== "auto" ? request.valve : null, request.delay && request.delay !== "auto" ? `dead time ${request.delay}` : null);
  if (request.downsample) parts.push(`one point for every ${request.downsample}`);
  if (request.detrend) parts.push(`without ${request.detrend}`);
  return parts.filter(Boolean).join(", ");
}
