// Buttons that strike without pointing: everywhere alike, at the stored points, at places with names.
"use strict";

const places = (() => {
  const SAME = 1e-4; // in mesh units
  const { make } = elements;

  const isAt = (place, at) => place.position.every((one, axis) => Math.abs(one - at[axis]) < SAME);

  // The places of a body with names; none before it is loaded.
  function named(body) {
    if (body && !body.named) body.named = points.named(body);
    return body ? body.named : [];
  }

  // What to call a place: its name, or its coordinates in mesh units.
  function nameOf(body, at) {
    const near = named(body).find((place) => isAt(place, at));
    return near ? near.name : at.map((one) => words.number(one, 2)).join(", ");
  }

  // Returns {element, show(body, stored, choices)}; `strike` gets {everywhere}, {stored} or {place}.
  function create(strike) {
    const root = make("div.places", { role: "toolbar", "aria-label": "Strike at" });

    function show(body, stored, choices) {
      const options = [{ text: "everywhere", on: !choices.at, to: { everywhere: true } }];
      stored.forEach(({ point }, number) =>
        options.push({ text: `point ${point + 1}`, on: choices.stored === number, to: { stored: number } }),
      );
      for (const { name, ...place } of named(body)) {
        const on = Boolean(choices.at) && choices.stored === null && isAt(place, choices.at);
        options.push({ text: name, on, to: { place } });
      }
      // One button is in the order of the tab key; arrows go to the others.
      const focused = root.contains(document.activeElement) ? document.activeElement.textContent : null;
      const wanted = options.findIndex(({ text, on }) => (focused ? text === focused : on));
      const current = Math.max(0, wanted);
      const buttons = options.map(({ text, on, to }, number) => {
        const tabindex = number === current ? 0 : -1;
        const listeners = { click: () => strike(to), keydown: rove };
        return make("button", { type: "button", "aria-pressed": String(on), tabindex, ...listeners }, text);
      });
      root.replaceChildren(...buttons);
      if (focused) buttons[current].focus();
    }

    function rove(event) {
      const step = { ArrowLeft: -1, ArrowUp: -1, ArrowRight: 1, ArrowDown: 1 }[event.key];
      if (!step) return;
      event.preventDefault();
      const all = [...root.children];
      const next = all[(all.indexOf(event.target) + step + all.length) % all.length];
      all.forEach((one) => (one.tabIndex = one === next ? 0 : -1));
      next.focus();
    }

    return { element: root, show };
  }

  return { create, nameOf };
})();
