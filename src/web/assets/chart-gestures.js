// Wheel, Shift-drag, touch and keys of a line chart.

/** Adds listeners to a chart; returns a function that removes them. */
export function gestures(chart) {
  const { plot, u } = chart;
  const over = u.over;
  const touches = new Map();
  let held = null;
  let pinch = null;

  const xAt = (clientX) => u.posToVal(clientX - over.getBoundingClientRect().left, "x");

  // The wheel scrolls the page until the chart is clicked, so that scrolling does not get stuck on it.
  const wheel = (e) => {
    if (!e.ctrlKey && !e.metaKey && !plot.contains(document.activeElement)) return;
    e.preventDefault();
    if (Math.abs(e.deltaX) > Math.abs(e.deltaY)) chart.pan(e.deltaX / 1000);
    else chart.zoom(Math.exp(Math.max(-100, Math.min(100, e.deltaY)) / 400), xAt(e.clientX));
  };

  const down = (e) => {
    plot.focus({ preventScroll: true });
    if (e.pointerType === "touch") {
      touches.set(e.pointerId, e.clientX);
      held = { x: e.clientX, view: chart.view() };
      if (touches.size === 2) {
        const [a, b] = [...touches.values()];
        pinch = { far: Math.max(20, Math.abs(a - b)), centre: xAt((a + b) / 2), view: chart.view() };
      }
    } else if (e.shiftKey && e.button === 0) {
      held = { x: e.clientX, view: chart.view() };
      over.setPointerCapture(e.pointerId);
      over.classList.add("panning");
    }
  };

  const move = (e) => {
    if (touches.has(e.pointerId)) touches.set(e.pointerId, e.clientX);
    if (pinch && touches.size === 2) {
      const [a, b] = [...touches.values()];
      const factor = pinch.far / Math.max(20, Math.abs(a - b));
      const [from, to] = pinch.view;
      chart.setView(pinch.centre - (pinch.centre - from) * factor, pinch.centre + (to - pinch.centre) * factor, { byUser: true });
    } else if (held && (e.pointerType !== "touch" || Math.abs(e.clientX - held.x) > 6)) {
      const [from, to] = held.view;
      const by = ((e.clientX - held.x) / over.clientWidth) * (to - from);
      chart.setView(from - by, to - by, { byUser: true });
    }
  };

  const up = (e) => {
    touches.delete(e.pointerId);
    if (touches.size < 2) pinch = null;
    held = null;
    over.classList.remove("panning");
  };

  const key = (e) => {
    const step = e.ctrlKey ? 20 : 1;
    const acts = {
      ArrowLeft: () => (e.shiftKey ? chart.pan(-0.2) : chart.cursorTo((u.cursor.idx ?? u.data[0].length) - step)),
      ArrowRight: () => (e.shiftKey ? chart.pan(0.2) : chart.cursorTo((u.cursor.idx ?? -1) + step)),
      "+": () => chart.zoom(0.625),
      "=": () => chart.zoom(0.625),
      "-": () => chart.zoom(1.6),
      0: () => chart.reset(true),
      Home: () => chart.cursorTo(0),
      End: () => chart.cursorTo(u.data[0].length - 1),
    };
    const act = acts[e.key];
    if (!act || e.altKey || e.metaKey || e.target !== plot) return;
    e.preventDefault();
    act();
  };

  plot.addEventListener("keydown", key);
  over.addEventListener("wheel", wheel, { passive: false });
  over.addEventListener("pointerdown", down);
  over.addEventListener("pointermove", move);
  for (const end of ["pointerup", "pointercancel"]) over.addEventListener(end, up);
  return () => plot.removeEventListener("keydown", key);
}
