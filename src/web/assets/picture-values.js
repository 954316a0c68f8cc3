// Values under the pointer in the program's pictures: `data-axes` holds each panel's corners in picture and data units,
// `data-cells` a map's cells. Dragging a box zooms, a double click shows all again.

import { fill, h } from "./dom.js";
import { number } from "./format.js";

/** Smallest box that zooms, picture units. */
const LEAST_BOX = 30;

const list = (text) => text.trim().split(/\s+/).map(Number);

function place(svg, event) {
  const at = new DOMPoint(event.clientX, event.clientY);
  return at.matrixTransform(svg.getScreenCTM().inverse());
}

function cellWords(names, cells, x, y) {
  const [across, up, value] = names.split("|");
  const [what, unit = ""] = value.split(", ");
  const short = (label) => label.split(", ")[0];
  let best = null;
  for (const cell of cells) {
    const far = (cell[0] - x) ** 2 + (cell[1] - y) ** 2;
    if (!best || far < best.far) best = { far, cell };
  }
  return best ? `${short(across)} ${number(best.cell[0])}, ${short(up)} ${number(best.cell[1])}: ${what} ${number(best.cell[2])} ${unit}` : "";
}

let box = null;

/** Adds values under the pointer to a picture. */
export function readable(svg) {
  const panels = (svg.dataset.axes ?? "").split(";").filter(Boolean).map(list);
  if (!panels.length) return;
  const [names, ...rest] = (svg.dataset.cells ?? "").split(";");
  const cells = rest.filter(Boolean).map(list);
  const whole = svg.getAttribute("viewBox");
  let from = null;

  const words = ({ x, y }) => {
    const panel = panels.find((p) => x >= p[0] && x <= p[1] && y >= p[2] && y <= p[3]);
    if (!panel) return null;
    const [left, right, top, bottom, x0, x1, y1, y0] = panel;
    const atX = x0 + ((x - left) / (right - left)) * (x1 - x0);
    const atY = y1 + ((y - top) / (bottom - top)) * (y0 - y1);
    return cells.length ? cellWords(names, cells, atX, atY) : `${number(atX)} , ${number(atY)}`;
  };
  const hide = () => box && (box.hidden = true);

  svg.addEventListener("pointermove", (event) => {
    const text = words(place(svg, event));
    if (!text) return hide();
    box ??= h("div", { class: "value-box", "aria-hidden": "true" });
    // In full-screen mode only the contents of that element are visible.
    const holder = document.fullscreenElement ?? document.body;
    if (box.parentNode !== holder) holder.append(box);
    fill(box, text).hidden = false;
    box.style.left = `${Math.min(event.clientX + 14, document.documentElement.clientWidth - box.offsetWidth - 8)}px`;
    box.style.top = `${event.clientY + 16}px`;
    return undefined;
  });
  svg.addEventListener("pointerleave", hide);
  svg.addEventListener("pointerdown", (event) => {
    if (event.pointerType !== "mouse" || event.button !== 0) return;
    from = place(svg, event);
    event.preventDefault();
  });
  svg.addEventListener("pointerup", (event) => {
    if (!from) return;
    const to = place(svg, event);
    const [wide, high] = [Math.abs(to.x - from.x), Math.abs(to.y - from.y)];
    if (wide > LEAST_BOX && high > LEAST_BOX) svg.setAttribute("viewBox", [Math.min(from.x, to.x), Math.min(from.y, to.y), wide, high].join(" "));
    from = null;
  });
  svg.addEventListener("dblclick", () => svg.setAttribute("viewBox", whole));
}
