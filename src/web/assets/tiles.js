// The tiles: every loop has its place in the list from the start; what is inside is made when it comes near the screen.

import { fill, h } from "./dom.js";
import * as format from "./format.js";
import { spark } from "./spark.js";
import { NE107, neOf, opUnit, symbol } from "./words.js";

const TREND = { rising: "↗", falling: "↘", steady: "→" };

function numbers(row) {
  if (row.p_stiction === null) return h("span", { class: "soft" }, row.gates.length ? "no numbers from this window" : " ");
  const s = row.s === null ? null : h("span", null, h("i", null, "s"), ` ${format.estimate(row.s, row.s_interval, opUnit(row))}`);
  return [h("span", null, h("i", null, "p"), ` ${format.probability(row.p_stiction)}`), s];
}

function inside(row) {
  const key = neOf(row);
  const age = row.data_age_s;
  return [
    h("span", { class: "tile-head" }, symbol(key), h("b", { class: "tile-name" }, row.name),
      row.unacknowledged ? h("span", { class: "flag" }, "unack") : null,
      row.grade ? h("span", { class: "grade", title: `grade ${row.grade}` }, row.grade, h("span", { class: "unseen" }, " grade")) : null),
    h("span", { class: "tile-words", title: row.status }, h("span", { class: "unseen" }, `${NE107[key].name}: `), row.status),
    h("span", { class: "tile-numbers" }, numbers(row)),
    h("span", { class: "tile-foot" }, spark(row.recent ?? []),
      row.s_trend ? h("span", { class: `trend ${row.s_trend}`, title: `s is ${row.s_trend}` }, TREND[row.s_trend], h("span", { class: "unseen" }, ` s ${row.s_trend}`)) : null,
      h("span", { class: `age${age !== null && age > 60 ? " old" : ""}` }, age === null ? "no data" : `${format.duration(Math.max(0, age))} old`)),
  ];
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
    root.addEventListener("keydown", (e) => this.key(e));
    root.addEventListener("focusin", (e) => this.keep(e.target.closest("a.tile")));
  }

  tile(name) {
    let tile = this.byName.get(name);
    if (tile) return tile;
    const a = h("a", { class: "tile", href: `#/loop/${encodeURIComponent(name)}`, tabindex: "-1" }, h("b", { class: "tile-name" }, name));
    tile = { name, a, li: h("li", null, a), near: false, drawn: null };
    tile.li.tile = tile;
    this.byName.set(name, tile);
    return tile;
  }

  seen(entries) {
    for (const { target, isIntersecting } of entries) {
      target.tile.near = isIntersecting;
      if (isIntersecting) this.draw(target.tile);
    }
  }

  draw(tile) {
    const row = this.rows().get(tile.name);
    if (!row || tile.drawn === row) return;
    tile.drawn = row;
    tile.a.className = `tile is-${neOf(row)}`;
    fill(tile.a, inside(row));
  }

  /** Draws the changed ones again that are near the screen; the others follow when they come near. */
  patch(names) {
    for (const name of names) {
      const tile = this.byName.get(name);
      if (tile?.near) this.draw(tile);
    }
  }

  /** Puts the tiles in order: groups `{ title, names, note }`, without a title for one plain list. */
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
      const list = h("ul", { class: "tiles" }, g.names.map((n) => this.tile(n).li));
      if (g.title === null) return list;
      this.notes[k] = h("span", { class: "soft" }, g.note);
      return h("section", { class: "area", "aria-labelledby": `area-${k}` }, h("h2", { id: `area-${k}` }, g.title, " ", this.notes[k]), list);
    });
    fill(this.root, sections);
    const shown = groups.flatMap((g) => g.names);
    for (const n of shown) this.watch.observe(this.byName.get(n).li);
    this.keep(this.byName.get(shown.includes(this.here) ? this.here : shown[0])?.a);
    if (name && shown.includes(name)) this.byName.get(name).a.focus({ preventScroll: true });
  }

  /** One tile takes part in the order of Tab; arrows reach the others. */
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
  }
}

// The tile under (or over) this one: the first on another line whose left edge is not left of it.
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
