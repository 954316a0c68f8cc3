// The mean squared errors of a run with an additional solver: which result to use, and why they differ.

/** Meaning of a solver's answer compared with the estimate's. */
function advice(format, { mse, estimate_mse, name }) {
  if (mse === null || estimate_mse === null) return `${name} found no model to compare. Use the estimate.`;
  const both = `In the solver's model ${name} reaches ${format.number(mse)}, the estimate's bands ${format.number(estimate_mse)}`;
  if (mse > estimate_mse) return `${both}: ${name} missed the best bands. Use the estimate.`;
  return `${both}: the solver's bands suit its coarser model better. Use the estimate; if the solver's bands lie outside the estimate's intervals, try a finer grid or more models.`;
}

/** A table of the errors of one result; null if no solver was requested. */
export function solverTable({ h, format }, document, order) {
  const { solver, process } = document;
  if (!solver || !process) return null;
  const n = format.number;
  const rows = [
    ["Estimate", document.fs, document.fd, process.mse, "Time constants and dead time are fitted without steps. Use these bands and this error."],
    ["Estimate's bands in the solver's model", document.fs, document.fd, solver.estimate_mse, "The same bands. The solver's model takes time constants and dead time from a grid, so its error is usually larger."],
    [`Best of ${solver.name}`, solver.fs, solver.fd, solver.mse, `Least error among ${format.integer(solver.evaluations)} models on that grid. Compare it only with the line above.`],
  ];
  const body = rows.map(([name, fs, fd, mse, words], k) => h("tr", { class: k === 0 ? "wb-named" : null }, h("th", { scope: "row" }, name),
    [fs, fd, mse].map((v) => h("td", { class: "number" }, n(v))), h("td", null, words)));
  const title = `Mean squared errors${order ? `, ${order.toLowerCase()}` : ""}`;
  return [h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": title }, h("table", { class: "table wb-errors" }, h("caption", null, h("b", null, title)),
    h("thead", null, h("tr", null, ["Model", "fs", "fd", "MSE", "What it is"].map((t, k) => h("th", { scope: "col", class: k > 0 && k < 4 ? "number" : null }, t)))),
    h("tbody", null, body))), h("p", null, advice(format, solver))];
}
