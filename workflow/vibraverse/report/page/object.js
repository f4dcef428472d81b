// The view of an object: turn it, strike it, hear what material, size and striker do. The address holds every choice.
"use strict";

const objectView = (() => {
  const { make } = elements;
  const [START_DB, MOST_DB, FAINT_DB] = [-6, -1, -45]; // of full scale: the first strike, any, one that is hard to hear
  const RESTRIKE_MS = 140; // after the last movement of a slider
  const NO_MODEL =
    "No model here: this browser has no WebGL, or the page was made without its library. Strike with the buttons.";
  let view = null; // what is shown, and what it is made of

  route.add("object", {
    show(root, asked) {
      const id = asked.subject || document.documentElement.dataset.object || "";
      const own = (view = { id, root, ended: new AbortController(), bodies: {} });
      if (!id) {
        root.replaceChildren(about.notice("No object is named.", "The address of one is #/object/ and its id."));
        return;
      }
      root.replaceChildren(make("p.loading", "Loading …"));
      vibraverse.loadObject(id).then(
        (data) => view === own && build(data, asked.settings),
        (error) => view === own && root.replaceChildren(about.notice("This object cannot be shown.", error.message)),
      );
    },
    change(asked) {
      if (view && view.data && Object.keys(view.data.bodies).length) take(share.read(asked.settings, view.data));
    },
    leave() {
      sound.hush();
      if (view) {
        view.ended.abort();
        clearTimeout(view.later);
        if (view.model) view.model.detach();
      }
      view = null;
    },
  });

  // Puts up everything but what depends on the choices.
  function build(data, settings) {
    view.data = data;
    document.title = `${data.facts.title} · VibraVerse`;
    const article = make("article.object", about.head(view.id, data));
    view.root.replaceChildren(article);
    if (!Object.keys(data.bodies).length) {
      article.append(...about.refusals(data), still.create(data, ""));
      return;
    }
    view.said = make("p.said", "Click the body to strike it.");
    view.notices = make("div.notices");
    view.compare = make("div");
    view.facts = make("div");
    view.host = make("div.stage", make("i.crosshair", { "aria-hidden": "true" }));
    view.places = places.create(strike);
    view.copied = make("div");
    view.spectrum = spectrum.create((mode) => update({ mode }));
    view.spectrogram = spectrogram.create(struck.longest(data), data.audio);
    view.controls = controls.create((key, value) => {
      if (key === "size" || key === "contact") update({ [key]: value });
      else update({ material: { ...view.choices.material, [key]: value } });
    });
    article.append(
      ...about.refusals(data),
      make(
        "div.upper",
        make("div.striking", view.host, bodySwitch(data), view.places.element, view.said),
        make("div.panel", materialSwitch(data), view.controls.element, observableSwitch(), view.facts, view.compare),
      ),
      view.notices,
      make("div.plots", view.spectrum.element, view.spectrogram.element),
      make("div", tools.create(takeAway, view.copied), view.copied),
      make(
        "p.keys",
        "Space strikes again, H swaps solid and hollow. On the model arrows turn, + and − zoom, Enter strikes at the crosshair.",
      ),
    );
    document.addEventListener("keydown", pressed, { signal: view.ended.signal });
    take(share.read(settings, data));
  }

  function bodySwitch(data) {
    const options = ["solid", "hollow"]
      .filter((one) => data.bodies[one])
      .map((one) => ({ value: one, text: words.capital(one), kind: one }));
    view.bodySwitch = elements.segments("Body", "body", options, (solidity) => update({ solidity }));
    const again = make("button", { type: "button", class: "again", click: () => strike({}) }, "Strike");
    return make("div.row", view.bodySwitch, again);
  }

  function materialSwitch(data) {
    const options = Object.keys(data.materials).map((name) => ({ value: name, text: name }));
    view.materialSwitch = elements.segments("Material", "material", options, (name) =>
      update({ name, material: { ...data.materials[name] } }),
    );
    return view.materialSwitch;
  }

  function observableSwitch() {
    const options = share.OBSERVABLES.map((one) => ({ value: one, text: one }));
    view.observableSwitch = elements.segments("Heard of the motion", "observable", options, (observable) =>
      update({ observable }),
    );
    return make("div.heard", make("span", "Heard: the surface’s"), view.observableSwitch);
  }

  // Takes choices from an address: finds the body and the place, then shows them without a sound.
  async function take(choices) {
    const own = view;
    view.choices = { ...choices, place: null };
    if (choices.stored !== null) choose(choices.stored);
    refresh();
    const body = await ensure(choices.solidity);
    if (view !== own || view.choices.solidity !== choices.solidity) return;
    if (!body) choices.material.poisson = view.data.materials[choices.name].poisson;
    if (body && view.choices.at) view.choices.place = points.nearest(body, view.choices.at);
    refresh();
  }

  // Changes choices and strikes again.
  async function update(change) {
    const own = view;
    Object.assign(view.choices, change);
    const { choices } = view;
    if (change.solidity) choices.place = null;
    if (choices.stored !== null && (change.name || change.solidity)) choose(choices.stored);
    const body = await ensure(choices.solidity);
    if (view !== own || view.choices !== choices) return;
    if (!body) choices.material.poisson = view.data.materials[choices.name].poisson;
    if (body && choices.at && !choices.place) choices.place = points.nearest(body, choices.at);
    refresh();
    clearTimeout(view.later);
    view.later = setTimeout(() => sounded(), RESTRIKE_MS);
  }

  // Strikes at a place, at a stored point, everywhere, or where it was struck before.
  function strike({ place, stored, everywhere }) {
    const { choices } = view;
    if (place) Object.assign(choices, { place, at: place.position, stored: null });
    if (everywhere) Object.assign(choices, { place: null, at: null, stored: null });
    if (stored !== undefined) choose(stored);
    refresh();
    sounded();
  }

  function choose(stored) {
    const { position } = view.data.bodies[view.choices.solidity].strikes[view.choices.name][stored];
    const body = loaded(view.choices.solidity);
    Object.assign(view.choices, { stored, at: position, place: body && points.nearest(body, position) });
  }

  // The unpacked data of a body; null if they cannot be had, which is then said.
  function ensure(solidity) {
    const own = view;
    if (!own.bodies[solidity]) {
      const { version } = own.data.bodies[solidity];
      own.bodies[solidity] = vibraverse
        .loadBody(own.id, solidity, version)
        .then(unpack.body)
        .catch((error) => {
          own.lost = error.message;
          return null;
        })
        .then((body) => {
          own.bodies[solidity] = Promise.resolve(body);
          (own.loaded = own.loaded || {})[solidity] = body;
          return body;
        });
    }
    return own.bodies[solidity];
  }

  const loaded = (solidity) => (view.loaded || {})[solidity] || null;

  // Shows everything that depends on the choices, and writes them into the address.
  function refresh() {
    const { data, choices } = view;
    const body = loaded(choices.solidity);
    // Before the body is loaded, and where it cannot be, ν is the material's own.
    const own = { ...choices.material, poisson: data.materials[choices.name].poisson };
    view.found = struck.modes(data, body, body ? choices : { ...choices, material: own, place: null });
    view.heard = null;
    view.levels = struck.levels(data, view.found, choices);
    elements.choose(view.bodySwitch, choices.solidity);
    elements.choose(view.materialSwitch, choices.name);
    elements.choose(view.observableSwitch, choices.observable);
    view.controls.set(
      { ...choices.material, size: choices.size, contact: choices.contact },
      { ...data.materials[choices.name], size: data.size_m, contact: data.audio.contact_s },
    );
    view.controls.stops(body && [...body.poisson]);
    view.facts.replaceChildren(
      about.facts(data, choices, view.found),
      about.warnings(data.bodies[choices.solidity]) || "",
    );
    view.spectrum.show({
      ...view.found,
      levels: view.levels,
      ring: (mode) => struck.ring(view.found, mode),
      highHz: data.audio.sample_rate_hz / 2,
      kind: choices.solidity,
      chosen: choices.mode,
    });
    showComparison();
    showModel(body);
    view.places.show(body, data.bodies[choices.solidity].strikes[choices.name], choices);
    showNotices();
    route.settle(share.write(choices, data));
  }

  function showComparison() {
    const { data, choices } = view;
    const modes = {};
    for (const solidity of Object.keys(data.bodies)) {
      const body = loaded(solidity);
      if (body || struck.atPreset(data, choices)) {
        modes[solidity] = struck.modes(data, body, { ...choices, solidity, place: null, stored: null });
      }
    }
    view.compare.replaceChildren(about.comparison(modes) || "");
  }

  function showModel(body) {
    const { choices, data } = view;
    if (!scene.available()) {
      if (!view.still) view.host.replaceChildren((view.still = still.create(data, NO_MODEL)));
      return;
    }
    if (!view.model) {
      const label = `${data.facts.title}: click to strike, arrows turn, Enter strikes at the crosshair`;
      view.model = scene.attach(view.host, { label, onstrike: (place) => strike({ place }) });
    }
    if (!body) return;
    if (view.modelled !== body) scene.show(body, !view.modelled);
    view.modelled = body;
    scene.dress(data.materials[choices.name].look);
    const colour = getComputedStyle(view.host).getPropertyValue(`--${choices.solidity}`).trim();
    const stored = choices.stored === null ? null : data.bodies[choices.solidity].strikes[choices.name][choices.stored];
    scene.mark(choices.place || stored, colour);
    scene.move(choices.mode === null ? null : struck.shape(body, choices.material.poisson, choices.mode));
  }

  function showNotices() {
    const { choices, data, found } = view;
    const audible = data.audio.sample_rate_hz / 2;
    const rings = found.hz.some((hz) => hz / choices.slower < audible && hz / choices.slower >= struck.AUDIBLE_HZ);
    const said = [];
    const speed = (slower, text) =>
      make("button", { type: "button", class: "quiet", click: () => update({ slower }) }, text);
    if (choices.slower !== 1)
      said.push(about.notice("Ten times slower:", "every frequency is a tenth of the real one.", speed(1, "As it is")));
    if (!rings) {
      const why =
        found.hz[0] >= audible
          ? `its lowest mode, ${words.hertz(found.hz[0], found.error[0])}, is too high`
          : "its modes are too low";
      said.push(
        about.notice(
          "No ear hears this body:",
          `${why}.`,
          choices.slower === 1 && found.hz[0] >= audible ? speed(10, "Listen ten times slower") : null,
        ),
      );
    }
    if (view.lost)
      said.push(about.notice("Striking anywhere does not work:", `${view.lost}. The body’s own sounds still do.`));
    if (view.mute) said.push(about.notice("This browser plays no sound.", "Save the WAV file to hear it elsewhere."));
    view.notices.replaceChildren(...said);
  }

  // Plays the strike, and says and draws what is heard. One gain serves all strikes, so that they can be compared.
  function sounded() {
    const { data, choices, found } = view;
    view.heard = rendered();
    const { made, gain_db: gain } = view.heard;
    sound.hush();
    const voice = sound.play({ samples: made.samples, rate: made.rate, gain_db: gain });
    view.mute = !voice && made.samples.length > 0;
    const level = made.peak > 0 ? 20 * Math.log10(made.peak) + gain : -Infinity;
    const where =
      choices.stored !== null
        ? `at point ${choices.stored + 1}`
        : choices.at
          ? `at ${places.nameOf(loaded(choices.solidity), choices.at)}`
          : "everywhere alike";
    const what =
      choices.mode === null
        ? `${made.rendered} modes, lowest ${words.hertz(found.hz[0], found.error[0])}`
        : `mode ${choices.mode + 1} alone, ${words.hertz(found.hz[choices.mode], found.error[choices.mode])}`;
    elements.say(`Struck ${choices.solidity} ${choices.name} ${where}: ${what}, level ${words.decibels(level)}.`);
    const louder =
      level < FAINT_DB && made.peak > 0
        ? make(
            "button",
            { type: "button", class: "quiet", click: () => ((view.gain_db = null), sounded()) },
            "Make it louder",
          )
        : null;
    view.said.replaceChildren(
      `Struck ${where} · ${what} · level ${words.decibels(level).replace("+", "")} at a gain of ${words.decibels(gain)}${view.changed || ""} `,
      louder || "",
    );
    view.spectrogram.show(made.samples, made.rate);
    view.spectrogram.follow(voice, made.samples.length / made.rate);
    showNotices();
  }

  function rendered() {
    const { data, choices, found } = view;
    const made = struck.sound(data, found, { ...choices, isolated: choices.mode });
    return { made, gain_db: chooseGain(made.peak, choices.mode !== null) };
  }

  // The gain in decibels: the one of the first strike, lowered for good where a louder one would clip.
  function chooseGain(peak, alone) {
    view.changed = "";
    if (!(peak > 0)) return view.gain_db ?? 0;
    const loud = -20 * Math.log10(peak);
    if (alone) {
      view.changed = ", for this mode alone";
      return loud + START_DB;
    }
    if (view.gain_db === undefined || view.gain_db === null) view.gain_db = loud + START_DB;
    if (view.gain_db > loud + MOST_DB) {
      view.changed = `, ${words.decibels(loud + START_DB - view.gain_db)} from now on so that nothing clips`;
      view.gain_db = loud + START_DB;
    }
    return view.gain_db;
  }

  // What can be taken away; renders the sound if nothing was struck.
  function takeAway() {
    if (!view.heard) view.heard = rendered();
    return view;
  }

  function pressed(event) {
    const typing = event.target.closest("input, textarea, select, button, summary, a");
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === " " && !typing) strike({});
    else if (
      event.key.toLowerCase() === "h" &&
      !(typing && typing.matches("input[type=number], textarea")) &&
      Object.keys(view.data.bodies).length > 1
    ) {
      update({ solidity: view.choices.solidity === "solid" ? "hollow" : "solid" });
    } else return;
    event.preventDefault();
  }

  return {
    get state() {
      return view;
    },
  };
})();
