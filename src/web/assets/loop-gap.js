// The gap report: where the model departs from the plant, which effect causes it, how far it closes the gap, what to test next.

import { runGap } from "./actions.js";
import { figureCell, fill, h, problem } from "./dom.js";
import * as format from "./format.js";
import { store } from "./store.js";
import { plain } from "./words.js";

const MOST_EFFECTS = 6;
const STAGES = { valve: "in the valve", process: "in the process", disturbance: "external disturbance", measurement: "in the measurement", operation: "in the operation of the loop", cannot_tell: "unknown", none: "none" };

/** Switches of an effect, which are not meaningful as numbers. */
const SWITCHES = new Set(["straight", "upper", "of_stem"]);

const item = (term, value) => h("div", null, h("dt", null, term), h("dd", null, value));

function causeWords({ cause, good_enough: enough }) {
  if (enough) return `the model is good enough: it leaves ${format.number(enough.left_pct)} % of PV’s movement, below ${enough.is_noise ? "the noise" : `${format.number(enough.limit_pct)} %`}`;
  if (cause.id === "none") return `no effect needed (p ${format.probability(cause.probability)})`;
  if (cause.id === "unknown" && cause.why === "cannot_be_told") return "this record cannot tell it";
  if (cause.id === "unknown") return `no effect of the catalogue explains it (p ${format.probability(cause.probability)})`;
  return `${plain(cause.id)} (p ${format.probability(cause.probability)}${cause.confirmed ? ", confirmed on other data" : ", suspected"})`;
}

function test(next) {
  if (!next) return null;
  return item("Next test", `move ${next.signal.toUpperCase()} by ${format.number(next.size)} for ${format.duration(next.duration_s)}, distinguishes ${[next.separates].flat().map(plain).join(" from ")} (p ${format.probability(next.p)})${next.total_s ? `; costs ${format.duration(next.total_s)} in manual, PV moves by about ${format.number(next.moves_pv)}` : ""}`);
}

function effects(list, pv, asks) {
  const shown = list.slice(0, MOST_EFFECTS);
  if (!shown.length) return null;
  const size = (e) => Object.entries(e.parameters).filter(([name]) => !SWITCHES.has(name)).map(([name, p]) => `${plain(name)} ${format.number(p.value)}${p.unit === "1" ? "" : ` ${p.unit}`}`).join(", ").replace(/.$/, "$&; ");
  return h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Effects tried" }, h("table", { class: "table" },
    h("caption", { class: "soft" }, `The likeliest ${shown.length} of ${format.count(list.length, "effect")}; share of the gap that each closes on held-out data.`),
    h("thead", null, h("tr", null, h("th", { scope: "col" }, "effect"), h("th", { scope: "col" }, "acts"), h("th", { scope: "col", class: "number" }, "closes, %"), h("th", { scope: "col", class: "number" }, `gap left, ${pv}`))),
    h("tbody", null, shown.map((e) => h("tr", null, h("th", { scope: "row" }, e.own_cycle ? "the valve’s own cycle" : plain(e.id), h("small", { class: "soft asks" }, size(e), asks && e.separated_by ? `distinguished by ${e.separated_by}` : "")), h("td", { class: "nowrap" }, STAGES[e.stage] ?? e.stage), figureCell(format.parts(e.closed_pct, e.closed_interval)), h("td", { class: "number" }, format.number(e.gap_after)))))));
}

/** The shares of PV's variance, and the limits of that table. */
function madeOf({ budget, tellable }, pv) {
  const table = budget && h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "What PV is made of" }, h("table", { class: "table" },
    h("caption", { class: "soft" }, `What PV is made of: ${budget.head}.`),
    h("thead", null, h("tr", null, h("th", { scope: "col", class: "number" }, "share, %"), h("th", { scope: "col", class: "number" }, `deviation, ${pv}`), h("th", { scope: "col" }, "part"))),
    h("tbody", null, budget.parts.map((p) => h("tr", null, h("td", { class: "number" }, format.number(p.share_pct)), h("td", { class: "number" }, format.number(p.sd)), h("td", null, p.words))))));
  return [table, [...(budget?.limits ?? []), ...(tellable ?? [])].map((text) => h("p", { class: "note" }, format.sentence(text)))];
}

function report(gap, words, row) {
  const pv = row.pv_unit ?? "PV units";
  const g = gap.gap;
  return [
    words.gap ? h("p", { class: "lead" }, format.sentence(words.gap)) : null,
    h("dl", { class: "facts" },
      item("Where", STAGES[gap.where.stage] ?? plain(gap.where.stage)),
      item("Which", causeWords(gap)),
      gap.second_cause ? item("Second cause", `${plain(gap.second_cause.id)} (p ${format.probability(gap.second_cause.probability)})`) : null,
      g ? item("Size of the gap", `${format.number(g.gap)} ${pv}, ${format.percent(g.relative)} of PV’s standard deviation; noise floor ${format.number(g.noise_floor)} ${pv}`) : null,
      gap.forward ? item("Forward prediction", `${format.number(gap.forward.gap_before)} before, ${format.number(gap.forward.gap_after)} ${pv} after`) : null,
      gap.from_sp ? item("Closed loop from SP", `predicts ${format.percent(Math.max(0, gap.from_sp.base_pct / 100))} of PV’s variance${gap.from_sp.after_pct == null ? "" : `, with the cause ${format.percent(Math.max(0, gap.from_sp.after_pct / 100))}`}; PV = SP would predict ${format.percent(Math.max(0, gap.from_sp.sp_pct / 100))}`) : null,
      gap.alternatives?.length ? item("Else", gap.alternatives.slice(0, 3).map((a) => `${plain(a.id)} (p ${format.probability(a.probability)})`).join(", ")) : null,
      words.windows ? item("Windows", words.windows) : null,
      words.other_loops ? item("Other loops", words.other_loops) : null,
      test(gap.next_test),
      item("Section", `${format.recent(format.millis(gap.window.start))} to ${format.recent(format.millis(gap.window.end))}, base: ${gap.base.source === "linear" ? "a valve without friction" : "a sticking valve and a first-order process"}`)),
    effects(gap.effects ?? [], pv, !gap.good_enough),
    madeOf(words, pv),
  ];
}

/** Fills the section from every new document. */
export function gap(root, loop) {
  const body = h("div");
  const status = h("div", { class: "row", role: "status" });
  const button = h("button", { class: "button", type: "button", onclick: () => run(false) }, "Run the diagnosis");
  const together = h("button", { class: "button", type: "button", hidden: true, title: "Decides the cause from up to four earlier diagnoses, too", onclick: () => run(true) }, "Run with earlier windows");
  fill(root, body, h("div", { class: "row" }, button, together, status));
  button.hidden = store.site?.commands === false;

  async function run(pool) {
    let clock = null;
    try {
      const started = () => {
        const from = Date.now();
        const spent = h("span", { "aria-hidden": "true" });
        button.disabled = together.disabled = true;
        clock = setInterval(() => fill(spent, format.duration(Math.round((Date.now() - from) / 1000))), 500);
        fill(status, h("progress", { "aria-label": "Gap diagnosis" }), " fitting all effects of the catalogue … ", spent);
      };
      if (await runGap(loop.name, pool, started)) {
        await loop.reload(true);
        fill(status, "Done.");
      }
    } catch (error) {
      fill(status, problem(error.message));
    }
    clearInterval(clock);
    button.disabled = together.disabled = false;
  }

  loop.onDocument(({ gap: document, words, row, estimate }) => {
    if (document) fill(body, report(document, words ?? {}, row));
    else fill(body, h("p", { class: "note" }, estimate ? "No diagnosis yet. It shows where the model differs from the record, which effect causes the difference, and how much of the gap that effect closes." : "There is no window to diagnose yet."));
    fill(button, document ? "Run the diagnosis again" : "Run the diagnosis");
    button.hidden = !estimate || store.site?.commands === false;
    together.hidden = button.hidden || !document;
  });
}
