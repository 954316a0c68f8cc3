// Data view: the share of loops that can be judged, and the obstacles of the others.

import * as api from "./api.js";
import { line } from "./charts.js";
import { fill, h, loading } from "./dom.js";
import * as format from "./format.js";
import { on } from "./store.js";

/** Pause between two loads of the daemon's list while rows change, ms. */
const PAUSE_MS = 10000;

const KINDS = {
  silent: "silent",
  frozen: "frozen",
  swapped: "OP and PV swapped",
  misplaced: "signal of another loop",
  wrong_sign: "wrong sign",
  at_limit: "OP at a limit",
  manual: "in manual",
  too_slow: "sampled too slowly",
  compressed: "compressed",
  other: "other",
  waiting: "no window yet",
};

function row(obstacle) {
  return h("tr", { "data-kind": obstacle.kind },
    h("th", { scope: "row" }, obstacle.appeared ? h("a", { href: `#/loop/${encodeURIComponent(obstacle.loop)}` }, obstacle.loop) : obstacle.loop),
    h("td", { "data-label": "area" }, obstacle.area ?? "–"),
    h("td", { "data-label": "obstacle" }, KINDS[obstacle.kind] ?? obstacle.kind, obstacle.blocks ? null : h("b", { class: "under-words" }, "judged, but less surely")),
    h("td", { "data-label": "since" }, obstacle.since_ms === null ? "–" : format.recent(obstacle.since_ms)),
    h("td", { "data-label": "what is wrong" }, format.sentence(obstacle.words)),
    h("td", { "data-label": "what to do" }, format.sentence(obstacle.remedy)));
}

function table(obstacles) {
  const columns = ["loop", "area", "obstacle", "since", "what is wrong", "what to do"];
  return h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Obstacles" }, h("table", { class: "table stacked" },
    h("thead", null, h("tr", null, columns.map((words) => h("th", { scope: "col" }, words)))),
    h("tbody", null, obstacles.map(row))));
}

/** The chart of the share over time, with its numbers as a table; empty until there are two points. */
function shareOverTime(root) {
  let chart = null;
  return {
    draw(trend) {
      if (trend.length < 2) return;
      chart ??= line(root, { label: "Share of loops that can be judged", height: 120, least: 0, yLabel: "%", series: [{ key: "share", label: "can be judged", ink: "--op", unit: "%" }] });
      chart.setData({ x: trend.map((p) => p.t_ms), share: trend.map((p) => 100 * p.share) }, { keepView: true });
    },
    end: () => chart?.destroy(),
  };
}

/** Shows the list; returns a cleanup function. */
export function show(root) {
  const figure = h("p", { role: "status" });
  const list = h("div");
  const over = h("div");
  fill(root, h("h1", null, "Data"), h("p", { class: "soft" }, "What keeps loops from being judged."), figure, over, list);
  const chart = shareOverTime(over);
  const draw = ({ loops, judged, share, obstacles, trend }) => {
    chart.draw(trend);
    fill(figure, share === null ? "No loop has appeared yet." : [h("b", null, format.percent(share)), ` of all loops can be judged (${format.integer(judged)} of ${format.integer(loops)})`]);
    const held = list.contains(document.activeElement) ? document.activeElement.getAttribute("href") : null;
    fill(list, obstacles.length ? table(obstacles) : h("p", { class: "note" }, "Nothing keeps a loop from being judged."));
    if (held) list.querySelector(`a[href="${CSS.escape(held)}"]`)?.focus({ preventScroll: true });
  };
  const part = loading(list, () => api.get("/obstacles"), draw);
  part.run();
  let later = null;
  const soon = () => { later ??= setTimeout(() => { later = null; part.run(true); }, PAUSE_MS); };
  const ends = [on("rows", soon), on("back", () => part.run(true))];
  return () => {
    clearTimeout(later);
    [part.end, chart.end, ...ends].forEach((end) => end());
  };
}
