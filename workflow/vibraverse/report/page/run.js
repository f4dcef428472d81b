// The view `run`: refusals with what to do, warnings, validation, and how everything was made. One part at a time.
"use strict";

const run = (() => {
  const { make, foreign } = elements;
  const ROWS = 60; // of all reasons together
  const FEWEST = 3;

  // The folder of the results, where a page that is opened from disk knows it; as one word for a shell.
  function results() {
    if (location.protocol !== "file:") return "";
    const path = decodeURIComponent(location.pathname).replace(/\/[^/]*\/[^/]*$/, "");
    return /^[\w@%+=:,./-]+$/.test(path) ? path : `'${path.replaceAll("'", `'"'"'`)}'`;
  }

  function name(shelf, id, solidity) {
    const entry = shelf.entries.find((one) => one.id === id);
    const link = make(
      "a",
      { href: elements.link("object", id, solidity ? { solidity } : {}) },
      entry ? foreign(entry.title) : id,
    );
    const which = entry && entry.title !== id ? [" ", make("code.id", id)] : [];
    return [link, which, solidity ? [" ", make("small", { class: solidity }, solidity)] : []];
  }

  function more(count, shown, settings) {
    return (
      count > shown &&
      make("p", make("a", { href: elements.link("explore", "", settings) }, `All ${words.count(count)} in Explore`))
    );
  }

  function refusals(shelf) {
    const groups = new Map();
    for (const entry of shelf.entries) {
      for (const one of entry.refused) {
        if (!groups.has(one.reason)) groups.set(one.reason, []);
        groups.get(one.reason).push({ entry, one });
      }
    }
    const share = Math.max(FEWEST, Math.floor(ROWS / Math.max(1, groups.size)));
    const sorted = [...groups].sort(([, a], [, b]) => b.length - a.length);
    if (!sorted.length) return [make("p.soft", "Nothing was refused.")];
    const known = results();
    const command = shelf.data.kind === "run" && [
      make(
        "p",
        "Put it right, then this makes it run again",
        known ? ":" : [", with the folder that holds ", make("code", "report/"), " in the place of RESULTS:"],
      ),
      make(
        "pre",
        { tabindex: "0", role: "group", "aria-label": "The command that retries" },
        make("code", { id: "retry" }, `vibraverse refusals --results ${known || "RESULTS"} --retry`),
      ),
    ];
    return [
      make("p.soft", "What could not be processed, why, and what to do about it."),
      command,
      sorted.map(([reason, rows]) =>
        make(
          "div.panel",
          make("h3", words.capital(shelf.data.reasons[reason]), " ", make("span.count", words.count(rows.length))),
          elements.table(
            ["object", "refused by", "what is wrong, and what to do"],
            rows
              .slice(0, share)
              .map(({ entry, one }) => [
                name(shelf, entry.id, one.solidity),
                one.stage,
                [foreign(one.message), " ", make("span.soft", foreign(one.advice))],
              ]),
          ),
          more(rows.length, share, { state: `refused: ${reason}` }),
        ),
      ),
    ];
  }

  function warnings(shelf) {
    const kinds = shelf.data.warnings.filter((one) => one.count);
    if (!kinds.length) return [make("p.soft", "No body carries a warning.")];
    return [
      make("p.soft", "Each says a number, its threshold and what to do. Nothing was refused for them."),
      kinds.map((kind) =>
        make(
          "div.panel",
          make("h3", words.capital(kind.sentence), " ", make("span.count", words.count(kind.count))),
          elements.table(
            ["object", "what it says"],
            kind.shown.map(([id, solidity, text]) => [name(shelf, id, solidity), foreign(text)]),
          ),
          more(kind.count, kind.shown.length, { state: `warning: ${kind.kind}` }),
        ),
      ),
    ];
  }

  function validation(shelf) {
    const bodies = Object.values(shelf.data.validation.bodies);
    const curves = bodies.flatMap((body) => Object.values(body.convergence));
    const span = (values, margin) => [Math.min(...values) / margin, Math.max(...values) * margin];
    const limits = {
      unknowns: span(
        curves.flatMap((one) => one.unknowns),
        1.3,
      ),
      errors: span(
        curves.flatMap((one) => one.errors),
        1.5,
      ),
    };
    const rows = bodies.flatMap((body) =>
      body.summary.map((line) => [
        body.title,
        line.elements,
        words.count(line.unknowns),
        words.count(line.frequencies),
        make("span", { class: line.missed ? "missed" : null }, words.percent(line.largest_error)),
        words.percent(line.tolerance, 3),
        line.source,
      ]),
    );
    return [
      make(
        "p.soft",
        "Bodies whose frequencies are known, by the path of every object: how errors fall with the unknowns, ",
        "for ",
        make("span.hollow", "linear (P1)"),
        " and ",
        make("span.solid", "quadratic (P2)"),
        " elements, with the power of each curve; in theory −2⁄3 and −4⁄3. Dotted: as the elements give it. Full: ",
        "corrected, as objects are by default.",
      ),
      shelf.data.validation.missed.map((said) => make("p.notice", make("strong", "Missed "), said)),
      make(
        "div.plots.small",
        bodies.map((body) =>
          make("figure.plot", make("figcaption", make("strong", body.title)), plots.convergence(body, limits)),
        ),
      ),
      make(
        "div.panel",
        elements.table(
          ["body", "elements", "unknowns", "frequencies", "largest error", "accepted", "against"],
          rows,
          [2, 3, 4, 5],
        ),
      ),
    ];
  }

  function making(shelf) {
    const { stages, materials, shards, splits } = shelf.data;
    const pair = ([key, value]) => make("span.pair", make("b", key), ` ${value} `);
    const pairs = (list) => (list.length ? list.map(pair) : "–");
    const number = (value) => words.number(value);
    return [
      make(
        "div.panel",
        make("h3", "Stages"),
        elements.table(
          ["stage", "options", "libraries"],
          Object.entries(stages).map(([stage, how]) => [
            [stage, " ", make("small", `v${how.version}`)],
            pairs(how.options),
            pairs(how.libraries),
          ]),
        ),
      ),
      make(
        "div.panels.two",
        make(
          "div.panel",
          make("h3", "Materials"),
          elements.table(
            ["name", "ρ kg/m³", "E GPa", "ν", "α 1/s", "β s"],
            materials.map((one) => [
              one.name,
              number(one.density),
              number(one.young / 1e9),
              number(one.poisson),
              number(one.alpha),
              one.beta.toExponential(1),
            ]),
            [1, 2, 3, 4, 5],
          ),
        ),
        make(
          "div.panel",
          make("h3", "Files"),
          elements.table(
            ["shard", "size", "SHA-256"],
            Object.entries(shards)
              .slice(0, ROWS)
              .map(([file, one]) => [
                file,
                words.fileSize(one.bytes),
                make("code", { title: one.sha256 }, one.sha256.slice(0, 12)),
              ]),
            [1],
          ),
          Object.keys(shards).length > ROWS &&
            make("p.soft", `… and ${words.count(Object.keys(shards).length - ROWS)} more in dataset/SHA256SUMS.`),
          make(
            "p.soft",
            Object.entries(splits).map(([split, count]) =>
              make("span.pair", make("b", split), ` ${words.plural(count, "object")} `),
            ),
          ),
        ),
      ),
    ];
  }

  const PARTS = {
    refusals: ["Refusals", refusals],
    warnings: ["Warnings", warnings],
    validation: ["Validation", validation],
    making: ["How it was made", making],
  };

  function view(shelf) {
    let root = null;
    const offered = Object.keys(PARTS).filter((part) => part !== "validation" || shelf.data.validation);
    const first = shelf.data.kind === "run" ? "refusals" : "making";
    function show({ settings }) {
      const part = offered.includes(settings.get("part")) ? settings.get("part") : first;
      const tabs = offered.map((one) =>
        make(
          "a",
          { href: elements.link("run", "", { part: one }), "aria-current": one === part ? "true" : null },
          PARTS[one][0],
        ),
      );
      root.replaceChildren(
        make("h1.visually-hidden", { tabindex: "-1" }, "The run"),
        make("nav.tabs", { "aria-label": "Parts of the run" }, tabs),
        make("section.part", make("h2", PARTS[part][0]), ...PARTS[part][1](shelf).flat(Infinity).filter(Boolean)),
      );
    }
    return {
      show(given, asked) {
        root = given;
        show(asked);
      },
      change: show,
    };
  }

  return { view };
})();
