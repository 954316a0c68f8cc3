// Commands and reviews of alarms: acknowledge, shelve, confirm, mark as false. Name and reason are recorded.

import * as api from "./api.js";
import { h } from "./dom.js";
import { ask } from "./dialog.js";
import * as format from "./format.js";
import { store } from "./store.js";

const NAME = "stictiond.name";

const name = () => ({ name: "by", label: "Your name", required: true, value: localStorage.getItem(NAME) ?? "", maxlength: 64, autocomplete: "name", hint: "Written to the record; not verified." });
const why = (hint, required = false) => ({ name: "why", label: "Reason", type: "textarea", maxlength: 500, hint, required });

const SHELVES = [[3600, "1 hour"], [28800, "8 hours (a shift)"], [86400, "1 day"], [604800, "7 days"], [2678400, "31 days"]];
const forTime = { name: "for_s", label: "For", type: "select", value: "28800", options: SHELVES.map(([s, label]) => ({ value: String(s), label })) };

const COMMANDS = {
  ack: { label: "Acknowledge", intro: "You have seen the alarm. It stays active until enough windows no longer show stiction.", fields: [why("For example: check the packing at the shutdown in May.")] },
  shelve: { label: "Shelve …", intro: "The alarm leaves the list for this time and then returns.", fields: [forTime, why("Why it can wait.")] },
  unshelve: { label: "Unshelve", intro: "The alarm returns to the list in its current state.", fields: [why("")] },
  out_of_service: { label: "Out of service …", intro: "For work on the valve. The alarm is out of service until you return it to service.", fields: [why("For example: valve removed for repair.")] },
  in_service: { label: "Back in service", intro: "The alarm is active again.", fields: [why("")] },
  suppress: { label: "Suppress …", intro: "By design, for example while the unit is down. The alarm stays suppressed until you end it.", fields: [why("The condition, for example: unit down.")] },
  unsuppress: { label: "Unsuppress", intro: "The alarm is active again.", fields: [why("")] },
};

/** The commands that an alarm's state allows, the likeliest first. */
export function allowed(state) {
  if (state === "shelved") return ["unshelve"];
  if (state === "suppressed") return ["unsuppress"];
  if (state === "out_of_service") return ["in_service"];
  if (state === "unack" || state === "rtn_unack") return ["ack", "shelve", "out_of_service"];
  return state === "acked" ? ["shelve", "out_of_service"] : ["out_of_service"];
}

/** Asks for name and reason, and sends a command; resolves to the new document, or null. */
export async function command(loop, cmd) {
  const { label, intro, fields } = COMMANDS[cmd];
  let answer = null;
  await ask({
    title: `${label.replace(" …", "")}: ${loop}`,
    intro,
    fields: [name(), ...fields],
    submit: label.replace(" …", ""),
    onSubmit: async (values) => {
      localStorage.setItem(NAME, values.by.trim());
      const body = { cmd, by: values.by.trim(), why: values.why?.trim() || undefined };
      if (values.for_s) body.for_s = Number(values.for_s);
      answer = await api.post(api.loopPath(loop, "/alarm"), body);
    },
  });
  return answer;
}

const REVIEWS = {
  stiction: { title: "The valve sticks", intro: "The finding is stored with this window and can be used to check the program.", methods: [["stroke_test", "stroke test"], ["inspection", "inspection"], ["other", "other"]] },
  no_stiction: { title: "The valve does not stick", intro: "The finding is stored with this window and can be used to check the program.", methods: [["false_alarm", "false alarm, by judgement"], ["stroke_test", "stroke test"], ["inspection", "inspection"], ["other", "other"]] },
  repaired: { title: "The valve was repaired", intro: "Maintenance compares the windows before and after this time.", methods: [["other", "repair"], ["stroke_test", "repair, checked by a stroke test"], ["inspection", "repair, checked by inspection"]], dated: true },
};

const EXAMPLES = {
  stiction: "What was seen, for example: stem moved only after 6 %.",
  no_stiction: "What was seen, for example: stem followed steps of 0.5 %.",
  repaired: "What was done, for example: packing replaced.",
};

/** A review in words. */
export function said(review) {
  if (review.label === "repaired") return `Repaired on ${format.dateTime(review.work_at_ms)}, says`;
  return review.label === "stiction" ? "Confirmed by" : "Marked as false by";
}

/** Asks how it was established, and stores the review; resolves to the review, or null. */
export async function review(loop, label) {
  const { title, intro, methods, dated } = REVIEWS[label];
  const when = { name: "work_at", label: `Work done at, ${format.zoneName(Date.now())}`, type: "datetime-local", required: true, value: format.field(Date.now()) };
  let answer = null;
  await ask({
    title: `${title}: ${loop}`,
    intro,
    fields: [name(), ...(dated ? [when] : []), { name: "method", label: dated ? "What was done" : "How it was found", type: "select", value: methods[0][0], options: methods.map(([value, words]) => ({ value, label: words })) }, why(EXAMPLES[label])],
    submit: "Keep",
    onSubmit: async (values) => {
      localStorage.setItem(NAME, values.by.trim());
      const work_at = dated ? new Date(format.ofField(values.work_at)).toISOString() : undefined;
      answer = await api.post(api.loopPath(loop, "/review"), { label, method: values.method, by: values.by.trim(), why: values.why?.trim() || undefined, work_at });
    },
  });
  return answer?.review ?? null;
}

/** Asks for the name and requests a gap diagnosis, with `pool` joint with earlier ones; resolves to the document, or null. */
export async function runGap(loop, pool, started) {
  let by = localStorage.getItem(NAME);
  if (!by) {
    const values = await ask({ title: `Run the gap diagnosis: ${loop}`, intro: "The diagnosis takes up to a minute. Estimates continue meanwhile.", fields: [name()], submit: "Run" });
    if (!values) return null;
    by = values.by.trim();
    localStorage.setItem(NAME, by);
  }
  started();
  return api.post(api.loopPath(loop, "/gap"), { by, pool });
}

/** Buttons for an alarm; `done(document, review)` is called after each command. `sticks`: the program's verdict, on which people comment. */
export function buttons(alarm, { done, sticks = true, window = true }) {
  if (store.site?.commands === false) return h("span", { class: "soft" }, "Commands are disabled in the configuration.");
  const list = allowed(alarm.state);
  const act = (cmd) => async () => {
    const answer = await command(alarm.loop, cmd);
    if (answer) done(answer);
  };
  const judge = (label) => async () => {
    const answer = await review(alarm.loop, label);
    if (answer) done(null, answer);
  };
  const one = (label, onclick, kind) => h("button", { class: `button ${kind}`, type: "button", onclick, "aria-label": `${label.replace(" …", "")}: ${alarm.loop}` }, label);
  const words = sticks ? { stiction: "Confirm …", no_stiction: "Mark as false …", repaired: "Repaired …" } : { stiction: "It sticks …", no_stiction: "It moves freely …", repaired: "Repaired …" };
  const judged = Object.entries(words).map(([label, text]) => one(text, judge(label), ""));
  return h("div", { class: "row buttons" }, list.map((cmd) => one(COMMANDS[cmd].label, act(cmd), cmd === "ack" ? "primary" : "")), window ? judged : null);
}
