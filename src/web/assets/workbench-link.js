// A daemon's page has no workbench: it says where files can be opened.

/** Shows where files can be opened. */
export function show(root, { dom: { fill, h }, site }) {
  const url = site?.workbench_url;
  fill(root, h("h1", null, "Workbench"),
    h("section", { class: "card" },
      h("p", null, "The workbench opens recordings and exports. It is a program of its own, so that a file that takes all memory does not stop the daemon."),
      url
        ? h("p", null, h("a", { class: "button primary", href: url, target: "_blank", rel: "noopener noreferrer" }, "Open the workbench"), " ", h("span", { class: "soft" }, url))
        : h("p", null, "Run ", h("code", null, "stictiond workbench FILE"), " on the machine that has the files; it opens its page in a browser. ", h("span", { class: "soft" }, "This page links to it where ", h("code", null, "[web] workbench"), " gives its address."))));
}
