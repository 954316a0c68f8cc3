"use strict";
(() => {
  const box = document.getElementById("value");
  const show = (v) => (v === 0 ? "0" : Math.abs(v) >= 1e5 || Math.abs(v) < 1e-3 ? v.toExponential(2) : String(+v.toPrecision(4)));
  const numbers = (text) => text.trim().split(/\s+/).map(Number);
  const panels = (svg) => (svg.dataset.axes || "").split(";").filter(Boolean).map(numbers);
  const place = (svg, event) => {
    const at = svg.createSVGPoint();
    at.x = event.clientX;
    at.y = event.clientY;
    return at.matrixTransform(svg.getScreenCTM().inverse());
  };
  const nearestCell = (svg, x, y) => {
    const [names, ...cells] = svg.dataset.cells.split(";");
    const [across, up, value] = names.split("|");
    let best = null;
    for (const cell of cells.map(numbers)) {
      const far = (cell[0] - x) ** 2 + (cell[1] - y) ** 2;
      if (!best || far < best.far) best = { far, cell };
    }
    const say = (label, v) => label.split(", ")[0] + " " + show(v);
    const unit = value.split(", ")[1] || "";
    return best ? say(across, best.cell[0]) + ", " + say(up, best.cell[1]) + ": " + say(value, best.cell[2]) + " " + unit : "";
  };
  document.addEventListener("pointermove", (event) => {
    const svg = event.target.closest && event.target.closest("svg[data-axes]");
    box.hidden = true;
    if (!svg) return;
    const at = place(svg, event);
    const panel = panels(svg).find((p) => at.x >= p[0] && at.x <= p[1] && at.y >= p[2] && at.y <= p[3]);
    if (!panel) return;
    const [left, right, top, bottom, x0, x1, y1, y0] = panel;
    const x = x0 + ((at.x - left) / (right - left)) * (x1 - x0);
    const y = y1 + ((at.y - top) / (bottom - top)) * (y0 - y1);
    box.textContent = svg.dataset.cells ? nearestCell(svg, x, y) : show(x) + " , " + show(y);
    box.hidden = false;
    const edge = document.documentElement.clientWidth - box.offsetWidth - 8;
    box.style.left = Math.max(0, Math.min(event.clientX + 14, edge)) + "px";
    box.style.top = event.clientY + 16 + "px";
  });
  // Zoom: drag from corner to corner inside a picture, double click to see all of it again.
  let from = null;
  document.addEventListener("pointerdown", (event) => {
    const svg = event.target.closest && event.target.closest("svg[data-axes]");
    if (svg && event.pointerType === "mouse" && event.button === 0) {
      from = { svg, at: place(svg, event) };
      event.preventDefault();
    }
  });
  document.addEventListener("pointerup", (event) => {
    if (!from) return;
    const { svg, at } = from;
    from = null;
    const to = place(svg, event);
    const [wide, high] = [Math.abs(to.x - at.x), Math.abs(to.y - at.y)];
    if (wide < 30 || high < 30) return;
    svg.dataset.whole = svg.dataset.whole || svg.getAttribute("viewBox");
    svg.setAttribute("viewBox", [Math.min(at.x, to.x), Math.min(at.y, to.y), wide, high].join(" "));
  });
  document.addEventListener("dblclick", (event) => {
    const svg = event.target.closest && event.target.closest("svg[data-whole]");
    if (svg) svg.setAttribute("viewBox", svg.dataset.whole);
  });
  const open = () => {
    const target = location.hash && document.getElementById(location.hash.slice(1));
    const around = target && target.closest("details");
    if (around) around.open = true;
    if (around) around.scrollIntoView();
  };
  addEventListener("hashchange", open);
  open();
  // Paper holds every loop and number, also of those that are folded on the screen.
  const folded = [];
  addEventListener("beforeprint", () => {
    folded.push(...document.querySelectorAll("details:not([open])"));
    for (const details of folded) details.open = true;
  });
  addEventListener("afterprint", () => {
    for (const details of folded.splice(0)) details.open = false;
  });
  const rows = [...document.querySelectorAll(".overview tbody tr")];
  if (rows.length > 10) {
    const find = document.createElement("input");
    find.id = "find";
    find.type = "search";
    find.addEventListener("input", () => {
      const word = find.value.toLowerCase();
      for (const row of rows) row.hidden = !row.textContent.toLowerCase().includes(word);
    });
    const label = document.createElement("label");
    label.id = "filter";
    label.append("Filter loops ", find);
    document.querySelector(".overview").parentElement.before(label);
  }
})();
