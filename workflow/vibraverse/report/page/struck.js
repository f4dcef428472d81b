// What a strike sounds like: from the data of an object, those of a body if they are loaded, and the choices of the
// reader. The choices are {solidity, name, material, size, contact, observable, place, stored}: the preset `name`, the
// `material` it was changed to, metres, seconds; `place` as in points.js, `stored` the number of a stored strike, neither
// for the sound that is the same everywhere. Nothing here touches the page.
"use strict";

const struck = (() => {
  const AUDIBLE_HZ = 20;
  const RING = Math.log(1000); // decay rate times the time to fall by 60 dB

  // The modes of a body: {hz, omega, damping, weights, error, followingHz, mass}. `body` is the unpacked one, or null:
  // then ν must be that of the preset, and the place a stored one or none.
  function modes(data, body, choices) {
    const { material, solidity, size } = choices;
    const about = data.bodies[solidity];
    const scale = (data.scale_m * size) / data.size_m;
    const found = atPreset(data, choices) ? scaledFrom(data, choices) : atStop(body, material, scale);
    found.hz = found.omega.map((one) => one / (2 * Math.PI));
    found.weights = weights(data, body, choices, scale);
    found.followingHz = body ? following(body, material, scale) : null;
    found.mass = about.volume_m3 * (size / data.size_m) ** 3 * material.density;
    return found;
  }

  const atPreset = (data, { name, material }) => data.materials[name].poisson === material.poisson;

  // The stored frequencies of the preset, scaled; exact for whatever Young's modulus, density and size.
  function scaledFrom(data, { name, material, solidity, size }) {
    const preset = data.materials[name];
    const stored = data.bodies[solidity].modes[name];
    const stiffer = (material.young / preset.young) * (preset.density / material.density);
    const factor = (2 * Math.PI * Math.sqrt(stiffer) * data.size_m) / size;
    const omega = Float64Array.from(stored.hz, (one) => one * factor);
    const damping = omega.map((one) => 0.5 * (material.alpha + material.beta * one * one));
    return { omega, damping, error: stored.error };
  }

  function atStop(body, material, scale) {
    const stop = synth.nearestStop(body.poisson, material.poisson);
    const node = synth.nearestStop(body.nodes, body.poisson[stop]);
    const error = [...body.errors.subarray(node * body.modeCount, (node + 1) * body.modeCount)];
    return { ...synth.inMaterial(unpack.angular(body, stop), material, scale), error };
  }

  // The frequency of the first mode that is not known.
  function following(body, material, scale) {
    const stop = synth.nearestStop(body.poisson, material.poisson);
    return (body.following[stop] * Math.sqrt(material.young / material.density)) / scale / (2 * Math.PI);
  }

  function weights(data, body, choices, scale) {
    const { material, name, solidity, stored, place } = choices;
    if (stored !== null && (atPreset(data, choices) || !place)) {
      const preset = data.materials[name];
      const lighter = Math.sqrt(preset.density / material.density) * (data.scale_m / scale) ** 1.5;
      return data.bodies[solidity].strikes[name][stored].gains.map((one) => one * lighter);
    }
    if (!place) return null;
    const node = synth.nearestStop(body.nodes, material.poisson);
    const gains = unpack.gains(body, place.face, place.barycentric, place.normal);
    return synth.struckWeights(gains, unpack.rotation(body, node), material.density, scale);
  }

  // The shape of a mode, a displacement for each vertex in the layout of the positions.
  function shape(body, poisson, mode) {
    const rotation = unpack.rotation(body, synth.nearestStop(body.nodes, poisson));
    const size = 3 * body.vertices;
    const found = new Float64Array(size);
    for (let column = 0; column < body.columnCount; column += 1) {
      const share = rotation[mode * body.columnCount + column];
      for (let place = 0; place < size; place += 1) found[place] += share * body.columns[column * size + place];
    }
    return found;
  }

  // The samples of modes, with what there is to say. `isolated` is a mode that is heard alone, or null; `slower` divides
  // all frequencies and decay rates.
  function sound(data, found, { contact, observable, isolated = null, slower = 1 }) {
    const audio = data.audio;
    const options = {
      rate: audio.sample_rate_hz,
      decayDb: audio.decay_db,
      maxS: audio.max_s,
      contact: contact * slower,
      observable,
    };
    const kept = (values) => (isolated === null ? values : values.slice(isolated, isolated + 1));
    const given = {
      omega: kept(found.omega).map((one) => one / slower),
      damping: kept(found.damping).map((one) => one / slower),
      weights: found.weights && kept(found.weights),
    };
    const made = synth.render(given, options);
    const peak = made.samples.reduce((most, one) => Math.max(most, Math.abs(one)), 0);
    return { ...made, peak };
  }

  // The amplitudes of all modes in decibels below the largest.
  function levels(data, found, { contact, observable }) {
    const rate = data.audio.sample_rate_hz;
    const heights = synth.amplitudes(found, { rate, contact, observable });
    const most = Math.max(...heights);
    return [...heights].map((one) => (one > 0 ? 20 * Math.log10(one / most) : -Infinity));
  }

  const ring = (found, mode) => (found.damping[mode] < found.omega[mode] ? RING / found.damping[mode] : 0);

  // The longest sound of the object in its own materials, in seconds: the common axis of time.
  function longest(data) {
    let most = 0.1;
    for (const body of Object.values(data.bodies)) {
      for (const [name, { hz }] of Object.entries(body.modes)) {
        const { alpha, beta } = data.materials[name];
        const damping = 0.5 * (alpha + beta * (2 * Math.PI * hz[0]) ** 2);
        if (hz[0] < data.audio.sample_rate_hz / 2)
          most = Math.max(most, ((data.audio.decay_db / 20) * Math.LN10) / damping);
      }
    }
    return Math.min(most, data.audio.max_s);
  }

  return { modes, atPreset, shape, sound, levels, ring, longest, AUDIBLE_HZ };
})();

if (typeof module !== "undefined") module.exports = struck;
