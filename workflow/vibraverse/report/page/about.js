// What there is to read about an object: where it came from, its bodies, warnings, refusals, and how two bodies differ.
"use strict";

const about = (() => {
  const LARGE_ERROR = 0.02; // as in physics/cautions.py
  const { make } = elements;

  function head(id, data) {
    const { facts } = data;
    const parts = [facts.family, facts.source !== facts.title && facts.source, facts.licence, facts.attribution];
    return make(
      "header",
      make("h1", { dir: "auto" }, facts.title || id),
      make(
        "p.about",
        parts.filter(Boolean).map((one) => make("span", { dir: "auto" }, one)),
      ),
    );
  }

  // Why bodies are missing: the same refusal is told once.
  function refusals(data) {
    const told = new Map();
    for (const [solidity, refusal] of Object.entries(data.refused)) {
      const same = told.get(refusal.message) || { refusal, bodies: [] };
      same.bodies.push(solidity);
      told.set(refusal.message, same);
    }
    const whole = !Object.keys(data.bodies).length;
    return [...told.values()].map(({ refusal, bodies }) =>
      notice(
        whole ? "Refused" : `The ${bodies.join(" and the ")} body is refused`,
        `${refusal.message} ${refusal.advice}`,
      ),
    );
  }

  const notice = (title, text, ...more) => make("div.notice", make("p", make("strong", title), ` ${text}`), more);

  // Facts of a body in a material, from its modes as in struck.js.
  function facts(data, choices, found) {
    const body = data.bodies[choices.solidity];
    const volume = body.volume_m3 * (choices.size / data.size_m) ** 3;
    const worst = Math.max(...found.error);
    const rows = [
      ["Longest side", words.length(choices.size)],
      ["Volume", words.volume(volume)],
      ["Mass", words.mass(found.mass)],
      ["First mode", words.hertz(found.hz[0], found.error[0])],
      ["It rings", struck.ring(found, 0) ? words.duration(struck.ring(found, 0), 2) : "not at all"],
      ["Elements", body.tetrahedra.toLocaleString("en-US")],
      [
        "Error by the elements",
        `${words.percent(median(found.error))}, at most ${words.percent(worst)}`,
        worst > LARGE_ERROR,
      ],
    ];
    if (body.wall) rows.splice(1, 0, ["Wall", `${words.percent(body.wall)} of the way in`]);
    return make(
      "dl.facts",
      rows.map(([name, value, large]) =>
        make("div", make("dt", name), make("dd", { class: large ? "large" : "" }, value)),
      ),
    );
  }

  const median = (values) => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];

  function warnings(body) {
    const said = body.warnings || [];
    if (!said.length) return null;
    return make(
      "details.warnings",
      make("summary", `${said.length} ${said.length > 1 ? "warnings" : "warning"}`),
      make(
        "ul",
        said.map(({ text }) => make("li", text)),
      ),
    );
  }

  // A line that says what the hollow body changes; `modes` maps solidities to modes.
  function comparison(modes) {
    if (!modes.solid || !modes.hollow) return null;
    const rings = ["hollow", "solid"].map((one) => struck.ring(modes[one], 0));
    const parts = [
      change("f₁", words.hertz(modes.hollow.hz[0], modes.hollow.error[0]), modes.hollow.hz[0] / modes.solid.hz[0]),
      change("mass", words.mass(modes.hollow.mass), modes.hollow.mass / modes.solid.mass),
      rings[0] && rings[1] ? change("rings", words.duration(rings[0], 2), rings[0] / rings[1]) : null,
    ];
    return make("p.comparison", make("strong", "Hollow against solid"), parts);
  }

  const change = (name, value, ratio) =>
    make("span", `${name} ${value} `, make("small", `×\u202f${words.number(ratio, 3)}`));

  return { head, refusals, notice, facts, warnings, comparison };
})();
