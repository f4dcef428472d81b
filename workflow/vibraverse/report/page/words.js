// Numbers as people read them: three significant digits and a suitable unit, as report/quantities.py writes them.
// Nothing here touches the page, so Node can run it, too.
"use strict";

const words = (() => {
  const LENGTHS = [
    [1e-2, 1e-3, "mm"],
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
  const FREQUENCIES = [
    [1e4, 1, "Hz"],
    [Infinity, 1e3, "kHz"],
  ];
  const TIMES = [
    [1, 1e-3, "ms"],
    [Infinity, 1, "s"],
  ];
  const SIZES = [
    [1e6, 1e3, "kB"],
    [1e9, 1e6, "MB"],
    [Infinity, 1e9, "GB"],
  ];

  // A number with this many significant digits, thousands separators and no exponent.
  function number(value, digits = 3) {
    if (!Number.isFinite(value)) return "–";
    return Number(value.toPrecision(digits)).toLocaleString("en", { maximumFractionDigits: 20 });
  }
  const scaled = (units) => (value, digits) => {
    const [, unit, name] = units.find(([below]) => value < below);
    return `${number(value / unit, digits)}\u202f${name}`;
  };

  // A frequency to the digits that its relative error leaves, and one more.
  function hertz(value, error = 1e-4) {
    const digits = Math.min(7, Math.max(3, Math.ceil(-Math.log10(Math.max(error, 1e-9))) + 1));
    return `${number(value, digits)}\u202fHz`;
  }

  const count = (value) => value.toLocaleString("en");
  const plural = (value, one, many = `${one}s`) => `${count(value)} ${value === 1 ? one : many}`;
  const percent = (value, digits = 2) => `${number(100 * value, digits)}\u202f%`;
  const decibels = (value) =>
    Number.isFinite(value) ? `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(1)}\u202fdB` : "silent";
  const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);

  // Seconds of computing: from milliseconds to hours.
  function effort(seconds) {
    if (seconds < 90) return scaled(TIMES)(seconds);
    return seconds < 5400 ? `${number(seconds / 60)}\u202fmin` : `${number(seconds / 3600)}\u202fh`;
  }

  // A span of a quantity whose ends may be open.
  function between([low, high], say) {
    if (low === -Infinity) return `up to ${say(high)}`;
    return high === Infinity ? `from ${say(low)}` : `${say(low)} to ${say(high)}`;
  }

  return {
    number,
    count,
    plural,
    percent,
    decibels,
    hertz,
    capital,
    effort,
    between,
    length: scaled(LENGTHS),
    mass: scaled(MASSES),
    volume: scaled(VOLUMES),
    frequency: scaled(FREQUENCIES),
    duration: scaled(TIMES),
    fileSize: scaled(SIZES),
  };
})();

if (typeof module !== "undefined") module.exports = words;
