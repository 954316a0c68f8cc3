// The tiles. Every loop has its place in the list from the start; the contents are created when they come near the screen.
// Tiles are grouped in blocks, so that the browser watches and skips a hundred blocks instead of thousands of tiles.

import { fill, h } from "./dom.js";
import * as format from "./format.js";
import { spark } from "./spark.js";
import { NE107, neOf, symbol } from "./words.js";

/** Tiles in a block; divisible by every number of columns up to six. */
const BLOCK = 60;
/** Height, least width and spacing of tiles, px, as in the style sheet; a line is as wide as the list. */
const SIZES = { tiles: { height: 152, space: 8, least: 238 }, lines: { height: 34, space: 2, least: Infinity } };

const TREND = { rising: "↗", falling: "↘", steady: "→" };

function numbers(row) {
  if (!row.probability) return h("span", { class: "soft" }, " ");
  return [h("span", null, row.probability), row.size ? h("span", null, h("i", null, "s"), ` ${row.size}`) : null];
}

// A follower's cause is more informative than its own verdict.
const wordsOf = (row) => (row.driven ? `${row.driven}; ${row.status}` : row.status);

function inside(row) {
  const key = neOf(row);
  const seen = { "aria-hidden": "true" };
  return [
    h("span", { class: "unseen" }, spoken(row)),
    h("span", { class: "tile-head", ...seen }, symbol(key), h("b", { class: "tile-name" }, row.name),
      row.unacknowledged ? h("span", { class: "flag" }, "unack") : null,
      row.verdict ? h("span", { class: "grade", title: row.grade ? `grade ${row.grade}: how well the finding is supported` : "not graded: only a finding of stiction is" }, row.grade ?? "–") : null),
    h("span", { class: "tile-words", title: wordsOf(row), ...seen }, wordsOf(row)),
    h("span", { class: "tile-numbers", ...seen }, numbers(row)),
    h("span", { class: "tile-foot", ...seen }, row.recent?.length > 1 ? [h("span", { title: "probability that the valve sticks over the last windows, 0 to 1" }, "p"), spark(row.recent)] : null,
      row.s_trend && row.stiction ? h("span", { class: `trend ${row.s_trend}`, title: `s is ${row.s_trend}` }, TREND[row.s_trend]) : null,
      h("span", { class: `age${row.silent ? " old" : ""}` }, ageWords(row))),
  ];
}

// A silent loop's row is not sent again, so its age is advanced here.
function ageWords(row) {
  if (row.data_age_s === null) return "no data";
  const age = row.data_age_s + (row.silent ? (Date.now() - row.taken_ms) / 1000 : 0);
  return age < 0 ? "live" : `${format.duration(Math.max(1, Math.ceil(age)))} old`;
}

// Text of a tile for screen readers, with pauses where there are lines.
function spoken(row) {
  const parts = [row.name, NE107[neOf(row)].name, wordsOf(row)];
  if (row.unacknowledged) parts.push("alarm unacknowledged");
  if (row.stale) parts.push("an old answer");
  if (row.probability) parts.push(`stiction ${row.probability}`);
  if (row.size) parts.push(`s ${row.size}${row.s_trend ? `, ${row.s_trend}` : ""}`);
  if (row.grade) parts.push(`grade ${row.grade}`);
  return parts.join(", ");
}

/** The lists of tiles below `root`. */
export class Tiles {
  constructor(root, rows) {
    this.root = root;
    this.rows = rows;
    this.byName = new Map();
    this.order = "";
    this.here = null;
    this.watch = new IntersectionObserver((entries) => this.seen(entries), { rootMargin: "500px 0px" });
    this.size = new ResizeObserver(() => this.measure());
    this.size.observe(root);
    root.addEventListener("keydown", (e) => this.key(e));
    root.addEventListener("focusin", (e) => this.keep(e.target.closest("a.tile")));
  }

  tile(name) {
    let tile = this.byName.get(name);
    if (tile) return tile;
    const a = h("a", { class: "tile", href: `#/loop/${encodeURIComponent(name)}`, tabindex: "-1" }, h("b", { class: "tile-name" }, name));
    tile = { name, a, li: h("li", null, a), drawn: null };
    tile.li.tile = tile;
    this.byName.set(name, tile);
    return tile;
  }

  seen(entries) {
    for (const { target, isIntersecting } of entries) {
      target.near = isIntersecting;
      if (isIntersecting) for (const li of target.children) this.draw(li.tile);
    }
  }

  draw(tile) {
    const row = this.rows().get(tile.name);
    if (!row || tile.drawn === row) return;
    tile.drawn = row;
    tile.a.className = `tile is-${neOf(row)}${row.stale ? " old-answer" : ""}`;
    fill(tile.a, inside(row));
  }

  /** Redraws the changed tiles near the screen; the others follow when they come near. */
  patch(names) {
    for (const name of names) {
      const tile = this.byName.get(name);
      if (tile?.li.parentElement?.near) this.draw(tile);
    }
  }

  /** Sorts the tiles into groups `{ title, names, note }`; a single plain list has no title. */
  arrange(groups) {
    const order = groups.map((g) => `${g.title}\n${g.names.join("\n")}`).join("\n\n");
    if (order === this.order) {
      groups.forEach((g, k) => g.note && this.notes?.[k] && fill(this.notes[k], g.note));
      return;
    }
    this.order = order;
    const focused = document.activeElement?.closest?.("a.tile");
    const name = focused && this.root.contains(focused) ? focused.parentElement.tile.name : null;
    this.watch.disconnect();
    this.notes = [];
    const sections = groups.map((g, k) => {
      const lists = this.blocks(g.names);
      if (g.title === null) return lists;
      this.notes[k] = h("span", { class: "soft" }, g.note);
      return h("section", { class: "area", "aria-labelledby": `area-${k}` }, h("h2", { id: `area-${k}` }, g.title, " ", this.notes[k]), lists);
    });
    fill(this.root, sections);
    const shown = groups.flatMap((g) => g.names);
    this.measure();
    for (const list of this.root.querySelectorAll("ul")) this.watch.observe(list);
    this.keep(this.byName.get(shown.includes(this.here) ? this.here : shown[0])?.a);
    if (name && shown.includes(name)) this.byName.get(name).a.focus({ preventScroll: true });
  }

  blocks(names) {
    const lists = [];
    for (let k = 0; k < names.length; k += BLOCK) lists.push(h("ul", { class: "tiles" }, names.slice(k, k + BLOCK).map((n) => this.tile(n).li)));
    return lists;
  }

  /** Tells the browser the height of each block, so that it can skip those that are not visible. */
  measure() {
    const { height, space, least } = SIZES[this.root.classList.contains("lines") ? "lines" : "tiles"];
    const columns = Math.max(1, Math.floor((this.root.clientWidth + space) / (least + space)));
    for (const list of this.root.querySelectorAll("ul")) {
      list.style.containIntrinsicSize = `auto ${Math.ceil(list.children.length / columns) * (height + space) - space}px`;
    }
  }

  /** Only one tile is in the Tab order; arrows reach the others. */
  keep(a) {
    if (!a) return;
    const before = this.byName.get(this.here)?.a;
    if (before && before !== a) before.tabIndex = -1;
    a.tabIndex = 0;
    this.here = a.parentElement.tile.name;
  }

  key(e) {
    const a = e.target.closest("a.tile");
    if (!a || e.ctrlKey || e.metaKey || e.altKey) return;
    const all = [...this.root.querySelectorAll("a.tile")];
    const at = all.indexOf(a);
    const to = { ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: all.length - 1 }[e.key] ?? (e.key === "ArrowDown" ? below(all, at, 1) : e.key === "ArrowUp" ? below(all, at, -1) : null);
    if (to === null || !all[to]) return;
    e.preventDefault();
    all[to].focus();
    all[to].scrollIntoView({ block: "nearest" });
  }

  destroy() {
    this.watch.disconnect();
    this.size.disconnect();
  }
}

// The tile below (or above) this one: the first on another line with its left edge not to the left of it.
function below(all, at, step) {
  const from = all[at].getBoundingClientRect();
  let best = null;
  let line = null;
  for (let k = at + step; all[k]; k += step) {
    const box = all[k].getBoundingClientRect();
    if (Math.abs(box.top - from.top) < 4) continue;
    if (line !== null && Math.abs(box.top - line) > 4) break;
    line ??= box.top;
    const far = Math.abs(box.left - from.left);
    if (!best || far < best.far) best = { far, k };
  }
  return best?.k ?? null;
}
