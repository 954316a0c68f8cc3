// The page's link to the daemon: one stream, with reconnection, a notice when data are stale, and detection of sleep.

import { stream } from "./api.js";

/** Silence after which the display is called stale, ms; the daemon sends something every 10 s. */
const STALE_AFTER_MS = 15_000;
/** A timer that is late by this much means that the computer slept, ms. */
const SLEPT_MS = 20_000;
const LONGEST_PAUSE_MS = 15_000;
const TICK_MS = 1000;

/** States: `connecting` (first time), `live`, `lost` (no link; the reason is in `why`). */
export class Live {
  constructor({ onEvent, onState }) {
    this.onEvent = onEvent;
    this.onState = onState;
    this.state = "connecting";
    this.why = null;
    this.heard_ms = null;
    this.loop = null;
    this.pause_ms = 1000;
    this.close = null;
    this.again = null;
    this.ticked_ms = Date.now();
    setInterval(() => this.tick(), TICK_MS);
    addEventListener("online", () => this.reconnect());
    addEventListener("offline", () => this.lost("this computer is offline"));
    document.addEventListener("visibilitychange", () => !document.hidden && this.tick());
  }

  /** Opens the stream; with a loop's name also its samples and estimates. */
  open(loop = null) {
    if (this.close && this.loop === loop) return;
    this.loop = loop;
    this.reconnect();
  }

  reconnect() {
    clearTimeout(this.again);
    this.close?.();
    const query = this.loop === null ? "" : `?loop=${encodeURIComponent(this.loop)}`;
    this.opened_ms = Date.now();
    this.close = stream(`/events${query}`, {
      onBytes: () => (this.heard_ms = Date.now()),
      onEvent: (name, data) => {
        this.pause_ms = 1000;
        this.set("live", null);
        this.onEvent(name, data);
      },
      onEnd: (error) => this.lost(error?.status ? error.message : "the program does not answer"),
    });
  }

  lost(why) {
    this.close?.();
    this.close = null;
    this.set("lost", why);
    clearTimeout(this.again);
    this.again = setTimeout(() => this.reconnect(), this.pause_ms);
    this.pause_ms = Math.min(LONGEST_PAUSE_MS, this.pause_ms * 2);
  }

  set(state, why) {
    if (this.state === state && this.why === why) return;
    const before = this.state;
    this.state = state;
    this.why = why;
    this.onState(this, before);
  }

  tick() {
    const now = Date.now();
    const slept = now - this.ticked_ms > SLEPT_MS;
    this.ticked_ms = now;
    if (slept) {
      this.set("lost", "this computer was asleep");
      return this.reconnect();
    }
    const since = Math.max(this.heard_ms ?? 0, this.opened_ms ?? 0);
    if (this.close && now - since > STALE_AFTER_MS) this.lost("the program has stopped sending");
    return undefined;
  }
}
