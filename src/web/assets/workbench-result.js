// Result of a run: plain words, numbers with intervals, pictures; first and second order next to each other.

import { VERDICTS } from "./verdicts.js";
import { solverTable } from "./workbench-solver.js";

const NAMES = { fopdt: "First order", sopdt: "Second order", auto: "Order chosen by the fit" };

/** Lines that are always visible. */
const MOST_LINES = 3;

const KINDS = { stiction: "bad", deadband: "bad", disturbance: "other", tuning: "other", not_oscillating: "none", cause_unknown: "other" };

/** A verdict as a badge with its word; never by colour alone. */
export function badge(h, verdict) {
  return h("span", { class: `wb-badge ${KINDS[verdict] ?? "open"}` }, VERDICTS[verdict]?.short ?? verdict ?? "no answer");
}

/** Sections of a job's results, each with its runs. */
export function bySection(results) {
  const sections = [];
  for (const result of results) {
    const last = sections[sections.length - 1];
    if (last && last[0].section === result.section) last.push(result);
    else sections.push([result]);
  }
  return sections;
}

const interval = (format, v, range, unit) => (v === null || v === undefined ? "–" : format.estimate(v, range, unit ?? ""));

/** Rows of numbers: name, hint, and how to get the text from a document with its error maps. */
function rows(format, units) {
  const [op] = units;
  const n = format.number;
  const process = (d, of) => (d.process ? of(d.process) : "–");
  const tested = (d, of) => (d.process?.tested === false ? "not tested by this record" : process(d, of));
  const map = (d, maps, of) => {
    const own = maps.find((m) => m.order === d.process?.order);
    return own ? of(own) : null;
  };
  const between = ([low, high]) => `${n(low)} to ${n(high)}${op ? ` ${op}` : ""}`;
  return [
    ["Stiction", "p where the configured share of loops sticks", (d) => d.probability ?? format.probability(d.p_stiction)],
    ["Grade", "of a finding: A surest", (d) => d.grade ?? "–"],
    ["Deadband + stickband, s", "fs + fd", (d) => interval(format, d.s, d.s_interval, op)],
    ["Slip jump, j", "fs − fd", (d) => (d.j_identifiable === false ? `${interval(format, d.j, d.j_interval, op)}, not identifiable` : interval(format, d.j, d.j_interval, op))],
    ["Static band, fs", "", (d) => interval(format, d.fs, d.fs_interval, op)],
    ["Kinetic band, fd", "", (d) => interval(format, d.fd, d.fd_interval, op)],
    ["OP's span, S0", "upper limit of fs + fd", (d) => (d.s0 === null ? "–" : `${n(d.s0)}${op ? ` ${op}` : ""}`)],
    ["Suggested region, fs", "box on the error map: whole cells, 2.5 % of S0 wide", (d, maps) => map(d, maps, (m) => between(m.fs))],
    ["Suggested region, fd", "", (d, maps) => map(d, maps, (m) => between(m.fd))],
    ["s over S0", "", (d) => (d.s_over_span === null ? "–" : `${n(100 * d.s_over_span)} %`)],
    ["Stiction index", "share of the error that friction explains", (d) => n(d.stiction_index)],
    ["Period", "", (d) => (d.oscillation.period_s === null ? "–" : `${format.duration(d.oscillation.period_s)}, ${n(d.oscillation.periods)} of them`)],
    ["Fit", "share of PV's deviation, free run", (d) => process(d, (p) => `${n(p.fit_pct)} %`)],
    ["Mean squared error", "free run", (d) => process(d, (p) => n(p.mse))],
    ["Gain", "", (d) => tested(d, (p) => n(p.gain))],
    ["Time constants", "", (d) => tested(d, (p) => (p.time_constants_s.length ? p.time_constants_s.map((t) => format.duration(t)).join(", ") : "none"))],
    ["Dead time", "", (d) => tested(d, (p) => format.duration(p.dead_time_s))],
    ["Valve law", "", (d) => d.valve_model ?? "–"],
    ["Gates", "", (d) => (d.gates.length ? d.gates.map((g) => g.replaceAll("_", " ")).join(", ") : "none")],
    ["Elapsed", "", (d) => `${format.integer(d.elapsed_ms)} ms`],
  ];
}

/** A copy button that confirms copying. */
export function copyButton(h, announce, words, text) {
  const button = h("button", { class: "button", type: "button", onclick: async () => {
    try {
      await navigator.clipboard.writeText(text());
      announce("Copied");
      button.textContent = "Copied";
    } catch {
      // Without access to the clipboard, show the text for copying by hand.
      button.replaceWith(h("textarea", { class: "wb-copy", rows: "2", readonly: true, "aria-label": words, value: text() }));
    }
    setTimeout(() => (button.textContent = words), 1500);
  } }, words);
  return button;
}

/** Saves a text as a file. */
export function saveText(h, name, type, text) {
  const link = h("a", { href: URL.createObjectURL(new Blob([text], { type })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

const fileName = (text) => text.replace(/[^\p{L}\p{N}._-]+/gu, "_");

/** Downloads of a result: report, command, documents. */
export function ways({ h, api, announce }, job, results) {
  const reports = [...new Map(results.filter((r) => r.report_url).map((r) => [r.report_url, r])).values()];
  const stem = fileName(job.request.loop);
  const documents = () => results.filter((r) => r.document).map((r) => JSON.stringify(r.document)).join("\n") + "\n";
  return h("div", { class: "row wb-ways" },
    reports.map((r) => {
      const words = r.model && reports.length > 1 ? `, ${NAMES[r.model].toLowerCase()}` : "";
      return [h("a", { class: "button", href: api.url(r.report_url), target: "_blank", rel: "noopener" }, `Open report${words}`),
        h("a", { class: "button", href: api.url(r.report_url), download: `${stem}-${r.model ?? "gap"}.html` }, `Save report${words}`)];
    }),
    copyButton(h, announce, "Copy command", () => job.command),
    h("button", { class: "button quiet", type: "button", onclick: () => saveText(h, `${stem}-${job.request.kind}.json`, "application/json", documents()) }, "Save numbers (JSON)"));
}

const sentence = (words) => words.charAt(0).toUpperCase() + words.slice(1) + (/[.!?]$/.test(words) ? "" : ".");

/** A result's sentences by subject. */
function said(result) {
  const seen = new Map();
  for (const { about, text } of result.words) seen.set(about, [...(seen.get(about) ?? []), sentence(text)]);
  return seen;
}

/** Plain words, one row for each subject; equal texts of both orders appear once. */
function words(h, found) {
  const shown = found.filter((r) => r.document);
  const all = shown.map(said);
  const abouts = [...new Set(all.flatMap((one) => [...one.keys()]))];
  const list = (texts) => h("ul", null, texts.map((t) => h("li", null, t)));
  const folded = (texts) => h("details", null, h("summary", null, `${texts.length} steps`), list(texts));
  const text = (texts) => (texts === undefined ? "–" : texts.length === 1 ? texts[0] : texts.length > MOST_LINES ? folded(texts) : list(texts));
  const row = (about) => {
    const cells = all.map((one) => one.get(about));
    const alike = cells.every((cell) => JSON.stringify(cell) === JSON.stringify(cells[0]));
    return h("tr", null, h("th", { scope: "row" }, about),
      alike ? h("td", { colspan: cells.length > 1 ? String(cells.length) : null }, text(cells[0])) : cells.map((cell, k) => h("td", { "data-name": NAMES[shown[k].model] }, text(cell))));
  };
  const head = shown.length > 1 ? h("thead", null, h("tr", null, h("td"), shown.map((r) => h("th", { scope: "col" }, NAMES[r.model], " ", badge(h, r.document.verdict))))) : null;
  const notes = found.flatMap((r) => r.notes.map((note) => ({ note, wrong: !r.document })));
  const seen = new Set();
  return [
    shown.length === 1 ? h("p", null, badge(h, shown[0].document.verdict)) : null,
    shown.length ? h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "In plain words" }, h("table", { class: "table wb-words" }, head, h("tbody", null, abouts.map(row)))) : null,
    notes.filter(({ note }) => !seen.has(note) && seen.add(note)).map(({ note, wrong }) => h("p", { class: wrong ? "problem" : "note" }, note)),
  ];
}

function numbers(h, format, found, units) {
  const shown = found.filter((r) => r.document);
  if (!shown.length) return null;
  const head = shown.length > 1 ? h("thead", null, h("tr", null, h("th", { scope: "col" }, "Number"), shown.map((r) => h("th", { scope: "col" }, NAMES[r.model])))) : null;
  const body = rows(format, units).map(([name, hint, of]) => {
    const cells = shown.map((r) => of(r.document, r.maps));
    if (cells.every((cell) => cell === null)) return null;
    return h("tr", null, h("th", { scope: "row" }, name, hint ? h("small", { class: "soft under" }, hint) : null), cells.map((cell) => h("td", null, cell ?? "–")));
  });
  return h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Numbers" }, h("table", { class: "table wb-numbers" }, h("caption", { class: "soft" }, "Intervals at 90 %"), head, h("tbody", null, body)));
}

/** Pictures of the runs: equal ones once, the others in pairs. */
function pairs({ h, pictures }, found) {
  const drawn = found.filter((r) => r.pictures.length);
  if (!drawn.length) return null;
  if (drawn.length === 1) {
    const root = h("div");
    pictures.show(root, drawn[0].pictures);
    return root;
  }
  const [first, second] = drawn;
  const rest = [...second.pictures];
  const root = h("div", { class: "wb-pictures" });
  const cell = (picture, model) => {
    const inside = h("div");
    if (picture) pictures.show(inside, [picture]);
    return h("div", { class: "wb-cell" }, picture ? h("b", { class: "wb-cell-name" }, NAMES[model]) : null, inside);
  };
  const head = h("div", { class: "wb-two wb-two-head", "aria-hidden": "true" }, h("b", null, NAMES[first.model]), h("b", null, NAMES[second.model]));
  const [shared, apart] = [[], []];
  for (const picture of first.pictures) {
    const at = rest.findIndex((other) => other.title === picture.title);
    const other = at < 0 ? null : rest.splice(at, 1)[0];
    if (other && other.content === picture.content) shared.push(picture);
    else apart.push([picture, other]);
  }
  for (const other of rest) apart.push([null, other]);
  if (shared.length) {
    const both = h("div");
    pictures.show(both, shared);
    root.append(both);
  }
  const isWide = ([a, b]) => (a ?? b).wide;
  const two = (pair) => h("div", { class: `wb-two${isWide(pair) ? " wide" : ""}` }, cell(pair[0], first.model), cell(pair[1], second.model));
  root.append(...apart.filter(isWide).map(two), head, ...apart.filter((pair) => !isWide(pair)).map(two));
  return root;
}

/** Shows an estimate's results. */
export function showEstimate(root, context, job) {
  const { h, fill, format, units } = context;
  const sections = bySection(job.results);
  fill(root, sections.map((found) => {
    const several = sections.length > 1;
    const below = several ? "h4" : "h3";
    return h("section", { class: "wb-section" },
      several ? h("h3", null, sentence(found[0].section || "the whole record").slice(0, -1)) : null,
      h("div", { class: "wb-said" }, h("div", null, words(h, found)), h("div", null, numbers(h, format, found, units))),
      found.filter((r) => r.document).map((r) => solverTable(context, r.document, found.length > 1 ? NAMES[r.model] : null)),
      h(below, null, "Pictures"),
      found.some((r) => r.pictures.length) ? pairs(context, found) : h("p", { class: "soft" }, job.state === "running" ? "The pictures are being drawn." : "There are none: nothing was fitted."),
      found.map((r) => r.text && h("details", null, h("summary", null, `As the command prints it${found.length > 1 ? `, ${NAMES[r.model].toLowerCase()}` : ""}`), h("pre", { tabindex: "0" }, r.text))));
  }), ways(context, job, job.results));
}
