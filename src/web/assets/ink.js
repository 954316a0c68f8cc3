// The page's colours, as a canvas needs them: the CSS variables, read when something is drawn.

const styles = getComputedStyle(document.documentElement);

/** The colour that a CSS variable has now. */
export const ink = (name) => styles.getPropertyValue(name).trim() || "#888888";

/** The same, with an opacity from 0 to 1. */
export function sheer(name, alpha) {
  const colour = ink(name);
  return /^#[0-9a-f]{6}$/i.test(colour) ? colour + Math.round(alpha * 255).toString(16).padStart(2, "0") : colour;
}
