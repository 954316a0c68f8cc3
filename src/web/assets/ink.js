// The page's colours for canvases: CSS variables, read at the time of drawing.

const styles = getComputedStyle(document.documentElement);

/** The current colour of a CSS variable. */
export const ink = (name) => styles.getPropertyValue(name).trim() || "#888888";

/** The same, with an opacity from 0 to 1. */
export function sheer(name, alpha) {
  const colour = ink(name);
  return /^#[0-9a-f]{6}$/i.test(colour) ? colour + Math.round(alpha * 255).toString(16).padStart(2, "0") : colour;
}
