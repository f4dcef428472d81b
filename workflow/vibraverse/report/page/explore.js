// The view `explore`: all objects, refused ones included, with filters that stand in the address.
"use strict";

const explore = (() => {
  const { make, foreign } = elements;
  const CELL = { width: 290, height: 134, gap: 12 };
  const HOVER_MS = 90; // a pointer that only passes by asks for nothing
  const QUICK_MS = 120; // a pause in typing
  const LEVEL_DB = -12; // of the loudest moment of what is heard here
  const SAY = {
    f1: words.frequency,
    ring: words.duration,
    size: words.length,
    volume: words.volume,
    density: (value) => `${words.number(value)}×`,
    error: words.percent,
  };
  const scrolled = new Map(); // how far each address was scrolled, to come back to

  // What a value of a facet is called: states say their reason or kind in words.
  function called(shelf, name, value) {
    if (name !== "state") return value;
    const [what, which] = value.split(": ");
    if (!which) return words.capital(what);
    const kind = shelf.data.warnings.find((one) => one.kind === which);
    return `${words.capital(what)}: ${shelf.data.reasons[which] || (kind && kind.sentence) || which}`;
  }

  function frequencies(entry, seen) {
    return Object.entries(entry.bodies)
      .filter(([solidity, body]) => body.f1[seen.material] > 0 && (!seen.solidity || seen.solidity === solidity))
      .map(([solidity, body]) => make("span", { class: solidity }, words.frequency(body.f1[seen.material])));
  }

  // What to know of an object's bodies, in short and in full.
  function noted(entry, shelf) {
    const missing = entry.refused.filter((one) => one.solidity);
    const kinds = shelf.data.warnings.filter((_, bit) => (entry.warned >> bit) & 1);
    const short = [
      ...missing.map((one) => `no ${one.solidity} body`),
      kinds.length && words.plural(kinds.length, "warning"),
    ];
    const full = [
      ...missing.map(
        (one) => `No ${one.solidity} body: ${shelf.data.reasons[one.reason]}. ${one.message} ${one.advice}`,
      ),
      ...kinds.map((one) => `Warning: ${one.sentence}.`),
    ];
    return { short: short.filter(Boolean).join(" · "), full: full.join(" ") };
  }

  // An object as a link with its thumbnail and its numbers; a refused one says why, and what to do.
  function card(entry, seen, shelf) {
    const settings = shelf.materials.length > 1 ? { material: shelf.materials[seen.material] } : {};
    if (seen.solidity) settings.solidity = seen.solidity;
    const name = elements.named(entry, { class: "name" });
    const whole = entry.refused.find((one) => !one.solidity) || (!Object.keys(entry.bodies).length && entry.refused[0]);
    const href = elements.link("object", entry.id, settings);
    if (whole) {
      const why = words.capital(shelf.data.reasons[whole.reason]);
      const said = `${why}, at ${whole.stage}. ${whole.message} ${whole.advice}`;
      return make(
        "a.item.gone",
        { href, title: said },
        make(
          "span.text",
          make("span.title", name, make("small", "refused")),
          make("b", why),
          foreign(`${whole.message} ${whole.advice}`, { class: "why" }),
        ),
      );
    }
    const rings = catalogue.SPANS.ring.of(entry, seen);
    const facts = [
      entry.size ? words.length(entry.size) : "",
      rings.length ? `rings ${words.duration(Math.max(...rings))}` : "",
    ];
    const note = noted(entry, shelf);
    return make(
      "a.item",
      { href, title: note.full || null },
      elements.thumbnail(entry),
      make(
        "span.text",
        name,
        make("span.pitch", frequencies(entry, seen)),
        make("span.soft", facts.filter(Boolean).join(" · ")),
        note.short && make("span.note", note.short),
      ),
    );
  }

  // The sound of an object where it is struck everywhere alike, from its own file.
  async function heard(entry, seen, shelf) {
    const data = await vibraverse.loadObject(entry.id, entry.version);
    const body = seen.solidity || Object.keys(data.bodies)[0];
    const material = shelf.materials[seen.material];
    if (!data.bodies[body] || !data.materials[material]) return null;
    const choices = { ...share.read(new URLSearchParams({ body, material }), data), place: null };
    const { samples, rate, peak } = struck.sound(data, struck.modes(data, null, choices), choices);
    return peak > 0 ? { samples, rate, gain_db: LEVEL_DB - 20 * Math.log10(peak) } : null;
  }

  // A switch after which objects sound while the pointer or the focus is on them.
  function hearing(shelf, look) {
    let on = false;
    let waiting = 0;
    let voice = null;
    const stop = () => {
      clearTimeout(waiting);
      if (voice) voice.stop();
      voice = null;
    };
    const button = make(
      "button",
      {
        type: "button",
        class: "quiet",
        "aria-pressed": "false",
        title: "Every sound is made equally loud here",
        click() {
          on = !on;
          button.setAttribute("aria-pressed", on);
          if (on) sound.unlock();
          else stop();
        },
      },
      "Hear on hover",
    );
    return {
      button,
      stop,
      over(entry) {
        if (!on || !entry.version) return;
        stop();
        waiting = setTimeout(async () => {
          const mine = waiting;
          try {
            const made = await heard(entry, look(), shelf);
            if (made && mine === waiting) voice = sound.play(made);
          } catch (error) {
            elements.say(error.message);
          }
        }, HOVER_MS);
      },
    };
  }

  function facet(name, title, choose) {
    const select = make("select", { name, change: () => choose(name, select.value) });
    const label = make("label.facet", make("span", title), select);
    // Offers values with their counts; hides the facet where there is nothing to choose.
    const offer = (values, chosen, any, say = (value) => value, more = 0) => {
      const options = values.map(([value, count]) =>
        make(
          "option",
          { value, selected: value === chosen },
          count === null ? say(value) : `${say(value)} (${words.count(count)})`,
        ),
      );
      if (any !== null) options.unshift(make("option", { value: "", selected: !chosen }, any));
      if (more) options.push(make("option", { disabled: true }, `… ${words.count(more)} more: use the search`));
      select.replaceChildren(...options);
      label.hidden = values.length < 2 && !chosen;
    };
    return { label, offer };
  }

  function range(name, choose) {
    const { name: title, unit } = catalogue.SPANS[name];
    const send = () => {
      const [low, high] = ends.map((input) => input.value.trim());
      choose(name, low === "" && high === "" ? "" : `${low}..${high}`);
    };
    const ends = ["from", "to"].map((which) =>
      make("input", {
        type: "number",
        min: "0",
        step: "any",
        placeholder: which,
        "aria-label": `${title} ${which}, in ${unit}`,
        change: send,
      }),
    );
    const root = make("fieldset.range", make("legend", title, " ", make("small", unit)), make("span", ends));
    const set = (found) =>
      ends.forEach((input, place) => {
        input.value = found && Number.isFinite(found[place]) ? found[place] : "";
      });
    return { root, set };
  }

  function view(shelf) {
    let parts = null;
    let settings = null;
    let wanted = null;
    let typing = 0;
    let left = null; // the object that one went to from here

    function choose(name, value) {
      if (value) settings.set(name, value);
      else settings.delete(name);
      route.settle(settings);
      refresh();
    }

    function chips() {
      const chip = (name, text) =>
        make(
          "button",
          {
            type: "button",
            class: "chip",
            "aria-label": `Remove the filter ${text}`,
            click: () => choose(name, ""),
          },
          foreign(text),
          make("span", { "aria-hidden": "true" }, "×"),
        );
      return [
        ...(wanted.words.length ? [chip("q", `“${settings.get("q")}”`)] : []),
        ...(wanted.seen.solidity ? [chip("solidity", wanted.seen.solidity)] : []),
        ...Object.entries(wanted.values).map(([name, value]) => chip(name, called(shelf, name, value))),
        ...Object.entries(wanted.spans).map(([name, ends]) =>
          chip(name, `${catalogue.SPANS[name].name}: ${words.between(ends, SAY[name])}`),
        ),
      ];
    }

    function refresh() {
      wanted = catalogue.asked(settings, shelf);
      const found = catalogue.choose(shelf, wanted);
      for (const name of Object.keys(catalogue.FACETS)) {
        const { values, more } = catalogue.offered(shelf, wanted, name);
        parts.facets[name].offer(values, wanted.values[name] || "", "All", (value) => called(shelf, name, value), more);
      }
      const all = (texts) => texts.map((text) => [text, null]);
      parts.facets.material.offer(all(shelf.materials), shelf.materials[wanted.seen.material], null);
      parts.facets.solidity.offer(all(shelf.solidities), wanted.seen.solidity, "Both");
      for (const [name, { set }] of Object.entries(parts.ranges)) set(wanted.spans[name]);
      for (const option of parts.sort.options) option.selected = option.value === wanted.sort;
      if (document.activeElement !== parts.find) parts.find.value = settings.get("q") || "";
      const chosen = chips();
      parts.chips.replaceChildren(...chosen);
      const total = shelf.entries.length;
      const count =
        found.length === total
          ? words.plural(total, "object")
          : `${words.count(found.length)} of ${words.plural(total, "object")}`;
      const refused = found.filter((entry) => entry.refused.length).length;
      parts.count.textContent = refused ? `${count}, ${words.count(refused)} refused in whole or in part` : count;
      parts.none.hidden = found.length > 0;
      parts.reset.hidden = chosen.length === 0;
      parts.grid.set(found, Math.max(0, found.indexOf(left)));
      if (parts.grid.root.getBoundingClientRect().top < 0) scrollTo({ top: 0, behavior: "instant" });
    }

    function build(root) {
      const again = () => {
        for (const name of [...settings.keys()]) if (!["material", "sort"].includes(name)) settings.delete(name);
        parts.find.value = "";
        choose("q", "");
        parts.find.focus();
      };
      const listen = hearing(shelf, () => wanted.seen);
      const drawn = (entry) => {
        const item = card(entry, wanted.seen, shelf);
        item.addEventListener("pointerenter", (event) => event.pointerType === "mouse" && listen.over(entry));
        item.addEventListener("focus", () => listen.over(entry));
        item.addEventListener("pointerleave", listen.stop);
        return item;
      };
      const find = make("input", {
        type: "search",
        placeholder: "Find an object",
        "aria-label": "Find an object by name, family or source",
        autocomplete: "off",
        input() {
          clearTimeout(typing);
          typing = setTimeout(() => choose("q", find.value.trim()), QUICK_MS);
        },
      });
      const names = Object.entries(catalogue.SORTS).map(([value, { name }]) => make("option", { value }, name));
      const sort = make("select", { change: () => choose("sort", sort.value === "name" ? "" : sort.value) }, names);
      const facets = Object.fromEntries([
        ["material", facet("material", "Numbers in", choose)],
        ["solidity", facet("solidity", "Body", choose)],
        ...Object.entries(catalogue.FACETS).map(([name, { name: title }]) => [name, facet(name, title, choose)]),
      ]);
      const ranges = Object.fromEntries(["f1", "ring", "size"].map((name) => [name, range(name, choose)]));
      parts = {
        find,
        sort,
        facets,
        ranges,
        listen,
        chips: make("div.chips"),
        count: make("p.count-line", { role: "status" }),
        none: make(
          "p.empty",
          { hidden: true },
          "No object fits. Take a filter away, or ",
          make("button", { type: "button", class: "quiet", click: again }, "show all objects"),
        ),
        reset: make("button", { type: "button", class: "plain", click: again }, "Clear filters"),
        grid: grid.build("Objects", CELL, drawn),
      };
      const choices = make(
        "details.choices",
        { open: matchMedia("(min-width: 861px)").matches },
        make("summary", "Filters"),
        Object.values(facets).map((one) => one.label),
        Object.values(ranges).map((one) => one.root),
      );
      root.append(
        make("h1.visually-hidden", { tabindex: "-1" }, "Explore the objects"),
        make(
          "div.explore",
          make(
            "form.side",
            {
              role: "search",
              "aria-label": "Filters",
              submit: (event) => event.preventDefault(),
            },
            find,
            choices,
          ),
          make(
            "div.found",
            make("div.tools", parts.count, listen.button, make("label.sort", make("span", "Sort by"), sort)),
            make("div.chosen", parts.chips, parts.reset),
            parts.none,
            parts.grid.root,
          ),
        ),
      );
    }

    return {
      show(root, { settings: given }) {
        settings = given;
        build(root);
        refresh();
        parts.grid.start();
        scrollTo({ top: scrolled.get(location.hash) || 0, behavior: "instant" });
      },
      change({ settings: given }) {
        settings = given;
        refresh();
      },
      leave() {
        clearTimeout(typing);
        left = parts.grid.current();
        scrolled.set(route.format({ view: "explore", settings }), scrollY);
        parts.listen.stop();
        parts.grid.stop();
      },
    };
  }

  return { view, SAY, called };
})();
