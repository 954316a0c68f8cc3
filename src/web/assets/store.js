// The page's data: the site, a row per loop, and listeners to changes.

const listeners = new Map();

export const store = {
  site: null,
  /** The daemon's sentences about the plant. */
  headline: null,
  /** Rows by name. */
  rows: new Map(),
  /** Whether a full set of rows has come since the page was opened. */
  loaded: false,
};

/** Hears of `site`, `rows` (a set of changed names, or null for all), `gone` (a set of names), `alarm`, `groups` (loops were compared), `samples`, `estimate`, `gap` (another diagnosis of the loop), `link`, `back` (the link, after it was lost), `theme`. */
export function on(name, listener) {
  if (!listeners.has(name)) listeners.set(name, new Set());
  listeners.get(name).add(listener);
  return () => listeners.get(name).delete(listener);
}

export function tell(name, what) {
  for (const listener of [...(listeners.get(name) ?? [])]) listener(what);
}

/** Processes a message of the stream. */
export function take(name, data) {
  if (name === "site") {
    store.site = data;
    tell("site", data);
  } else if (name === "loops") {
    takeRows(data);
  } else {
    tell(name, data);
  }
}

function takeRows({ loops, gone = [], full = false, headline = null }) {
  store.headline = headline ?? store.headline;
  if (full) store.rows = new Map();
  let fresh = false;
  for (const row of loops) {
    fresh ||= !store.rows.has(row.name);
    row.taken_ms = Date.now();
    store.rows.set(row.name, row);
  }
  for (const name of gone) store.rows.delete(name);
  if (gone.length) tell("gone", new Set(gone));
  const first = !store.loaded;
  store.loaded = true;
  tell("rows", full || first || fresh || gone.length ? null : new Set(loops.map((row) => row.name)));
}
