// The numbers of a material, the size and the striker: a slider, a number with its unit, and a way back for each.
"use strict";

const controls = (() => {
  const STEPS = 1000; // of a slider
  const { make } = elements;
  //: key, sign, what it is, unit and its size, range of the slider, whether 0 is allowed, what it does to the sound
  const ROWS = [
    [
      "young",
      "E",
      "Young’s modulus",
      "GPa",
      1e9,
      0.1,
      1000,
      false,
      "Stiffer sounds higher: four times E doubles every frequency.",
    ],
    [
      "density",
      "ρ",
      "Density",
      "kg/m³",
      1,
      20,
      25000,
      false,
      "Heavier sounds lower: four times ρ halves every frequency.",
    ],
    [
      "poisson",
      "ν",
      "Poisson’s ratio",
      "",
      1,
      0,
      0.5,
      false,
      "How much it bulges when pressed. It moves modes against each other.",
    ],
    ["alpha", "α", "Slow damping", "1/s", 1, 0.01, 1000, true, "Takes away low frequencies first."],
    [
      "beta",
      "β",
      "Fast damping",
      "µs",
      1e-6,
      1e-3,
      1000,
      true,
      "Takes away high frequencies first: metal little, wood much.",
    ],
    ["size", "L", "Longest side", "cm", 1e-2, 0.5, 500, false, "Twice the size halves every frequency."],
    [
      "contact",
      "τ",
      "Contact",
      "ms",
      1e-3,
      0.05,
      10,
      true,
      "How long the striker touches. A soft one touches longer and sounds duller.",
    ],
  ];

  // Returns {element, set(values, presets), stops(list)}. `onchange` gets a key and its value in SI units.
  function create(onchange) {
    const rows = new Map(ROWS.map((row) => [row[0], made(row, onchange)]));
    return {
      element: make(
        "div.numbers",
        [...rows.values()].map((row) => row.element),
      ),
      set(values, presets) {
        for (const [key, row] of rows) row.set(values[key], presets[key]);
      },
      // The values of Poisson's ratio that a body has; null while it is not loaded.
      stops: (list) => rows.get("poisson").stops(list),
    };
  }

  function made([key, sign, name, unit, size, low, high, zero, about], onchange) {
    let preset = null;
    let stops = null;
    const slider = make("input", { type: "range", min: 0, max: STEPS, "aria-label": name });
    const number = make("input", {
      type: "number",
      step: "any",
      min: 0,
      "aria-label": unit ? `${name} in ${unit}` : name,
    });
    const reset = make(
      "button",
      {
        type: "button",
        class: "back",
        title: `Back to the material's own ${name}`,
        "aria-label": `Reset ${name}`,
        hidden: true,
      },
      "↺",
    );
    const root = make(
      "div.number",
      { title: about },
      make("span.sign", sign),
      make("span.name", name),
      slider,
      make("span.amount", number, make("small", unit)),
      reset,
    );
    const discrete = key === "poisson";

    const fromSlider = (place) => {
      if (discrete) return stops[Math.min(place, stops.length - 1)];
      if (zero && place === 0) return 0;
      return Number((low * (high / low) ** (place / STEPS)).toPrecision(3)) * size;
    };
    const toSlider = (value) => {
      if (discrete) return stops ? nearest(stops, value) : 0;
      const share = Math.log(Math.max(value / size, low) / low) / Math.log(high / low);
      return zero && value === 0 ? 0 : Math.min(STEPS, Math.max(zero ? 1 : 0, Math.round(STEPS * share)));
    };

    slider.addEventListener("input", () => onchange(key, fromSlider(Number(slider.value))));
    number.addEventListener("change", () => {
      const value = Number(number.value) * size;
      const fine = number.value !== "" && Number.isFinite(value) && (value > 0 || (zero && value === 0));
      number.setCustomValidity(fine ? "" : `${name} must be a number above 0${zero ? ", or 0" : ""}`);
      number.reportValidity();
      if (fine) onchange(key, discrete && stops ? stops[nearest(stops, value)] : value);
    });
    reset.addEventListener("click", () => {
      onchange(key, preset);
      number.focus();
    });

    return {
      element: root,
      set(value, own) {
        preset = own;
        number.value = Number((value / size).toPrecision(6));
        number.setCustomValidity("");
        slider.value = toSlider(value);
        slider.setAttribute("aria-valuetext", `${number.value} ${unit}`);
        reset.hidden = value === own;
        root.classList.toggle("changed", value !== own);
      },
      stops(list) {
        stops = list;
        slider.max = list ? list.length - 1 : STEPS;
        slider.disabled = number.disabled = !list;
        if (list) slider.value = toSlider(Number(number.value));
      },
    };
  }

  function nearest(stops, value) {
    return stops.reduce(
      (best, stop, place) => (Math.abs(stop - value) < Math.abs(stops[best] - value) ? place : best),
      0,
    );
  }

  return { create };
})();
