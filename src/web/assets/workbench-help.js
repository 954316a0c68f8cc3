// Help of the workbench: a tour of two examples, every field, keys.

/** The label and description of every option, by name. */
export const FIELDS = {
  kind: ["Estimate or Gap", "Estimate fits a sticking valve and a process, and gives s, j, fs and fd with intervals. Gap measures what such a model leaves unexplained and names the effect that closes it best."],
  downsample: ["One point for every", "Downsampling ratio: 2 makes one point of two samples, 2.5 is allowed. Aim at 50 points a period or more. The preview shows the result."],
  like_toolbox: ["Drop samples, as the toolbox does", "Keeps single samples instead of averaging PV. Fast changes between them are lost."],
  detrend: ["Trend of PV", "Subtracts mean, median or drift from PV and SP first. The fit has an operating point of its own, so only drift changes it."],
  model: ["Process", "How PV follows the stem. Both orders run side by side; Automatic keeps the second order only where it predicts held-out data better."],
  delay: ["Dead time", "Time from a move of the stem to PV. Write auto, samples of the recording such as 3, or seconds such as 12s. Give it where you know it."],
  valve: ["Valve law", "How the stem moves once OP has left the band: in single slips (He), or sliding after OP (tracking)."],
  op_low: ["OP's range", "OP at valve closed and open, in OP's units. With it, sizes are also given in % of travel. It does not change the fit."],
  prevalence: ["Share that sticks", "Share of such loops that stick in your plant, as stroke tests found. p assumes it; verdict, grade and sizes do not depend on it."],
  solver: ["Additional solver", "Runs a general solver on the mean squared error over (fs, fd) beside the estimate's own search, as the toolbox does. Use the estimate's bands; the solver is for comparison."],
  evaluations: ["Most models evaluated", "The additional solver stops after this many models."],
  fineness: ["Fineness", "Step of the contour solver's grid, in % of OP's span."],
  seed: ["Seed", "Start of all random draws. The same seed gives the same numbers."],
  base: ["Base", "Model that the gap is measured from: fitted here, without friction, or the estimate of a run."],
  effects: ["Effects", "Causes that the diagnosis tries. Clear those that you can rule out."],
  pairs: ["Pairs of effects", "Also tries two effects together where one already explains the gap."],
  budget_s: ["Time", "How long the diagnosis searches, in seconds."],
};

const KEYS = [
  ["Ctrl Enter", "run"], ["Ctrl Z, Ctrl Shift Z", "undo, redo a choice"], ["?", "this help"],
  ["[ ]", "start and end a section at the chart's cursor"], ["← → + − 0", "move a chart's cursor, zoom, show all"],
];

const PLAIN = { kind: "analyze", model: "both", delay: "auto", valve: "auto", like_toolbox: false, detrend: "" };

/** The two examples of the toolbox's manual. */
const TOUR = [
  { title: "Example 1: the whole record", needs: 0, patch: { ...PLAIN, sections: [], downsample: null }, steps: [
    "Set the choices: estimate, both orders, every sample. The preview shows trend, phase plot and S0.",
    "Press Run estimate. The table on top shows p, s and j of both orders.",
    "Read s with its 90 % interval. Compare it with the suggested region, in Numbers and as a box on the error maps.",
  ] },
  { title: "Example 2: samples 50 to 500, one point of two", needs: 500, patch: { ...PLAIN, sections: [{ from: 50, to: 500 }], downsample: 2 }, steps: [
    "Set the choices. The preview shows trend and phase plot before and after downsampling.",
    "Press Run estimate and compare the runs on top. On recordings/sticking.mcap (true s 8) both find s near 8, and their intervals overlap. The section has fewer periods, so its grade is lower.",
  ] },
];

/** Opens the help. `samples` is that of the current loop, or 0; `set(patch, words)` applies an example's options. */
export function help({ h }, samples, set) {
  const example = ({ title, needs, patch, steps }) => {
    const why = samples === 0 ? "Open a loop first." : samples < needs ? `This loop has ${samples} samples only.` : null;
    const button = h("button", { class: "button", type: "button", disabled: why !== null, onclick: () => {
      dialog.close();
      set(patch, title);
    } }, "Set the choices");
    return h("section", { "aria-label": title }, h("h3", null, title), h("ol", null, steps.map((step) => h("li", null, step))), h("div", { class: "row" }, button, why ? h("span", { class: "soft" }, why) : null));
  };
  const list = (rows) => h("dl", { class: "wb-help-list" }, rows.map(([name, words]) => h("div", null, h("dt", null, name), h("dd", null, words))));
  const dialog = h("dialog", { class: "dialog wb-help", "aria-labelledby": "wb-help-title" },
    h("div", { class: "row spread" }, h("h2", { id: "wb-help-title" }, "Help"), h("button", { class: "button", type: "button", onclick: () => dialog.close() }, "Close")),
    h("p", null, "Open a file, choose a loop, select sections on the trend, check the preview, then run. Runs stay in the table on top."),
    h("h2", null, "Tour: the two examples of the toolbox's manual"), TOUR.map(example),
    h("h2", null, "Fields"), list(Object.values(FIELDS)),
    h("h2", null, "Numbers"), list([
      ["S0", "OP's span in the section, without its outermost 1 %. fs + fd cannot be larger."],
      ["s, j", "s = fs + fd is how far OP travels after a reversal before the stem moves. j = fs − fd is how far the stem then jumps."],
      ["Suggested region", "Values of fs and fd whose error is close to the least: within a tenth of the way to the error without friction. It is no confidence interval."],
      ["Mean squared error", "Mean of (PV measured − PV of the model)², the model running on OP alone. Compare errors of one section and one sampling only."],
    ]),
    h("h2", null, "Keys"), list(KEYS.map(([keys, words]) => [keys.split(", ").map((key) => h("kbd", null, key)), words])));
  document.body.append(dialog);
  dialog.addEventListener("close", () => dialog.remove());
  dialog.showModal();
}
