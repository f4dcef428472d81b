// A grid of thousands of links of which only those in sight are in the document. It is one stop of the Tab key: arrows
// move within it, Home and End go to its ends.
"use strict";

const grid = (() => {
  const SPARE = 2; // rows above and below those in sight

  // `cell` is {width, height, gap} in pixels, the width at least; `draw(item)` returns the link of an item.
  function build(label, cell, draw) {
    const hint = elements.make(
      "p",
      { id: "grid-hint", class: "visually-hidden" },
      "Arrow keys move from object to object.",
    );
    const list = elements.make("ul.grid", { "aria-label": label, "aria-describedby": "grid-hint" });
    const root = elements.make("div", hint, list);
    const shown = new Map(); // list items by number
    let items = [];
    let columns = 1;
    let current = 0;
    let waiting = 0;

    const top = (number) => Math.floor(number / columns) * (cell.height + cell.gap);
    const rowsInSight = () => Math.max(1, Math.floor(innerHeight / (cell.height + cell.gap)));

    function place(item, number) {
      const wide = (list.clientWidth + cell.gap) / columns - cell.gap;
      item.style.width = `${wide}px`;
      item.style.height = `${cell.height}px`;
      item.style.transform = `translate(${(number % columns) * (wide + cell.gap)}px, ${top(number)}px)`;
    }

    function add(number) {
      const link = draw(items[number]);
      link.tabIndex = number === current ? 0 : -1;
      const item = elements.make("li", { "aria-posinset": number + 1, "aria-setsize": items.length }, link);
      place(item, number);
      // In the order of the numbers, as a screen reader walks through the list.
      const next = [...shown.keys()].filter((one) => one > number).sort((a, b) => a - b)[0];
      list.insertBefore(item, next === undefined ? null : shown.get(next));
      shown.set(number, item);
    }

    function render() {
      waiting = 0;
      if (!list.isConnected) return;
      const above = -list.getBoundingClientRect().top;
      const high = cell.height + cell.gap;
      const first = Math.max(0, Math.floor(above / high) - SPARE) * columns;
      const last = Math.min(items.length, (Math.ceil((above + innerHeight) / high) + SPARE) * columns);
      const kept = (number) => (number >= first && number < last) || (number === current && number < items.length);
      for (const [number, item] of shown) {
        if (kept(number)) continue;
        item.remove();
        shown.delete(number);
      }
      for (let number = first; number < last; number += 1) if (!shown.has(number)) add(number);
      if (current < items.length && !shown.has(current)) add(current);
    }
    const soon = () => {
      waiting ||= requestAnimationFrame(render);
    };

    function measure() {
      columns = Math.max(1, Math.floor((list.clientWidth + cell.gap) / (cell.width + cell.gap)));
      list.style.height = `${Math.max(0, Math.ceil(items.length / columns) * (cell.height + cell.gap) - cell.gap)}px`;
      for (const [number, item] of shown) place(item, number);
      render();
    }

    function move(to) {
      const number = Math.min(items.length - 1, Math.max(0, to));
      if (number === current) return;
      if (shown.has(current)) shown.get(current).firstChild.tabIndex = -1;
      current = number;
      if (!shown.has(number)) add(number);
      const link = shown.get(number).firstChild;
      link.tabIndex = 0;
      link.focus({ preventScroll: true });
      shown.get(number).scrollIntoView({ block: "nearest" });
      soon();
    }

    list.addEventListener("keydown", (event) => {
      if (event.altKey || event.ctrlKey || event.metaKey) return;
      const page = columns * rowsInSight();
      const steps = {
        ArrowRight: 1,
        ArrowLeft: -1,
        ArrowDown: columns,
        ArrowUp: -columns,
        PageDown: page,
        PageUp: -page,
      };
      const to =
        { Home: 0, End: items.length - 1 }[event.key] ?? (event.key in steps ? current + steps[event.key] : null);
      if (to === null) return;
      event.preventDefault();
      move(to);
    });
    list.addEventListener("focusin", (event) => {
      const found = [...shown].find(([, item]) => item.contains(event.target));
      if (!found || found[0] === current) return;
      if (shown.has(current)) shown.get(current).firstChild.tabIndex = -1;
      [current] = found;
      found[1].firstChild.tabIndex = 0;
    });

    const resized = new ResizeObserver(measure);
    return {
      root,
      // The item that the Tab key stops at.
      current: () => items[current],
      // Shows these items; the Tab key stops at the first of them or at another one.
      set(given, stop = 0) {
        items = given;
        current = stop;
        for (const item of shown.values()) item.remove();
        shown.clear();
        measure();
      },
      start() {
        addEventListener("scroll", soon, { passive: true });
        resized.observe(list);
      },
      stop() {
        removeEventListener("scroll", soon);
        resized.disconnect();
      },
    };
  }

  return { build };
})();
