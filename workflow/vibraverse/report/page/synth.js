// Impact sounds from modes, in float64. It follows physics/impulse.py and physics/half_sine.py, whose docstrings hold
// the equations; tests/test_synth.py compares the two. Nothing here touches the page, so Node can run it, too.
"use strict";

const synth = (() => {
  const ORDER = { displacement: 0, velocity: 1, acceleration: 2 }; // derivatives of the displacement
  const MIN_S = 0.02; // shortest sound after the contact
  const FADE_S = 0.01;
  const MAX_SHARE = 0.9; // of the critical damping, in the form for ringing modes
  const TIMES = 1000; // at which the envelopes are looked at

  // A body whose modes have the angular frequencies `unit` for E = ρ = 1 and a mesh unit of 1 m, in a material:
  // {density, young, alpha, beta} in kg/m³, Pa, 1/s and s; `scale` is metres per mesh unit.
  function inMaterial(unit, material, scale) {
    const factor = Math.sqrt(material.young / material.density) / scale;
    const omega = Float64Array.from(unit, (one) => one * factor);
    const damping = omega.map((one) => 0.5 * (material.alpha + material.beta * one * one));
    return { omega, damping };
  }

  // Weights of the modes from the motion of the shape columns along the normal at a point, (k). The rotation (m, k) is
  // that of a Poisson's ratio, row by row. Columns are normalised for unit density and mesh unit.
  function struckWeights(gains, rotation, density, scale) {
    const perMass = 1 / Math.sqrt(density * scale ** 3);
    const columns = gains.length;
    const weights = new Float64Array(rotation.length / columns);
    for (let mode = 0; mode < weights.length; mode += 1) {
      let sum = 0;
      for (let column = 0; column < columns; column += 1) sum += rotation[mode * columns + column] * gains[column];
      weights[mode] = sum * perMass;
    }
    return weights;
  }

  // The place in `stops` (ascending) that is nearest to a Poisson's ratio.
  function nearestStop(stops, poisson) {
    let best = 0;
    stops.forEach((stop, place) => {
      if (Math.abs(stop - poisson) < Math.abs(stops[best] - poisson)) best = place;
    });
    return best;
  }

  // Displacement and velocity of a mode after a unit impulse.
  function impulseMotion(omega, damping, time) {
    const root = Math.sqrt(Math.abs((damping - omega) * (damping + omega)));
    if (damping < omega) {
      const decay = Math.exp(-damping * time);
      const place = (decay * Math.sin(root * time)) / root;
      return [place, decay * Math.cos(root * time) - damping * place];
    }
    const slow = omega ** 2 / (damping + root);
    const fast = -2 * root * time;
    const place = time * Math.exp(-slow * time) * (fast === 0 ? 1 : Math.expm1(fast) / fast);
    return [place, Math.exp(-(damping + root) * time) - slow * place];
  }

  // (e^z - 1) / z of a complex number, as [real, imaginary].
  function phi(re, im) {
    if (re === 0 && im === 0) return [1, 0];
    const above = Math.expm1(re) * Math.cos(im) - 2 * Math.sin(im / 2) ** 2;
    const beside = Math.exp(re) * Math.sin(im);
    const size = re * re + im * im;
    return [(above * re + beside * im) / size, (beside * re - above * im) / size];
  }

  // Displacement, velocity and acceleration of a mode within a half-sine contact of unit impulse.
  function contactMotion(omega, damping, contact, time) {
    const push = Math.PI / contact;
    const sine = Math.sin(push * time);
    const cosine = Math.cos(push * time);
    if (damping < MAX_SHARE * omega) {
      const ringing = Math.sqrt((omega - damping) * (omega + damping));
      const [a, b] = phi(-damping * time, (ringing - push) * time);
      const [c, d] = phi(-damping * time, (ringing + push) * time);
      // g = t/(2i) (e^{ipt} φ(...) - e^{-ipt} φ(...))
      const re = (time / 2) * (cosine * b + sine * a - (cosine * d - sine * c));
      const im = (-time / 2) * (cosine * a - sine * b - (cosine * c + sine * d));
      const firstRe = -damping * re - ringing * im + sine;
      const firstIm = -damping * im + ringing * re;
      const secondIm = -damping * firstIm + ringing * firstRe;
      return [im, firstIm, secondIm].map((one) => (one * push) / (2 * ringing));
    }
    const [place, velocity] = impulseMotion(omega, damping, time);
    const acceleration = -2 * damping * velocity - omega ** 2 * place;
    const stiff = omega ** 2 - push ** 2;
    const scale = stiff ** 2 + 4 * damping ** 2 * push ** 2;
    const a = stiff / scale;
    const b = (-2 * damping * push) / scale;
    return [
      a * (sine - push * place) + b * (cosine - velocity - 2 * damping * place),
      a * push * (cosine - velocity) + b * (omega ** 2 * place - push * sine),
      -a * push * (push * sine + acceleration) + b * (omega ** 2 * velocity - push ** 2 * cosine),
    ].map((one) => (one * push) / 2);
  }

  // The free motion u of a mode as the contact ends, as [u, u' + d u].
  function afterContact(omega, damping, weight, contact, order) {
    let [value, slope] = [0, weight];
    if (contact > 0) [value, slope] = contactMotion(omega, damping, contact, contact).map((one) => one * weight);
    for (let times = 0; times < order; times += 1) {
      [value, slope] = [slope, -2 * damping * slope - omega ** 2 * value];
    }
    return [value, slope + damping * value];
  }

  function overdamped(mode, time) {
    const [place, velocity] = impulseMotion(mode.omega, mode.damping, time);
    return mode.value * (velocity + mode.damping * place) + mode.motion * place;
  }

  function envelope(mode, time) {
    if (mode.ringing === 0) return Math.abs(overdamped(mode, time));
    const critical = Math.abs(mode.value) + Math.abs(mode.motion) * Math.max(time, 1 / mode.omega);
    return Math.exp(-mode.damping * time) * Math.min(mode.amplitude, critical);
  }

  // The time after the contact at which the envelopes have fallen by `decayDb`, at most `maxS`; and their maximum.
  function ends(modes, rate, decayDb, maxS) {
    const level = (time) => modes.reduce((sum, mode) => sum + envelope(mode, time), 0);
    const [first, last] = [0.1 / rate, Math.max(maxS, MIN_S)];
    const times = Array.from({ length: TIMES }, (_, place) => first * (last / first) ** (place / (TIMES - 1)));
    const levels = times.map(level);
    const loudest = Math.max(...levels);
    const floor = loudest * 10 ** (-decayDb / 20);
    const above = levels.findLastIndex((one) => one > floor);
    if (above < 0) return { seconds: 0, loudest };
    if (above === TIMES - 1) return { seconds: maxS, loudest };
    let [low, high] = [times[above], times[above + 1]];
    while (high - low > 0.5 / rate) {
      const middle = 0.5 * (low + high);
      if (level(middle) > floor) low = middle;
      else high = middle;
    }
    return { seconds: high, loudest };
  }

  // Adds a ringing mode to `samples` from `start` on, `later` seconds after its contact, until it is below `floor`.
  // Two samples determine the next: x[n+1] = 2 r cos θ x[n] - r² x[n-1].
  function addRinging(samples, start, mode, later, rate, floor) {
    const decay = Math.exp(-mode.damping / rate);
    const turn = mode.ringing / rate;
    const lasts = Math.log(mode.amplitude / floor) / mode.damping;
    const end = Math.min(samples.length, start + Math.max(0, Math.ceil(lasts * rate)));
    const at = (time) =>
      Math.exp(-mode.damping * time) *
      ((mode.motion / mode.ringing) * Math.sin(mode.ringing * time) + mode.value * Math.cos(mode.ringing * time));
    const twice = 2 * decay * Math.cos(turn);
    const square = decay * decay;
    let now = at(later);
    let next = at(later + 1 / rate);
    for (let place = start; place < end; place += 1) {
      samples[place] += now;
      [now, next] = [next, twice * next - square * now];
    }
  }

  // The mode after the contact: its free motion [value, motion], its ringing frequency (0: it creeps), its amplitude.
  function released(omega, damping, weight, contact, observable) {
    const [value, motion] = afterContact(omega, damping, weight, contact, ORDER[observable]);
    const ringing = damping < omega ? Math.sqrt((omega - damping) * (omega + damping)) : 0;
    return { omega, damping, weight, value, motion, ringing, amplitude: Math.hypot(motion / ringing, value) };
  }

  // The largest value of each mode after the contact, in the unit of the samples; 0 above half the rate.
  function amplitudes(modes, options = {}) {
    const { rate = 44100, contact = 0, observable = "displacement" } = options;
    return Float64Array.from(modes.omega, (omega, place) => {
      if (omega >= Math.PI * rate) return 0;
      const mode = released(omega, modes.damping[place], modes.weights ? modes.weights[place] : 1, contact, observable);
      return mode.ringing > 0 ? mode.amplitude : Math.abs(mode.value) + Math.abs(mode.motion) / omega;
    });
  }

  // The sound of modes with angular frequencies `omega`, decay rates `damping` and weights (default: all 1), as samples
  // in sqrt(kg)·m (per second or second squared for velocity and acceleration), with counts of the modes. Each mode
  // stops where it is `floorDb` below the loudest moment.
  function render(modes, options = {}) {
    const { rate = 44100, decayDb = 60, maxS = 4, contact = 0, observable = "displacement", floorDb = 100 } = options;
    const heard = [];
    let above = 0;
    modes.omega.forEach((omega, place) => {
      if (omega >= Math.PI * rate) {
        above += 1;
        return;
      }
      const weight = modes.weights ? modes.weights[place] : 1;
      heard.push(released(omega, modes.damping[place], weight, contact, observable));
    });
    const { seconds, loudest } = ends(heard, rate, decayDb, maxS);
    const pressed = Math.ceil(contact * rate);
    const later = pressed / rate - contact;
    const free = Math.max(Math.ceil(seconds * rate), Math.ceil(MIN_S * rate));
    const samples = new Float64Array(pressed + free);
    const floor = loudest * 10 ** (-floorDb / 20);
    for (const mode of heard) {
      for (let place = 0; place < pressed; place += 1) {
        const motion = contactMotion(mode.omega, mode.damping, contact, place / rate);
        samples[place] += mode.weight * motion[ORDER[observable]];
      }
      if (mode.ringing > 0) addRinging(samples, pressed, mode, later, rate, floor);
      else
        for (let place = 0; place < free; place += 1)
          samples[pressed + place] += overdamped(mode, later + place / rate);
    }
    const fade = Math.round(FADE_S * rate);
    for (let place = 1; place <= fade; place += 1) {
      samples[samples.length - 1 - fade + place] *= 0.5 + 0.5 * Math.cos((Math.PI * place) / fade);
    }
    return {
      samples,
      rate,
      rendered: heard.length,
      aboveNyquist: above,
      overdamped: heard.filter((mode) => mode.ringing === 0).length,
    };
  }

  return { inMaterial, struckWeights, nearestStop, impulseMotion, contactMotion, amplitudes, render };
})();

if (typeof module !== "undefined") module.exports = synth;
