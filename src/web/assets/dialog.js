// A single dialog for all questions: fields, errors shown inside, Esc closes, focus returns.

import { fill, h } from "./dom.js";

let serial = 0;

function control(field, id) {
  const props = {
    id,
    name: field.name,
    required: field.required,
    "aria-describedby": field.hint ? `${id}-hint` : null,
    autocomplete: field.autocomplete ?? "off",
    maxlength: field.maxlength,
  };
  if (field.type === "select") {
    const options = field.options.map((o) => h("option", { value: o.value, selected: o.value === field.value }, o.label));
    return h("select", props, options);
  }
  if (field.type === "textarea") return h("textarea", { ...props, rows: 3, value: field.value ?? "" });
  return h("input", { ...props, type: field.type ?? "text", value: field.value ?? "" });
}

/** Asks; resolves to the values by name, or null if it was closed. Errors thrown by `onSubmit` are shown inside. */
export function ask({ title, intro, fields = [], submit = "OK", onSubmit = async () => {} }) {
  const number = ++serial;
  const error = h("p", { class: "problem", role: "alert", hidden: true });
  const go = h("button", { class: "button primary", type: "submit" }, submit);
  const rows = fields.map((field, k) => {
    const id = `ask-${number}-${k}`;
    const hint = field.hint && h("small", { id: `${id}-hint`, class: "soft" }, field.hint);
    return h("div", { class: "field" }, h("label", { for: id }, field.label), control(field, id), hint);
  });
  const dialog = h("dialog", { class: "dialog", "aria-labelledby": `ask-${number}` });
  const cancel = h("button", { class: "button", type: "button", onclick: () => dialog.close() }, "Cancel");
  const form = h("form", { method: "dialog" },
    h("h2", { id: `ask-${number}` }, title), intro && h("p", { class: "soft" }, intro), rows, error,
    h("div", { class: "row end" }, cancel, go));
  dialog.append(form);
  document.body.append(dialog);
  return new Promise((resolve) => {
    let answer = null;
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      const values = Object.fromEntries(new FormData(form));
      go.disabled = true;
      error.hidden = true;
      try {
        await onSubmit(values);
        answer = values;
        dialog.close();
      } catch (problem) {
        fill(error, problem.message).hidden = false;
        go.disabled = false;
      }
    });
    dialog.addEventListener("close", () => {
      dialog.remove();
      resolve(answer);
    });
    dialog.showModal();
    form.querySelector("input, select, textarea")?.focus();
  });
}
