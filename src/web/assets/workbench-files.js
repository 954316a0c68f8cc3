// Files of the workbench: drop zone, picker, the open files, and the chosen loop.

/** Most loops listed; a search finds the others. */
const LISTED = 60;

const OPTION_WORDS = {
  tz: ["Time zone", "Zone of timestamps without one: Europe/Berlin, UTC, +01:00"],
  time_format: ["Time format", "dmy, mdy, ymd, excel, s, ms, or a pattern such as %d/%m/%Y %H:%M:%S"],
  decimal: ["Decimal separator", "point or comma"],
  map: ["Columns", "op=TAG,pv=TAG[,sp=TAG][,t=COLUMN]; columns by name or by number from 1"],
  delimiter: ["Cell separator", "One character such as ; or tab"],
  encoding: ["Encoding", "Such as windows-1251 or shift_jis"],
  sheet: ["Sheet", "Sheet of a workbook"],
  quality: ["Quality codes", "ua, classic, percent, flag or ignore"],
};

/** Name of a loop: its tag if the file has one, with the file's name for it. */
export const called = (one) => (one.tag && one.tag !== one.name ? `${one.tag} (${one.name})` : one.name);

/** The panel of files. `on`: `chosen(file, loop)`, `changed(files)`. */
export class Files {
  constructor(root, { api, dom, dialog, format, announce }, on) {
    Object.assign(this, { root, api, dialog, format, announce, on, h: dom.h, fill: dom.fill });
    this.files = [];
    this.chosen = { file: null, loop: null };
    this.coming = [];
    this.search = "";
    this.build();
  }

  build() {
    const { h } = this;
    this.picker = h("input", { type: "file", multiple: true, class: "unseen", tabindex: "-1", "aria-hidden": "true", onchange: () => this.take([...this.picker.files]) });
    const button = h("button", { class: "button primary", type: "button", onclick: () => this.picker.click() }, "Open a file…");
    this.zone = h("div", { class: "wb-drop" }, h("div", { class: "row" }, button, h("span", { class: "wb-drop-words" }, "or drop it here")),
      h("small", { class: "soft" }, "Recordings (.mcap), compact stores (.mat), exports (.csv, .txt, .xlsx, .parquet, .arrow)"), this.picker);
    this.status = h("div", { "aria-live": "polite" });
    this.list = h("div", { class: "wb-file-list" });
    this.fill(this.root, this.zone, this.status, this.list);
    const lit = (yes) => (e) => {
      if (![...(e.dataTransfer?.types ?? [])].includes("Files")) return;
      e.preventDefault();
      this.zone.classList.toggle("lit", yes);
    };
    this.listeners = [["dragover", lit(true)], ["dragleave", lit(false)], ["drop", (e) => {
      if (!e.dataTransfer?.files.length) return;
      e.preventDefault();
      this.zone.classList.remove("lit");
      this.take([...e.dataTransfer.files]);
    }]];
    for (const [name, act] of this.listeners) document.addEventListener(name, act);
  }

  end() {
    for (const [name, act] of this.listeners) document.removeEventListener(name, act);
    for (const one of this.coming) one.control.abort();
  }

  /** Loads the list of open files. */
  async load() {
    this.files = (await this.api.get("/workbench/files")).files;
    this.draw();
    this.on.changed(this.files);
  }

  find(id) {
    return this.files.find((file) => file.id === id);
  }

  choose(file, loop) {
    this.chosen = { file, loop };
    this.draw();
  }

  async take(blobs) {
    this.picker.value = "";
    for (const blob of blobs) await this.send(blob, {});
  }

  async send(blob, options) {
    const one = { name: blob.name, done: 0, of: blob.size, control: new AbortController() };
    this.coming.push(one);
    this.drawStatus();
    const query = new URLSearchParams({ name: blob.name, ...options });
    try {
      const file = await this.api.upload(`/workbench/files?${query}`, blob, {
        signal: one.control.signal,
        onProgress: (done, of) => {
          Object.assign(one, { done, of });
          this.drawStatus();
        },
      });
      this.files.push(file);
      this.announce(`${file.name} is open: ${this.format.count(file.loops.length, "loop")}`);
      this.on.changed(this.files);
      if (file.loops.length) this.on.chosen(file, file.loops[0]);
    } catch (error) {
      if (error.name !== "AbortError") this.refused(blob, options, error);
    } finally {
      this.coming.splice(this.coming.indexOf(one), 1);
      this.drawStatus();
      this.draw();
    }
  }

  /** Keeps an unreadable file on display, with options for reading it. */
  refused(blob, options, error) {
    const { h } = this;
    const node = h("div", { class: "problem" }, error.message.startsWith(`${blob.name}: `) ? error.message : `${blob.name}: ${error.message}`, " ");
    const buttons = h("div", { class: "row" });
    if (error.status === 422) buttons.append(h("button", { class: "button", type: "button", onclick: () => this.ask(blob, options, error.message).then((sent) => sent && node.remove()) }, "Set reading options…"));
    buttons.append(h("button", { class: "button quiet", type: "button", onclick: () => node.remove() }, "Dismiss"));
    node.append(buttons);
    this.zone.after(node);
  }

  ask(blob, given, intro) {
    const fields = Object.entries(OPTION_WORDS).map(([name, [label, hint]]) => ({ name, label, hint, value: given[name] ?? "" }));
    return this.dialog.ask({
      title: `Reading options for ${blob.name}`, intro, fields, submit: "Open",
      onSubmit: async (values) => {
        const options = Object.fromEntries(Object.entries(values).filter(([, value]) => value.trim()));
        const query = new URLSearchParams({ name: blob.name, ...options });
        const file = await this.api.upload(`/workbench/files?${query}`, blob, {});
        this.files.push(file);
        this.on.changed(this.files);
        if (file.loops.length) this.on.chosen(file, file.loops[0]);
        this.draw();
      },
    });
  }

  drawStatus() {
    const { h, fill, format } = this;
    fill(this.status, this.coming.map((one) => {
      const read = one.of > 0 && one.done >= one.of;
      return h("div", { class: "row wb-coming" },
        h("progress", { max: "1", value: read ? null : one.done / (one.of || 1), "aria-label": `Opening ${one.name}` }),
        h("span", null, read ? `Reading ${one.name}` : `Sending ${one.name}: ${format.bytes(one.done)} of ${format.bytes(one.of)}`),
        h("button", { class: "button quiet", type: "button", onclick: () => one.control.abort() }, "Stop"));
    }));
  }

  async close(file) {
    // First make sure that nothing requests it any longer.
    if (this.chosen.file === file.id) this.on.chosen(null, null);
    try {
      this.files = (await this.api.del(`/workbench/files/${file.id}`)).files;
    } catch (error) {
      this.announce(error.message);
    }
    this.on.changed(this.files);
    this.draw();
  }

  loopButton(file, one) {
    const { h, format } = this;
    const here = this.chosen.file === file.id && this.chosen.loop === one.name;
    const length = one.start_ms !== null ? format.duration((one.end_ms - one.start_ms) / 1000) : "empty";
    const details = `${format.count(one.samples, "sample")}, ${length}${one.about ? ` · ${one.about}` : ""}`;
    return h("li", null, h("button", { class: "wb-loop", type: "button", "aria-pressed": String(here), onclick: () => this.on.chosen(file, one) },
      h("b", null, called(one)), h("small", null, details)));
  }

  draw() {
    const { h, fill, format } = this;
    const count = this.files.reduce((sum, file) => sum + file.loops.length, 0);
    const words = this.search.toLowerCase();
    let room = LISTED;
    let hidden = 0;
    const parts = this.files.map((file) => {
      const found = file.loops.filter((one) => `${file.name} ${one.name} ${one.about ?? ""}`.toLowerCase().includes(words));
      const listed = found.slice(0, Math.max(0, room));
      room -= listed.length;
      hidden += found.length - listed.length;
      const notes = [file.recognised && `Read as ${file.recognised}`, ...file.warnings].filter(Boolean);
      return h("section", { class: "wb-file", "aria-label": file.name },
        h("div", { class: "row spread" }, h("h3", { title: file.name }, file.name),
          h("button", { class: "button quiet icon", type: "button", "aria-label": `Close ${file.name}`, title: "Close", onclick: () => this.close(file) }, "×")),
        h("small", { class: "soft" }, `${format.bytes(file.bytes)}${file.uploaded ? "" : " · from the command line"}`),
        notes.length ? h("details", null, h("summary", null, file.warnings.length ? format.count(file.warnings.length, "remark") : "How it was read"), h("ul", null, notes.map((note) => h("li", null, note)))) : null,
        h("ul", { class: "wb-loops" }, listed.map((one) => this.loopButton(file, one))));
    });
    const focus = this.find_input === document.activeElement && this.find_input?.selectionStart;
    this.find_input = count > 8 ? h("input", { type: "search", value: this.search, "aria-label": "Search loops", placeholder: "Search loops", oninput: (e) => {
      this.search = e.target.value;
      this.draw();
    } }) : null;
    fill(this.list, this.find_input, parts, hidden ? h("p", { class: "soft" }, `${hidden} more; search by name`) : null);
    if (typeof focus === "number") {
      this.find_input?.focus();
      this.find_input?.setSelectionRange(focus, focus);
    }
  }
}
