// Runs before the first paint: sets the reader's light or dark theme, else the system's.
"use strict";
(() => {
  const kept = localStorage.getItem("stictiond.theme");
  if (kept === "light" || kept === "dark") document.documentElement.dataset.theme = kept;
})();
