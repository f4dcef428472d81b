// The view `overview`: what happened in a run, or what a published set is, and its numbers. Bars lead to the objects.
"use strict";

const overview = (() => {
  const { make, foreign } = elements;
  const SHOWN = 10; // objects to begin with
  const WORST = 5; // largest errors that are listed

  // Objects to begin with: evenly out of all that have a picture.
  function some(entries) {
    const shown = entries.filter((one) => one.thumb >= 0);
    const step = Math.max(1, shown.length / SHOWN);
    return Array.from({ length: Math.min(SHOWN, shown.length) }, (_, place) => shown[Math.floor(place * step)]);
  }

  function head(shelf) {
    const { counts, kind, publication, title } = shelf.data;
    const picked = some(shelf.entries);
    const text = publication
      ? publication.description
      : "Every body rings by its own vibration modes, computed from its shape and a material. Pick one and strike it.";
    return make(
      "section.opening",
      make(
        "h1",
        { tabindex: "-1" },
        kind === "dataset" ? foreign(publication.name || title) : words.plural(counts.objects, "shape"),
        kind === "run" && make("span.second", "to strike and to hear."),
      ),
      make("p.intro", text),
      make(
        "ul.picked",
        { "aria-label": "Some of the objects" },
        picked.map((entry) =>
          make(
            "li",
            make(
              "a",
              { href: elements.link("object", entry.id) },
              elements.thumbnail(entry),
              foreign(entry.title, { title: entry.id }),
            ),
          ),
        ),
      ),
      make(
        "p",
        make("a.button", { href: elements.link("explore") }, `Explore all ${words.count(shelf.entries.length)}`),
      ),
    );
  }

  function tiles(shelf) {
    const { counts, materials } = shelf.data;
    const refused = counts.refused_objects + counts.refused_bodies;
    const warned = shelf.entries.filter((one) => one.warned).length;
    const tile = (count, name, state) =>
      make(
        "div",
        make("dt", name),
        make(
          "dd",
          state && count
            ? make("a", { href: elements.link("explore", "", { state }) }, words.count(count))
            : words.count(count),
        ),
      );
    return make(
      "dl.tiles",
      tile(counts.objects, counts.objects === 1 ? "object" : "objects"),
      tile(counts.bodies, counts.bodies === 1 ? "body" : "bodies"),
      tile(materials.length, materials.length === 1 ? "material" : "materials"),
      tile(counts.sounds, counts.sounds === 1 ? "sound" : "sounds"),
      tile(refused, "refused", "refused"),
      tile(warned, "with warnings", "with warnings"),
    );
  }

  function worst(shelf) {
    const rows = shelf.entries.flatMap((entry) =>
      Object.entries(entry.bodies).map(([solidity, body]) => ({ entry, solidity, body })),
    );
    const known = rows.filter((one) => one.body.error > 0).sort((a, b) => b.body.error - a.body.error);
    if (!known.length) return make("p.soft", "No errors are stated yet: the data of the page are not made.");
    const middle = known[Math.floor(known.length / 2)].body.error;
    return [
      make(
        "p.soft",
        `The estimated error of a body's worst frequency: ${words.percent(middle)} in the median body. The largest:`,
      ),
      plots.bars({
        rows: known.slice(0, WORST).map(({ entry, solidity, body }) => ({
          name: [elements.named(entry), " ", make("small", { class: solidity }, solidity)],
          value: body.error,
          said: words.percent(body.error),
          href: elements.link("object", entry.id, { solidity }),
        })),
      }),
      make("p", make("a", { href: elements.link("explore", "", { sort: "error" }) }, "All by error")),
    ];
  }

  function reasons(shelf) {
    const counts = new Map();
    for (const { refused } of shelf.entries) {
      for (const reason of new Set(refused.map((one) => one.reason))) counts.set(reason, (counts.get(reason) || 0) + 1);
    }
    return [...counts]
      .sort(([, a], [, b]) => b - a)
      .map(([reason, count]) => ({
        name: words.capital(shelf.data.reasons[reason]),
        value: count,
        said: words.count(count),
        href: elements.link("explore", "", { state: `refused: ${reason}` }),
      }));
  }

  function happened(shelf) {
    const { counts, validation } = shelf.data;
    const refusals = reasons(shelf);
    const warnings = shelf.data.warnings
      .filter((one) => one.count)
      .map((one) => ({
        name: words.capital(one.sentence),
        value: one.count,
        said: words.count(one.count),
        href: elements.link("explore", "", { state: `warning: ${one.kind}` }),
      }));
    const panel = (title, ...content) => make("div.panel", make("h3", title), content);
    const single = words.plural(counts.refused_bodies, "single body", "single bodies");
    const gone = `${words.plural(counts.refused_objects, "object")} and ${single}`;
    return make(
      "section",
      make("h2", "What happened"),
      make(
        "div.panels",
        panel(
          "Refused",
          make(
            "p.soft",
            refusals.length ? `${gone} could not be processed. Objects by reason:` : "Nothing was refused.",
          ),
          plots.bars({ rows: refusals }),
          refusals.length > 0 &&
            make("p", make("a", { href: elements.link("run", "", { part: "refusals" }) }, "What to do about it")),
        ),
        panel(
          "Accuracy",
          worst(shelf),
          validation &&
            make(
              "p.soft",
              validation.missed.length
                ? `Validation: ${words.plural(validation.missed.length, "tolerance")} missed. `
                : "Validation: every known frequency is within its tolerance. ",
              make("a", { href: elements.link("run", "", { part: "validation" }) }, "See it"),
            ),
        ),
        panel(
          "Warnings",
          make(
            "p.soft",
            warnings.length
              ? "Numbers to read with care; nothing was refused for them. They stand with their bodies, too."
              : "No body carries a warning.",
          ),
          plots.bars({ rows: warnings }),
          warnings.length > 0 &&
            make("p", make("a", { href: elements.link("run", "", { part: "warnings" }) }, "What they say")),
        ),
      ),
    );
  }

  // A sentence whose words in backticks are code.
  const coded = (text) => text.split("`").map((part, place) => (place % 2 ? make("code", part) : part));

  function copied(text, wrapped) {
    const button = make(
      "button",
      {
        type: "button",
        class: "quiet",
        async click() {
          try {
            await navigator.clipboard.writeText(text);
            elements.say("Copied");
            button.textContent = "Copied";
          } catch {
            getSelection().selectAllChildren(code); // where a page may not write to the clipboard
          }
        },
      },
      "Copy",
    );
    const code = make("code", text);
    return make(
      "div",
      { class: wrapped ? "snippet wrapped" : "snippet" },
      make("pre", { tabindex: "0", role: "group", "aria-label": "Text to copy" }, code),
      button,
    );
  }

  function publication(shelf) {
    const said = shelf.data.publication;
    if (!said) return null;
    const fact = (name, ...value) => make("div", make("dt", name), make("dd", value));
    const web = /^https?:\/\//.test(said.url);
    return make(
      "section",
      make("h2", "Use it"),
      make(
        "div.panels.two",
        make(
          "div.panel",
          make("h3", "Licence and citation"),
          make(
            "dl.facts",
            fact(
              said.licences.length === 1 ? "Licence" : "Licences of the sources",
              said.licences.map((one) => one || "not stated").join(", ") || "not stated",
            ),
            fact("Version", `${said.version}${said.published ? `, ${said.published}` : ""}`),
            said.url && fact("Address", web ? make("a", { href: said.url, rel: "noopener" }, said.url) : said.url),
          ),
          copied(said.citation, true),
        ),
        make("div.panel", make("h3", "Load it in Python"), copied(said.loader, false)),
        make(
          "div.panel.wide",
          make("h3", "Known limits"),
          make(
            "ul",
            said.limits.map((one) => make("li", coded(one))),
          ),
        ),
      ),
    );
  }

  function numbers(shelf, settings) {
    const place = Math.max(0, shelf.materials.indexOf(settings.get("material")));
    const material = shelf.materials[place];
    const values = (name, material_) =>
      shelf.solidities.map((solidity) => ({
        name: solidity,
        values: shelf.entries.flatMap((entry) =>
          catalogue.SPANS[name].of(entry, { material: material_ ?? place, solidity }),
        ),
      }));
    const href =
      (name, more = {}) =>
      (low, high) =>
        elements.link("explore", "", { ...more, [name]: `${low}..${high}` });
    const of = (name, title, note, more) =>
      plots.histogram({
        title,
        note,
        series: values(name),
        say: explore.SAY[name],
        href: href(name, { material }),
        ...more,
      });
    const spent = Object.entries(shelf.times.stages).map(([stage, [, seconds, middle]]) => ({
      name: stage,
      value: seconds,
      said: `${words.effort(seconds)}, ${words.effort(middle)} an object`,
      href: elements.link("explore", "", { dearest: stage }),
    }));
    return [
      of("f1", "Lowest frequency", `in ${material}`),
      of("density", "Modes over Weyl’s law", "1: as many as the volume alone predicts; thin walls have more", {
        mark: 1,
      }),
      plots.ridges({
        title: "Ring times by material",
        note: "of the lowest mode, to fall by 60 dB",
        say: words.duration,
        rows: shelf.materials.map((name, number) => ({
          name,
          series: values("ring", number),
          href: href("ring", { material: name }),
        })),
      }),
      of("volume", "Volume", ""),
      plots.bars({
        title: "Computing time by stage",
        note: "a bar leads to the objects on which that stage worked longest",
        rows: spent,
      }),
    ];
  }

  function view(shelf) {
    let drawn = null;
    const redraw = (settings) => drawn.replaceChildren(...numbers(shelf, settings).filter(Boolean));
    return {
      show(root, { settings }) {
        drawn = make("div.plots");
        const { kind, counts, empty_splits: empty } = shelf.data;
        const pick = make(
          "select",
          {
            change() {
              settings.set("material", pick.value);
              route.settle(settings);
              redraw(settings);
            },
          },
          shelf.materials.map((name) => make("option", { selected: name === settings.get("material") }, name)),
        );
        root.append(
          ...[
            head(shelf),
            tiles(shelf),
            empty && make("p.notice", make("strong", "Empty split "), empty),
            counts.sampled_sounds > 0 &&
              make(
                "p.soft",
                `${words.plural(counts.sampled_sounds, "sound is", "sounds are")} of sampled materials: not shown here.`,
              ),
            publication(shelf),
            kind === "run" ? happened(shelf) : null,
            counts.objects > 0 &&
              make(
                "section",
                make(
                  "div.heading",
                  make("h2", "In numbers"),
                  make(
                    "p.key",
                    shelf.solidities.map((name) => make("span", { class: name }, name)),
                  ),
                  shelf.materials.length > 1 && make("label.sort", make("span", "in"), pick),
                ),
                drawn,
              ),
          ].filter(Boolean),
        );
        if (counts.objects > 0) redraw(settings);
      },
      change({ settings }) {
        redraw(settings);
      },
    };
  }

  return { view };
})();
