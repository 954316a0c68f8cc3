// Light, dark, or the system's choice; the setting is remembered.

import { fill } from "./dom.js";

const KEPT = "stictiond.theme";
const NEXT = { system: "light", light: "dark", dark: "system" };
const SIGNS = { system: "◐", light: "☀", dark: "☾" };

/** Makes a button step through the themes; calls `changed` after every change. */
export function themeButton(button, changed) {
  const root = document.documentElement;
  const now = () => root.dataset.theme ?? "system";
  const say = () => {
    fill(button, SIGNS[now()]);
    button.setAttribute("aria-label", `Colours: ${now()}`);
    button.title = `Colours: ${now()}`;
  };
  button.addEventListener("click", () => {
    const next = NEXT[now()];
    if (next === "system") {
      delete root.dataset.theme;
      localStorage.removeItem(KEPT);
    } else {
      root.dataset.theme = next;
      localStorage.setItem(KEPT, next);
    }
    say();
    changed();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
  say();
}
