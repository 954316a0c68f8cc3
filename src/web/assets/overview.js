// Overview: whether anything is wrong, in which loops, and how certain it is.

import { fill, h, skeleton } from "./dom.js";
import * as format from "./format.js";
import { on, store } from "./store.js";
import { Tiles } from "./tiles.js";
import { NE107, VERDICTS, neOf, symbol, verdictOf } from "./words.js";

/** Pause between two sortings of the tiles while rows change, ms, so that tiles do not jump while being read. */
const CALM_MS = 4000;
/** Pause after loops have appeared or left, ms. */
const SOON_MS = 150;
/** Pause in typing after which the filter is applied, ms. */
const TYPING_MS = 100;
const NO_AREA = "No area";

const slope = (row) => {
  const known = (row.recent ?? []).map((w) => w.s).filter((s) => s !== null);
  if (known.length < 4) return row.s_trend === "rising" ? 1e-3 : -1;
  const third = Math.max(1, Math.floor(known.length / 3));
  const mean = (list) => list.reduce((a, b) => a + b, 0) / list.length;
  return mean(known.slice(-third)) / Math.max(1e-9, mean(known.slice(0, third))) - 1 + (row.s_trend === "rising" ? 1 : 0);
};

const order = new Intl.Collator("en", { numeric: true });
const byName = (a, b) => order.compare(a.name, b.name);
const SORTS = {
  severity: { label: "severity", of: (r) => -(r.urgency ?? 0) },
  confidence: { label: "confidence", of: (r) => -(r.stiction === null ? -1 : (r.confidence ?? -1)) },
  trend: { label: "trend of s", of: (r) => -slope(r) },
  age: { label: "data age", of: (r) => -(r.data_age_s ?? Infinity) },
  name: { label: "name", of: () => 0 },
};

// Filters are kept in the address, for the Back button and bookmarks.
function readState() {
  const q = new URLSearchParams(location.hash.split("?")[1] ?? "");
  const list = (key) => new Set((q.get(key) ?? "").split(",").filter(Boolean));
  return { text: q.get("q") ?? "", ne: list("ne"), verdicts: list("verdict"), area: q.get("area") ?? "", sort: SORTS[q.get("sort")] ? q.get("sort") : "severity", flat: q.get("flat") === "1", lines: q.get("lines") === "1" };
}

function writeState(s) {
  // The user may have followed a link during the pause after the last letter.
  if (!/^(#(\/(\?.*)?)?)?$/.test(location.hash)) return;
  const q = new URLSearchParams();
  if (s.text) q.set("q", s.text);
  if (s.ne.size) q.set("ne", [...s.ne].join(","));
  if (s.verdicts.size) q.set("verdict", [...s.verdicts].join(","));
  if (s.area) q.set("area", s.area);
  if (s.sort !== "severity") q.set("sort", s.sort);
  if (s.flat) q.set("flat", "1");
  if (s.lines) q.set("lines", "1");
  history.replaceState(null, "", `#/${q.size ? `?${q}` : ""}`);
}

const matches = (row, s) =>
  (!s.ne.size || s.ne.has(neOf(row))) &&
  (!s.verdicts.size || s.verdicts.has(verdictOf(row))) &&
  (!s.area || (row.area ?? NO_AREA) === s.area) &&
  (!s.text || `${row.name} ${row.equipment ?? ""} ${row.area ?? ""} ${row.status}`.toLowerCase().includes(s.text.toLowerCase()));

function grouped(rows, s) {
  const key = SORTS[s.sort].of;
  const keyed = rows.map((row) => ({ row, key: key(row) })).sort((a, b) => a.key - b.key || byName(a.row, b.row));
  const names = (list) => list.map((k) => k.row.name);
  const areas = new Map();
  for (const k of keyed) {
    const area = k.row.area ?? NO_AREA;
    if (!areas.has(area)) areas.set(area, []);
    areas.get(area).push(k);
  }
  if (s.flat || (areas.size === 1 && areas.has(NO_AREA))) return [{ title: null, names: names(keyed) }];
  // The area of the first loop comes first.
  const groups = [...areas].map(([title, list]) => ({ title, first: list[0].key, names: names(list), note: noteOf(list.map((k) => k.row)) }));
  return groups.sort((a, b) => a.first - b.first || order.compare(a.title, b.title));
}

function noteOf(rows) {
  const need = rows.filter((r) => neOf(r) === "M").length;
  return `${format.count(rows.length, "loop")}${need ? `, ${need} to maintain` : ""}`;
}

// What to do if no data have come yet.
function waiting() {
  const prefix = store.site?.prefix ?? "PREFIX";
  return h("div", { class: "note" },
    h("p", null, "A loop appears with its first sample. Publish each signal on its own Zenoh key:"),
    h("p", null, h("code", null, `${prefix}/LOOP/op`), " and ", h("code", null, `${prefix}/LOOP/pv`), "; set point and mode are optional (", h("code", null, "sp"), ", ", h("code", null, "mode"), "). Other keys are mapped in the configuration."));
}

class Overview {
  constructor(root) {
    this.root = root;
    this.state = readState();
    this.build();
    this.tiles = new Tiles(this.list, () => store.rows);
    this.off = [on("rows", (names) => this.rows(names)), on("site", () => this.draw())];
    this.draw(true);
  }

  build() {
    const s = this.state;
    this.head = h("div", { class: "headline-box" });
    this.neRow = h("div", { class: "chips", role: "group", tabindex: "0", "aria-label": "Filter by status, NAMUR NE 107" });
    this.verdictRow = h("div", { class: "chips", role: "group", tabindex: "0", "aria-label": "Filter by verdict" });
    this.areas = h("select", { id: "area", onchange: (e) => this.set({ area: e.target.value }) });
    this.result = h("span", { class: "soft", role: "status" });
    const search = h("input", { id: "find", type: "search", value: s.text, placeholder: "name, area, words", oninput: (e) => this.typed(e.target.value.trim()), onkeydown: (e) => e.key === "ArrowDown" && this.list.querySelector("a.tile[tabindex='0']")?.focus() });
    const sorts = h("select", { id: "sort", onchange: (e) => this.set({ sort: e.target.value }) }, Object.entries(SORTS).map(([value, { label }]) => h("option", { value, selected: value === s.sort }, label)));
    const flat = h("input", { type: "checkbox", checked: !s.flat, onchange: (e) => this.set({ flat: !e.target.checked }) });
    const lines = h("input", { type: "checkbox", checked: s.lines, onchange: (e) => this.set({ lines: e.target.checked }) });
    const clear = h("button", { class: "button quiet", type: "button", onclick: () => { search.value = ""; this.areas.value = ""; this.set({ text: "", ne: new Set(), verdicts: new Set(), area: "" }); } }, "Clear filters");
    this.clear = clear;
    this.list = h("div", { class: "tile-list" });
    fill(this.root, this.head,
      h("section", { class: "filters", "aria-label": "Filter and order" },
        this.neRow, this.verdictRow,
        h("div", { class: "row" },
          h("label", { class: "inline", for: "find" }, "Find ", search, h("kbd", null, "/")),
          h("label", { class: "inline", for: "area" }, "Area ", this.areas),
          h("label", { class: "inline", for: "sort" }, "Sort by ", sorts),
          h("label", { class: "inline" }, flat, " group by area"), h("label", { class: "inline" }, lines, " as lines"), clear, this.result)),
      this.list);
  }

  set(change) {
    Object.assign(this.state, change);
    writeState(this.state);
    this.draw(true);
  }

  /** Thousands of tiles are sorted once a word is typed, not at every letter. */
  typed(text) {
    clearTimeout(this.typing);
    this.typing = setTimeout(() => this.set({ text }), TYPING_MS);
  }

  flip(key, value) {
    const set = new Set(this.state[key]);
    if (!set.delete(value)) set.add(value);
    this.set({ [key]: set });
  }

  rows(names) {
    this.tiles.patch(names ?? store.rows.keys());
    if (names !== null || !this.tiles.order) return this.draw(names === null);
    // Loops have appeared or left. Many rows come in parts: wait for the last one.
    clearTimeout(this.soon);
    this.soon = setTimeout(() => this.draw(true), SOON_MS);
    return undefined;
  }

  /** Draws; tiles are sorted at once if asked, else after a pause. */
  draw(now = false) {
    if (!store.loaded) {
      fill(this.head, skeleton(2));
      fill(this.list, skeleton(8));
      this.bones = true;
      return;
    }
    if (this.bones) fill(this.list);
    this.bones = false;
    const rows = [...store.rows.values()];
    this.drawHead();
    this.drawChips(rows);
    this.drawAreas(rows);
    if (now) this.arrange();
    else this.later ??= setTimeout(() => this.arrange(), CALM_MS);
  }

  arrange() {
    clearTimeout(this.later);
    this.later = null;
    this.list.classList.toggle("lines", this.state.lines);
    this.tiles.measure();
    const rows = [...store.rows.values()];
    const kept = rows.filter((row) => matches(row, this.state));
    this.tiles.arrange(kept.length ? grouped(kept, this.state) : []);
    if (!rows.length) fill(this.list, waiting());
    else if (!kept.length) fill(this.list, h("p", { class: "note" }, "No loop matches these filters."));
    if (!kept.length) this.tiles.order = "";
    const filtered = kept.length !== rows.length;
    fill(this.result, filtered ? `${kept.length} of ${format.count(rows.length, "loop")}` : format.count(rows.length, "loop"));
    this.clear.hidden = !filtered;
  }

  drawHead() {
    const said = store.headline;
    const key = JSON.stringify(said);
    if (!said || key === this.said) return;
    this.said = key;
    const { mood, words, first, more } = said;
    const open = first && h("a", { class: "button primary", href: `#/loop/${encodeURIComponent(first)}` }, `Look at ${first}`);
    fill(this.head, h("div", { class: `headline ${mood}` }, h("h1", null, words), h("p", null, more[0] ?? ""), more.length > 1 ? h("p", null, more.slice(1).join(" ")) : null), open);
  }

  chip(key, set, node, label, n, title) {
    const pressed = set.has(key);
    return h("button", { class: "chip", type: "button", "data-key": key, "aria-pressed": String(pressed), title, disabled: !n && !pressed }, node, label, h("b", null, format.integer(n)));
  }

  drawChips(rows) {
    const counts = (of) => {
      const n = {};
      for (const row of rows) n[of(row)] = (n[of(row)] ?? 0) + 1;
      return n;
    };
    const ne = counts(neOf);
    const verdicts = counts(verdictOf);
    const key = JSON.stringify([ne, verdicts, [...this.state.ne], [...this.state.verdicts]]);
    if (key === this.chipped) return;
    this.chipped = key;
    const focus = document.activeElement?.dataset?.key;
    fill(this.neRow, Object.entries(NE107).map(([k, { name, says }]) => this.wire("ne", this.chip(k, this.state.ne, symbol(k, 16), name, ne[k] ?? 0, says))));
    fill(this.verdictRow, Object.entries(VERDICTS).filter(([k]) => k !== "none").map(([k, { short, words }]) => this.wire("verdicts", this.chip(k, this.state.verdicts, null, short, verdicts[k] ?? 0, words))));
    if (focus) this.root.querySelector(`.chip[data-key="${CSS.escape(focus)}"]`)?.focus();
  }

  wire(set, button) {
    button.addEventListener("click", () => this.flip(set, button.dataset.key));
    return button;
  }

  drawAreas(rows) {
    const names = [...new Set(rows.map((r) => r.area ?? NO_AREA))].sort((a, b) => order.compare(a, b));
    if (names.join("\n") === this.areaNames) return;
    this.areaNames = names.join("\n");
    this.areas.closest("label").hidden = names.length < 2;
    fill(this.areas, h("option", { value: "" }, "all"), names.map((n) => h("option", { value: n, selected: n === this.state.area }, n)));
  }

  destroy() {
    clearTimeout(this.later);
    clearTimeout(this.soon);
    clearTimeout(this.typing);
    this.off.forEach((off) => off());
    this.tiles.destroy();
  }
}

/** Shows the overview; returns a cleanup function. */
export function show(root) {
  const view = new Overview(root);
  return () => view.destroy();
}
