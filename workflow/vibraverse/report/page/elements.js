// Elements of the page, made of texts and never of HTML, so that no title or message can become markup.
"use strict";

const elements = (() => {
  const SVG = "http://www.w3.org/2000/svg";
  const ACROSS = 10; // thumbnails across and down a sheet

  // An element, or a drawing, from "tag.class.class", attributes where there are any, and children. Functions among the
  // attributes are listeners; a value of false or null leaves an attribute out, or a child.
  function fill(create, kind, ...given) {
    const [tag, ...classes] = kind.split(".");
    const element = create(tag);
    if (classes.length) element.setAttribute("class", classes.join(" "));
    const attributes = given.length && Object.getPrototypeOf(given[0] ?? "") === Object.prototype ? given.shift() : {};
    for (const [name, value] of Object.entries(attributes)) {
      if (typeof value === "function") element.addEventListener(name, value);
      else if (value !== false && value !== null && value !== undefined)
        element.setAttribute(name, value === true ? "" : value);
    }
    element.append(...given.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false));
    return element;
  }
  const make = (...given) => fill((tag) => document.createElement(tag), ...given);
  const draw = (...given) => fill((tag) => document.createElementNS(SVG, tag), ...given);

  // A text that somebody else wrote, such as a title: it keeps its direction to itself.
  const foreign = (text, attributes) => make("bdi", attributes, text);

  // The title of an entry, and its id where that is another: siblings of a family share their title.
  function named(entry, attributes) {
    const title = foreign(entry.title, attributes);
    return entry.title === entry.id ? [title] : [title, " ", make("code.id", entry.id)];
  }

  // The thumbnail of an entry, cut out of its sheet; a plain tile where it has none.
  function thumbnail(entry) {
    const tile = make("span.thumb", { "aria-hidden": "true" });
    if (entry.thumb >= 0) {
      const place = entry.thumb % ACROSS ** 2;
      const part = (number) => `${(100 * number) / (ACROSS - 1)}%`;
      tile.style.backgroundImage = `url("${vibraverse.own(`thumbs-${Math.floor(entry.thumb / ACROSS ** 2)}.webp`)}")`;
      tile.style.backgroundPosition = `${part(place % ACROSS)} ${part(Math.floor(place / ACROSS))}`;
    }
    return tile;
  }

  const link = (view, subject, settings) =>
    route.format({ view, subject, settings: new URLSearchParams(settings || {}) });

  // Links of which the Tab key stops at one, and arrows go to the others.
  function rove(root, links) {
    links.forEach((link, place) => link.setAttribute("tabindex", place === 0 ? "0" : "-1"));
    root.addEventListener("keydown", (event) => {
      const here = links.indexOf(document.activeElement);
      const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
      const to = { Home: 0, End: links.length - 1 }[event.key] ?? (step === undefined ? -1 : here + step);
      if (here < 0 || to < 0 || to >= links.length) return;
      event.preventDefault();
      links[here].setAttribute("tabindex", "-1");
      links[to].setAttribute("tabindex", "0");
      links[to].focus();
    });
  }

  // A table from headings and rows; a cell is a text, an element or a list of them. `numbers` are the columns on the
  // right. Its links are one stop of the Tab key.
  function table(headings, rows, numbers = []) {
    const side = (place) => (numbers.includes(place) ? "right" : null);
    const head = headings.map((text, place) => make("th", { scope: "col", class: side(place) }, text));
    const body = rows.map((cells) =>
      make(
        "tr",
        cells.map((cell, place) =>
          place === 0
            ? make("th", { scope: "row" }, cell)
            : make("td", { class: side(place), "data-name": headings[place] }, cell),
        ),
      ),
    );
    const made = make(
      "table",
      { class: headings.length > 3 ? null : "stacked" },
      make("thead", make("tr", head)),
      make("tbody", body),
    );
    rove(made, [...made.querySelectorAll("a")]);
    // Columns may have to be scrolled, with the keyboard, too: it comes to the links, or to the table itself.
    return make(
      "div.scrolled",
      {
        ...(!made.querySelector("a") && { tabindex: "0", role: "group", "aria-label": headings.join(", ") }),
      },
      made,
    );
  }

  // Radio buttons side by side: [{value, text, kind}]; `onchange` gets the value.
  function segments(label, name, options, onchange) {
    const choices = options.map(({ value, text, kind }) =>
      make(
        "label",
        { class: kind },
        make("input", { type: "radio", name, value, change: () => onchange(value) }),
        make("span", text),
      ),
    );
    return make("fieldset.segments", make("legend.visually-hidden", label), choices);
  }

  function choose(fieldset, value) {
    for (const input of fieldset.querySelectorAll("input")) input.checked = input.value === value;
  }

  // Says something to screen readers.
  function say(text) {
    document.querySelector("#said").textContent = text;
  }

  return { make, draw, foreign, named, thumbnail, link, table, rove, segments, choose, say };
})();

if (typeof module !== "undefined") module.exports = elements;
