// Views of an object in place of a model, where the browser has no WebGL or the page no library.
"use strict";

const still = (() => {
  const ACROSS = 3; // views in a row of the file
  const { make } = elements;

  // An element with the views of an object, if there are any, a slider that turns them, and a text.
  function create(data, text) {
    const why = text ? make("p.note", text) : null;
    if (!data.turn) return make("div.still", why);
    const { title } = data.facts;
    const frame = make("div.frame", { role: "img", "aria-label": `Views of ${title}` });
    const rows = Math.ceil(data.turn_frames / ACROSS);
    frame.style.backgroundImage = `url("data/objects/${encodeURIComponent(data.turn)}")`;
    frame.style.backgroundSize = `${100 * ACROSS}% ${100 * rows}%`;
    const turnTo = (number) => {
      const across = (100 * (number % ACROSS)) / (ACROSS - 1);
      const down = rows > 1 ? (100 * Math.floor(number / ACROSS)) / (rows - 1) : 0;
      frame.style.backgroundPosition = `${across}% ${down}%`;
    };
    turnTo(0);
    const input = (event) => turnTo(Number(event.target.value));
    const range = { type: "range", min: 0, max: data.turn_frames - 1, value: 0, "aria-label": `Turn ${title}`, input };
    return make("div.still", frame, make("input", range), why);
  }

  return { create };
})();
