// The server's pictures, inserted inline so that they take the page's colours in dark mode and print sharply.

import * as api from "./api.js";
import { fill, h, problem, skeleton, whenNear } from "./dom.js";
import { readable } from "./picture-values.js";

const parser = new DOMParser();
const BARRED = "script, foreignObject, style, iframe, image, a, animate, set";

// A picture comes from our own server but contains names from outside, so active content is removed.
function clean(text) {
  const named = text.includes("xmlns=") ? text : text.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"');
  const parsed = parser.parseFromString(named, "image/svg+xml").documentElement;
  if (parsed.nodeName !== "svg") throw new Error("not a picture");
  for (const node of parsed.querySelectorAll(BARRED)) node.remove();
  for (const node of [parsed, ...parsed.querySelectorAll("*")]) {
    for (const name of node.getAttributeNames()) if (name.startsWith("on") || name === "style" || name.endsWith("href")) node.removeAttribute(name);
  }
  parsed.classList.add("plot");
  parsed.setAttribute("role", "img");
  return document.importNode(parsed, true);
}

// The picture's text, which is in the list or has a separate address.
async function source(picture) {
  if (picture.svg) return picture.svg;
  const response = await fetch(api.url(picture.url), { cache: "no-cache" });
  if (!response.ok) throw new Error("not there");
  return response.text();
}

function figure(picture) {
  const frame = h("div", { class: "frame", ...(picture.wide ? { tabindex: "0", role: "group", "aria-label": picture.title } : {}) }, skeleton(5));
  const load = async () => {
    try {
      const svg = clean(await source(picture));
      if (!svg.getAttribute("aria-label")) svg.setAttribute("aria-label", picture.title);
      fill(frame, svg);
      readable(svg);
    } catch {
      fill(frame, problem("This picture could not be loaded.", load));
    }
  };
  const save = async () => {
    const blob = new Blob([await source(picture)], { type: "image/svg+xml" });
    const href = URL.createObjectURL(blob);
    h("a", { href, download: `${picture.title}.svg` }).click();
    setTimeout(() => URL.revokeObjectURL(href), 1000);
  };
  const link = h("button", { class: "button quiet icon", type: "button", onclick: save, "aria-label": `Save picture: ${picture.title}`, title: "Save as SVG" }, "⤓");
  const node = h("figure", { class: picture.wide ? "wide" : null }, frame, h("figcaption", null, h("b", null, picture.title), ". ", picture.caption, " ", link));
  whenNear(node, load);
  return node;
}

/** Shows pictures `{ id, title, caption, wide, svg or url }`, each drawn when it comes near the screen. */
export function show(root, pictures) {
  fill(root, pictures.length ? h("div", { class: "pictures" }, pictures.map(figure)) : h("p", { class: "soft" }, "No pictures: no model was fitted to this window."));
}
