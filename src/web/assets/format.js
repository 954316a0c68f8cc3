// Numbers with their units and uncertainty, times in the plant's zone, durations.

let zone = "UTC";
let made = new Map();

/** Sets the plant's time zone; an unknown one falls back to UTC. */
export function setZone(name) {
  try {
    new Intl.DateTimeFormat("en-GB", { timeZone: name });
    zone = name;
  } catch {
    zone = "UTC";
  }
  made = new Map();
}

export const timeZone = () => zone;

const plain = new Intl.NumberFormat("en-GB", { maximumSignificantDigits: 3 });
const two = new Intl.NumberFormat("en-GB", { maximumSignificantDigits: 2 });
const whole = new Intl.NumberFormat("en-GB", { maximumFractionDigits: 0 });
const NONE = "–";

const missing = (v) => v === null || v === undefined || !Number.isFinite(v);

/** Three significant digits at most. */
export function number(v) {
  if (missing(v)) return NONE;
  const size = Math.abs(v);
  if (size !== 0 && (size < 1e-3 || size >= 1e7)) return v.toExponential(1).replace("e-", "e−").replace("e+", "e");
  return plain.format(v).replace("-", "−");
}

/** Two significant digits, as suits simulated values. */
export const rough = (v) => (missing(v) ? NONE : two.format(v).replace("-", "−"));

/** A measured value at a cursor, with enough digits to tell neighbours apart within `span`. */
export function reading(v, span) {
  if (missing(v)) return NONE;
  const digits = span > 0 ? Math.min(4, Math.max(0, 2 - Math.floor(Math.log10(span)))) : 3;
  return v.toFixed(digits).replace("-", "−");
}

// Decimals justified by an interval of this half width, with at most three significant digits of the value.
function decimals(v, half) {
  const size = Math.abs(v) || half || 1;
  const most = 2 - Math.floor(Math.log10(size));
  const deserved = half > 0 ? 1 - Math.floor(Math.log10(half)) : most;
  return Math.min(most, deserved);
}

function rounded(v, digits) {
  const at = digits < 0 ? 10 ** -digits : 1;
  const value = digits < 0 ? Math.round(v / at) * at : v;
  const keep = Math.min(12, Math.max(0, digits));
  const text = value.toLocaleString("en-GB", { minimumFractionDigits: keep, maximumFractionDigits: keep });
  return text.replace(/^-(0(\.0+)?)$/, "$1").replace("-", "−");
}

/** A number with its interval and unit: "5.5 (4.5 to 6.7) %". */
export function estimate(v, interval, unit) {
  const tail = unit ? ` ${unit}` : "";
  if (missing(v)) return NONE;
  if (!interval || missing(interval[0]) || missing(interval[1])) return number(v) + tail;
  const digits = decimals(Math.max(Math.abs(v), Math.abs(interval[1])), (interval[1] - interval[0]) / 2);
  return `${rounded(v, digits)} (${rounded(interval[0], digits)} to ${rounded(interval[1], digits)})${tail}`;
}

/** The same in two parts, for narrow tables: ["5.5", "4.5 to 6.7"]. */
export function parts(v, interval) {
  const text = estimate(v, interval, "");
  const at = text.indexOf(" (");
  return at < 0 ? [text, ""] : [text.slice(0, at), text.slice(at + 2, -1)];
}

/** Two digits; never 0 or 1, which would be certainty. */
export function probability(p) {
  if (missing(p)) return NONE;
  if (p > 0.99) return "> 0.99";
  if (p < 0.01) return "< 0.01";
  return p.toFixed(2);
}

/** A fraction of 1 as per cent. */
export const percent = (share) => (missing(share) ? NONE : `${whole.format(share * 100).replace("-", "−")} %`);

/** "1 loop", "48 loops". */
export const count = (n, word, many = `${word}s`) => `${whole.format(n)} ${n === 1 ? word : many}`;

export const integer = (n) => (missing(n) ? NONE : whole.format(n));

function shape(key, options) {
  if (!made.has(key)) made.set(key, new Intl.DateTimeFormat("en-GB", { timeZone: zone, ...options }));
  return made.get(key);
}

const CLOCK = { hour: "2-digit", minute: "2-digit", hourCycle: "h23" };

/** 12:03:10 */
export const time = (ms) => (missing(ms) ? NONE : shape("time", { ...CLOCK, second: "2-digit" }).format(ms));

/** 12:03 */
export const minute = (ms) => (missing(ms) ? NONE : shape("minute", CLOCK).format(ms));

/** 6 Jan 2026 */
export const day = (ms) => (missing(ms) ? NONE : shape("day", { day: "numeric", month: "short", year: "numeric" }).format(ms));

/** 6 Jan */
export const shortDay = (ms) => (missing(ms) ? NONE : shape("shortDay", { day: "numeric", month: "short" }).format(ms));

/** 6 Jan 2026, 12:03 */
export const dateTime = (ms) => (missing(ms) ? NONE : `${day(ms)}, ${minute(ms)}`);

/** 12:03 today, else 6 Jan, 12:03. */
export function recent(ms, now = Date.now()) {
  if (missing(ms)) return NONE;
  return day(ms) === day(now) ? minute(ms) : `${shortDay(ms)}, ${minute(ms)}`;
}

/** 12:03:10 today, else 6 Jan, 12:03:10. */
export const stamp = (ms) => (day(ms) === day(Date.now()) ? time(ms) : `${shortDay(ms)}, ${time(ms)}`);

/** A time for a date-and-time field, in the plant's zone: 2026-01-06T12:03. */
export const field = (ms) => new Intl.DateTimeFormat("sv-SE", { timeZone: zone, dateStyle: "short", timeStyle: "short" }).format(ms).replace(" ", "T");

/** The time of such a field, ms since 1970. */
export function ofField(text) {
  const wanted = Date.parse(`${text}Z`);
  let ms = wanted;
  // The second round handles an offset that changes in between.
  for (let round = 0; round < 2; round += 1) ms += wanted - Date.parse(`${field(ms)}Z`);
  return ms;
}

/** Name of the zone, shown next to a clock: "CET", "UTC". */
export function zoneName(ms) {
  const parts = shape("zone", { timeZoneName: "short" }).formatToParts(ms);
  return parts.find((p) => p.type === "timeZoneName")?.value ?? zone;
}

const pair = (first, unit, rest, part) => (rest ? `${first} ${unit} ${rest} ${part}` : `${first} ${unit}`);

/** "8 s", "3 min", "2 h 5 min", "3 d 4 h". */
export function duration(seconds) {
  if (missing(seconds)) return NONE;
  if (seconds < 0) return `−${duration(-seconds)}`;
  if (seconds < 59.5) return `${number(seconds)} s`;
  const s = Math.round(seconds);
  if (s < 600) return pair(Math.floor(s / 60), "min", s % 60, "s");
  const min = Math.round(seconds / 60);
  if (min < 60) return `${min} min`;
  if (min < 600) return pair(Math.floor(min / 60), "h", min % 60, "min");
  const hours = Math.round(seconds / 3600);
  if (hours < 24) return `${hours} h`;
  if (hours < 72) return pair(Math.floor(hours / 24), "d", hours % 24, "h");
  return `${Math.round(seconds / 86400)} d`;
}

/** "512 B", "1.2 MB". */
export function bytes(n) {
  if (missing(n)) return NONE;
  const units = ["B", "kB", "MB", "GB"];
  let at = 0;
  let size = n;
  while (size >= 1000 && at < 3) {
    size /= 1000;
    at += 1;
  }
  return `${number(size)} ${units[at]}`;
}

/** Adds a capital at the start and a full stop at the end. */
export function sentence(text) {
  const whole = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(whole) ? whole : `${whole}.`;
}

/** RFC 3339 text or a number of ms to ms; null if missing. */
export function millis(value) {
  if (value === null || value === undefined) return null;
  const ms = typeof value === "number" ? value : Date.parse(value);
  return Number.isFinite(ms) ? ms : null;
}
