// Runs before the first paint: the reader's choice of light or dark, else what the system says.
"use strict";
(() => {
  const kept = localStorage.getItem("stictiond.theme");
  if (kept === "light" || kept === "dark") document.documentElement.dataset.theme = kept;
})();
