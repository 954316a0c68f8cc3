// Additions to the lines of a chart: instants with a word, and shaded ranges behind the lines.

import { ink } from "./ink.js";

const inside = (u, x) => x >= u.scales.x.min && x <= u.scales.x.max;

/** Dashed vertical lines with their words at the top, or rings if `y` is given. */
export function drawMarks(u, marks) {
  const { ctx, bbox } = u;
  const scale = devicePixelRatio;
  ctx.save();
  ctx.font = `${11 * scale}px system-ui, sans-serif`;
  ctx.textBaseline = "top";
  for (const mark of marks) {
    if (!inside(u, mark.x)) continue;
    const x = Math.round(u.valToPos(mark.x, "x", true));
    ctx.strokeStyle = ink(mark.ink ?? "--error");
    ctx.fillStyle = ctx.strokeStyle;
    ctx.lineWidth = 1.5 * scale;
    ctx.beginPath();
    if (mark.y !== undefined) {
      ctx.setLineDash([]);
      ctx.arc(x, u.valToPos(mark.y, "y", true), 6 * scale, 0, 2 * Math.PI);
      ctx.stroke();
      continue;
    }
    ctx.setLineDash([5 * scale, 4 * scale]);
    ctx.moveTo(x, bbox.top);
    ctx.lineTo(x, bbox.top + bbox.height);
    ctx.stroke();
    if (!mark.label) continue;
    const right = x + ctx.measureText(mark.label).width + 8 * scale < bbox.left + bbox.width;
    ctx.textAlign = right ? "left" : "right";
    ctx.fillText(mark.label, x + (right ? 4 : -4) * scale, bbox.top + 2 * scale);
  }
  ctx.restore();
}

/** Shaded ranges. */
export function drawSpans(u, spans) {
  const { ctx, bbox } = u;
  ctx.save();
  for (const span of spans) {
    const from = Math.max(bbox.left, u.valToPos(span.from, "x", true));
    const to = Math.min(bbox.left + bbox.width, u.valToPos(span.to, "x", true));
    if (to <= from) continue;
    ctx.globalAlpha = 0.14;
    ctx.fillStyle = ink(span.ink ?? "--other");
    ctx.fillRect(from, bbox.top, to - from, bbox.height);
  }
  ctx.restore();
}
