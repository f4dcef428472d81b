// Numbers as people read them, and elements of the page. Texts from data become text, never HTML.
"use strict";

const texts = (() => {
  const LENGTHS = [
    [0.01, 1e-3, "mm"],
    [1, 1e-2, "cm"],
    [Infinity, 1, "m"],
  ];
  const MASSES = [
    [1e-3, 1e-6, "mg"],
    [1, 1e-3, "g"],
    [1e3, 1, "kg"],
    [Infinity, 1e3, "t"],
  ];
  const VOLUMES = [
    [1e-6, 1e-9, "mm³"],
    [1e-3, 1e-6, "cm³"],
    [1, 1e-3, "L"],
    [Infinity, 1, "m³"],
  ];
  const TIMES = [
    [1, 1e-3, "ms"],
    [Infinity, 1, "s"],
  ];

  // A number with so many significant digits and thousands separators; no exponent.
  function number(value, digits = 3) {
    if (!value) return "0";
    const decimals = digits - 1 - Math.floor(Math.log10(Math.abs(value)));
    const unit = 10 ** -decimals;
    const rounded = decimals < 0 ? Math.round(value / unit) * unit : value;
    const places = Math.min(Math.max(decimals, 0), 20);
    const text = rounded.toLocaleString("en-US", { minimumFractionDigits: places, maximumFractionDigits: places });
    return text.includes(".") ? text.replace(/\.?0+$/, "") : text;
  }

  function scaled(value, units, digits) {
    const [, unit, name] = units.find(([below]) => value < below);
    return `${number(value / unit, digits)}\u202f${name}`;
  }

  // A frequency to the digits that its relative error leaves, and one more.
  function hertz(value, error = 1e-4) {
    const digits = Math.min(7, Math.max(3, Math.ceil(-Math.log10(Math.max(error, 1e-9))) + 1));
    return `${number(value, digits)}\u202fHz`;
  }

  const percent = (share) => `${number(100 * share, 2)}\u202f%`;
  const decibels = (value) =>
    Number.isFinite(value) ? `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(1)}\u202fdB` : "silent";

  // An element with attributes (functions are listeners) and children, which may be texts, elements or nothing.
  function element(tag, attributes = {}, ...children) {
    const svg = ["svg", "line", "rect", "text", "g", "path"].includes(tag);
    const made = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
      if (typeof value === "function") made.addEventListener(name, value);
      else if (value === true) made.setAttribute(name, "");
      else if (value !== false && value !== null && value !== undefined) made.setAttribute(name, value);
    }
    made.append(...children.flat().filter((one) => one !== null && one !== undefined && one !== false));
    return made;
  }

  // Radio buttons side by side: [{value, text}]; `onchange` gets the value.
  function segments(label, name, options, chosen, onchange) {
    const choices = options.map(({ value, text, kind }) =>
      element(
        "label",
        { class: kind || "" },
        element("input", { type: "radio", name, value, checked: value === chosen, change: () => onchange(value) }),
        element("span", {}, text),
      ),
    );
    return element("fieldset", { class: "segments" }, element("legend", { class: "visually-hidden" }, label), choices);
  }

  function choose(fieldset, value) {
    for (const input of fieldset.querySelectorAll("input")) input.checked = input.value === value;
  }

  return {
    number,
    hertz,
    percent,
    decibels,
    length: (metres) => scaled(metres, LENGTHS),
    mass: (kilograms) => scaled(kilograms, MASSES),
    volume: (cubic) => scaled(cubic, VOLUMES),
    seconds: (value, digits) => scaled(value, TIMES, digits),
    element,
    segments,
    choose,
  };
})();

if (typeof module !== "undefined") module.exports = texts;
