/* What all pages share: finding elements, and the theme. */
"use strict";
const shared = (() => {
  const root = document.documentElement;
  const all = (selector, within = document) => [...within.querySelectorAll(selector)];
  const one = (selector, within = document) => within.querySelector(selector);

  /* Theme: the system's until somebody chooses. Browsers may forbid storage for pages opened from disk. */
  const remember = (value) => {
    try {
      if (value) localStorage.setItem("vibraverse-theme", value);
      return localStorage.getItem("vibraverse-theme");
    } catch {
      return null;
    }
  };
  function themes(painted = () => {}) {
    const dark = matchMedia("(prefers-color-scheme: dark)");
    const system = () => (dark.matches ? "dark" : "light");
    const paint = (theme) => {
      root.dataset.theme = theme;
      painted();
    };
    one("#theme").addEventListener("click", () => {
      const other = root.dataset.theme === "dark" ? "light" : "dark";
      remember(other);
      paint(other);
    });
    dark.addEventListener("change", () => paint(remember() || system()));
    paint(remember() || system());
  }

  return { all, one, themes };
})();
