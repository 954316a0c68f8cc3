// Starts the page: theme, clock, link to the daemon, and the view for the address.

import * as api from "./api.js";
import * as charts from "./charts.js";
import * as dialog from "./dialog.js";
import * as dom from "./dom.js";
import * as format from "./format.js";
import * as pictures from "./pictures.js";
import { Live } from "./live.js";
import { on, store, take, tell } from "./store.js";
import { strip } from "./strip.js";
import { themeButton } from "./theme-button.js";

const { fill, h } = dom;
const view = document.getElementById("view");
const nav = document.getElementById("nav");
const saidAt = document.getElementById("announce");

/** Announces a text to screen readers. */
function announce(words) {
  fill(saidAt, words);
}

const live = new Live({ onEvent: take, onState: (link, before) => {
  tell("link", link);
  // After an interruption everything on display may be outdated.
  if (before === "lost" && link.state === "live") tell("back");
} });
const context = { api, charts, dialog, dom, format, pictures, announce, live, store };

const ROUTES = [
  { path: /^$/, at: "", name: "Overview", module: "./overview.js", live: true },
  { path: /^alarms$/, at: "alarms", name: "Alarms", module: "./alarms.js", live: true },
  { path: /^maintenance$/, at: "maintenance", name: "Maintenance", short: ["Maint", "enance"], module: "./maintenance.js", live: true },
  { path: /^(?:groups|plant)$/, at: "groups", name: "Plant", module: "./groups.js", live: true },
  { path: /^(?:obstacles|data)$/, at: "obstacles", name: "Data", module: "./obstacles.js", live: true },
  { path: /^loop\/(.+)$/, name: "Loop", module: "./loop.js", live: true },
  { path: /^workbench(?:\/.*)?$/, at: "workbench", name: "Workbench", short: ["Work", "bench"], bench: { module: "./workbench.js", style: "workbench.css" }, module: "./workbench-link.js" },
];

let shown = null;
let turn = 0;
let drawn = null;
let siteKind = "daemon";

const isBench = () => store.site?.kind === "workbench";
const place = () => location.hash.replace(/^#\/?/, "").split("?")[0];

/** Redraws the links only if something changed, since the focused link must not be replaced every second. */
function drawNav(path) {
  const waiting = [...store.rows.values()].filter((row) => row.unacknowledged).length;
  const key = JSON.stringify([path, waiting, store.site?.kind]);
  if (key === drawn) return;
  drawn = key;
  const links = ROUTES.filter((r) => r.at !== undefined && !(isBench() && r.live));
  // Keep the focus on the same link.
  const held = nav.contains(document.activeElement) ? document.activeElement.getAttribute("href") : null;
  fill(nav, links.map((r) => h("a", { href: `#/${r.at}`, "aria-current": r.path.test(path) ? "page" : null }, label(r), r.at === "alarms" ? alarmCount(waiting) : null)));
  if (held) nav.querySelector(`a[href="${held}"]`)?.focus();
}

/** A link's name; its second part is hidden on narrow screens. */
const label = ({ name, short }) => (short ? h("span", null, short[0], h("span", { class: "rest" }, short[1])) : name);

function alarmCount(n) {
  return n ? h("span", { class: "count", title: "unacknowledged" }, String(n), h("span", { class: "unseen" }, " unacknowledged")) : null;
}

function addStyle(file) {
  if (document.querySelector(`link[href="${file}"]`)) return;
  document.head.append(h("link", { rel: "stylesheet", href: file }));
}

async function show() {
  if (isBench() && !place().startsWith("workbench")) {
    location.replace("#/workbench");
    return;
  }
  const path = place();
  const found = ROUTES.find((r) => r.path.test(path));
  const mine = ++turn;
  shown?.();
  shown = null;
  drawNav(path);
  const root = h("div", { class: "view" });
  fill(view, root);
  scrollTo(0, 0);
  if (!found) {
    fill(root, h("h1", null, "Page not found"), h("p", null, h("a", { href: "#/" }, "Back to the overview")));
    return;
  }
  document.title = `${found.name} · stictiond`;
  fill(root, dom.skeleton(6));
  // A daemon opens no files: its page says where they can be opened.
  const part = (isBench() && found.bench) || found;
  if (part.style) addStyle(part.style);
  try {
    const module = await import(part.module);
    if (mine !== turn) return;
    fill(root);
    const name = found.path.exec(path)[1];
    shown = module.show(root, { ...context, site: store.site, name: name === undefined ? null : decodeURIComponent(name) });
    if (found.live && name === undefined) live.open(null);
  } catch (error) {
    console.error(error);
    fill(root, dom.problem(`This part of the page could not be opened: ${error.message}`, show));
  }
  if (turn > 1) view.focus({ preventScroll: true });
}

function clock() {
  const now = Date.now() + (store.skew_ms ?? 0);
  fill(document.getElementById("clock"), format.time(now), " ", h("span", { class: "soft" }, format.zoneName(now)));
}

function takeSite(site) {
  const kind = siteKind;
  siteKind = site.kind;
  store.site = site;
  store.skew_ms = site.now_ms - Date.now();
  format.setZone(site.time_zone);
  fill(document.getElementById("site-name"), site.kind === "workbench" ? "workbench" : site.prefix);
  document.body.classList.toggle("bench", site.kind === "workbench");
  clock();
  drawNav(place());
  if (kind !== site.kind && turn) show();
}

async function start() {
  themeButton(document.getElementById("theme"), () => tell("theme"));
  strip(document.getElementById("strip"), live);
  on("site", takeSite);
  on("link", (link) => link.state === "lost" && !store.site && api.get("/site").then((site) => tell("site", site), () => {}));
  on("rows", () => drawNav(place()));
  on("alarm", (alarm) => alarm.event !== "restored" && announce(`Alarm of ${alarm.loop}: ${alarm.event.replaceAll("_", " ")}`));
  document.querySelector(".skip").addEventListener("click", (e) => {
    e.preventDefault();
    view.focus();
  });
  addEventListener("hashchange", show);
  addEventListener("keydown", (e) => {
    if (e.key !== "/" || e.ctrlKey || e.metaKey || e.altKey || e.target.closest("input, textarea, select, dialog")) return;
    const search = view.querySelector("input[type=search]");
    if (!search) return;
    e.preventDefault();
    search.focus();
    search.select();
  });
  setInterval(clock, 1000);
  try {
    takeSite(await api.get("/site"));
  } catch {
    // The strip shows that there is no link, and the stream sends the site once there is one.
  }
  if (!isBench()) live.open(null);
  show();
}

start();
