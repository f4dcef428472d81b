// The objects of the page and how they are chosen: the rows of the index as objects, filters from an address, counts.
// Nothing here touches the page, so Node can run it, too.
"use strict";

const catalogue = (() => {
  const LN_60_DB = Math.log(1000); // ring time times decay rate
  const MOST = 60; // values of a facet that are offered
  const CODED = ["source", "family", "licence", "split"];

  // Decay rate in 1/s of a mode of `hz` in a material, and the time in s in which it falls by 60 dB; 0 if it does not
  // ring.
  const decay = (hz, material) => 0.5 * (material.alpha + material.beta * (2 * Math.PI * hz) ** 2);
  function ring(hz, material) {
    const rate = decay(hz, material);
    return hz > 0 && rate > 0 && rate < 2 * Math.PI * hz ? LN_60_DB / rate : 0;
  }

  // Frequencies below `hz` that a body of this volume has by Weyl's law: only the volume counts.
  function weyl(hz, volume, { young, density, poisson }) {
    const shear = Math.sqrt(young / (2 * density * (1 + poisson)));
    const pressure = shear * Math.sqrt((2 * (1 - poisson)) / (1 - 2 * poisson));
    return ((4 * Math.PI) / 3) * volume * hz ** 3 * (2 / shear ** 3 + 1 / pressure ** 3);
  }

  function body(row, data, materials) {
    if (!row) return null;
    const [volume, error, warned, modes, lastHz, ...f1] = row;
    const first = materials[0];
    const law = first && lastHz > 0 ? weyl(lastHz, volume, first) : 0;
    return {
      volume,
      error,
      warned,
      modes,
      f1,
      ring: f1.map((hz, place) => ring(hz, materials[place])),
      density: law > 0 ? modes / law : 0,
    };
  }

  // The index as the views use it. An entry has texts, and `bodies` and `refused` by solidity ("" is the whole object).
  // `times` is what the run took, as `vibraverse.times` got it.
  function read(data, times = { stages: {}, objects: {} }) {
    const { materials } = data;
    const place = Object.fromEntries(data.columns.map((name, number) => [name, number]));
    const entries = data.rows.map((row) => {
      const entry = {
        id: row[place.id],
        size: row[place.size_m],
        version: row[place.version],
        thumb: row[place.thumb],
      };
      entry.title = row[place.title] || entry.id;
      for (const name of CODED) entry[name] = data.names[name][row[place[name]]] || "";
      [entry.cost, entry.dearest] = times.objects[entry.id] || [0, ""];
      entry.bodies = {};
      for (const name of data.solidities) {
        const found = body(row[place[name]], data, materials);
        if (found) entry.bodies[name] = found;
      }
      entry.refused = (row[place.refused] || []).map(([solidity, reason, stage, message, advice]) => ({
        solidity: solidity ? data.solidities[solidity - 1] : "",
        reason: data.names.reason[reason],
        stage: data.names.stage[stage],
        message,
        advice: data.names.advice[advice],
      }));
      entry.warned = Object.values(entry.bodies).reduce((bits, one) => bits | one.warned, 0);
      entry.words = [entry.id, entry.title, entry.family, entry.source].join(" ").toLowerCase();
      return entry;
    });
    return { data, times, entries, materials: materials.map((one) => one.name), solidities: data.solidities };
  }

  // A span "low..high", either end open, as two numbers; null if it is none.
  function span(text) {
    const ends = String(text || "").split("..");
    if (ends.length !== 2) return null;
    const [low, high] = ends.map((one) => (one.trim() === "" ? NaN : Number(one)));
    if (Number.isNaN(low) && Number.isNaN(high)) return null;
    return [Number.isNaN(low) ? -Infinity : low, Number.isNaN(high) ? Infinity : high];
  }

  // What can be chosen: a value out of several, or a span. `of` gives the values of an entry for the bodies and the
  // material that are looked at; one of them has to fit.
  const FACETS = {
    source: { name: "Source", of: (entry) => [entry.source] },
    family: { name: "Family", of: (entry) => [entry.family] },
    licence: { name: "Licence", of: (entry) => [entry.licence] },
    split: { name: "Split", of: (entry) => [entry.split] },
    state: {
      name: "State",
      of: (entry, seen) =>
        [
          entry.refused.length ? "refused" : "",
          ...entry.refused.map((one) => `refused: ${one.reason}`),
          Object.keys(entry.bodies).length ? "made" : "",
          ...seen.kinds.filter((_, bit) => (entry.warned >> bit) & 1).map((kind) => `warning: ${kind}`),
          entry.warned ? "with warnings" : "",
        ].filter(Boolean),
    },
    dearest: { name: "Slowest stage", of: (entry) => [entry.dearest] },
  };
  const inBodies = (number) => (entry, seen) => {
    const bodies = seen.solidity ? [entry.bodies[seen.solidity]] : Object.values(entry.bodies);
    return bodies
      .filter(Boolean)
      .map((one) => number(one, seen))
      .filter((value) => value > 0);
  };
  const SPANS = {
    f1: { name: "Lowest frequency", unit: "Hz", of: inBodies((one, seen) => one.f1[seen.material]) },
    ring: { name: "Ring time", unit: "s", of: inBodies((one, seen) => one.ring[seen.material]) },
    size: { name: "Longest side", unit: "m", of: (entry) => (entry.size > 0 ? [entry.size] : []) },
    volume: { name: "Volume", unit: "m³", of: inBodies((one) => one.volume) },
    density: { name: "Modes over Weyl’s law", unit: "", of: inBodies((one) => one.density) },
    error: { name: "Largest error", unit: "", of: inBodies((one) => one.error) },
  };
  const SORTS = {
    name: { name: "Name", of: (entry) => entry.id },
    f1: { name: "Lowest frequency", of: (entry, seen) => Math.min(...SPANS.f1.of(entry, seen)) },
    ring: { name: "Longest ring", of: (entry, seen) => -Math.max(0, ...SPANS.ring.of(entry, seen)) },
    size: { name: "Smallest", of: (entry) => entry.size || Infinity },
    largest: { name: "Largest", of: (entry) => -entry.size },
    error: { name: "Largest error", of: (entry, seen) => -Math.max(0, ...SPANS.error.of(entry, seen)) },
    cost: { name: "Longest computed", of: (entry) => -entry.cost },
  };

  // What the settings of an address ask for. Settings that mean nothing are left out, and so choose nothing.
  function asked(settings, shelf) {
    const material = shelf.materials.indexOf(settings.get("material"));
    const solidity = shelf.solidities.includes(settings.get("solidity")) ? settings.get("solidity") : "";
    const wanted = {
      seen: { material: Math.max(material, 0), solidity, kinds: shelf.data.warnings.map((one) => one.kind) },
    };
    wanted.words = (settings.get("q") || "").toLowerCase().split(/\s+/).filter(Boolean);
    wanted.values = Object.fromEntries(
      Object.keys(FACETS)
        .map((name) => [name, settings.get(name) ?? ""])
        .filter(([, value]) => value),
    );
    wanted.spans = Object.fromEntries(
      Object.keys(SPANS)
        .map((name) => [name, span(settings.get(name))])
        .filter(([, value]) => value),
    );
    wanted.sort = SORTS[settings.get("sort")] ? settings.get("sort") : "name";
    return wanted;
  }

  function fits(entry, wanted, besides) {
    const { seen } = wanted;
    if (
      seen.solidity &&
      besides !== "solidity" &&
      !entry.bodies[seen.solidity] &&
      !entry.refused.some((one) => !one.solidity || one.solidity === seen.solidity)
    )
      return false;
    for (const word of wanted.words) if (!entry.words.includes(word)) return false;
    for (const [name, value] of Object.entries(wanted.values)) {
      if (name !== besides && !FACETS[name].of(entry, seen).includes(value)) return false;
    }
    for (const [name, [low, high]] of Object.entries(wanted.spans)) {
      if (name !== besides && !SPANS[name].of(entry, seen).some((value) => value >= low && value <= high)) return false;
    }
    return true;
  }

  // The entries that are asked for, in the order that is asked for; equal ones stay in the order of their ids.
  function choose(shelf, wanted) {
    const found = shelf.entries.filter((entry) => fits(entry, wanted, ""));
    if (wanted.sort === "name") return found;
    const key = SORTS[wanted.sort].of;
    const keyed = found.map((entry) => [key(entry, wanted.seen), entry]);
    return keyed.sort(([a], [b]) => (a < b ? -1 : a > b ? 1 : 0)).map(([, entry]) => entry);
  }

  // Values of a facet with the number of entries that choosing each would leave: the most frequent, then `more` others.
  function offered(shelf, wanted, name) {
    const counts = new Map();
    for (const entry of shelf.entries) {
      if (!fits(entry, wanted, name)) continue;
      for (const value of FACETS[name].of(entry, wanted.seen))
        if (value) counts.set(value, (counts.get(value) || 0) + 1);
    }
    const chosen = wanted.values[name];
    if (chosen && !counts.has(chosen)) counts.set(chosen, 0);
    const sorted = [...counts].sort(([a, one], [b, other]) => other - one || (a < b ? -1 : 1));
    const kept = sorted.slice(0, MOST);
    if (chosen && !kept.some(([value]) => value === chosen)) kept.push([chosen, counts.get(chosen)]);
    return { values: kept, more: sorted.length - kept.length };
  }

  return { read, asked, choose, offered, span, ring, weyl, FACETS, SPANS, SORTS };
})();

if (typeof module !== "undefined") module.exports = catalogue;
