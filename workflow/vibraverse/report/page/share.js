// The choices of the reader in the address, as a command and as Python; modes as a table. Nothing here touches the page.
"use strict";

const share = (() => {
  const NUMBERS = { young: "E", density: "rho", poisson: "nu", alpha: "alpha", beta: "beta" };
  const FLAGS = { young: "young", density: "density", poisson: "poisson", alpha: "alpha", beta: "beta" };
  const OBSERVABLES = ["displacement", "velocity", "acceleration"];
  const digits = (value, most = 12) => String(Number(value.toPrecision(most)));

  // The choices that an address states; whatever it states wrongly is left as it is without one.
  function read(settings, data) {
    const bodies = Object.keys(data.bodies);
    const solidity = bodies.includes(settings.get("body")) ? settings.get("body") : bodies[0];
    const names = Object.keys(data.materials);
    const name = names.includes(settings.get("material")) ? settings.get("material") : names[0];
    const material = { ...data.materials[name] };
    for (const [key, short] of Object.entries(NUMBERS)) {
      const value = amount(settings, short, key === "alpha" || key === "beta");
      if (value !== null) material[key] = value;
    }
    const at = (settings.get("at") || "").split(",").map(Number);
    const stored = Number(settings.get("point") ?? NaN);
    const mode = Number(settings.get("mode") ?? NaN);
    const modes = data.bodies[solidity].modes[name].hz.length;
    return {
      solidity,
      name,
      material,
      size: amount(settings, "size") || data.size_m,
      contact: amount(settings, "contact", true) ?? data.audio.contact_s,
      observable: OBSERVABLES.includes(settings.get("observable")) ? settings.get("observable") : data.audio.observable,
      at: at.length === 3 && at.every(Number.isFinite) ? at : null,
      stored: data.bodies[solidity].strikes[name][stored] ? stored : null,
      mode: Number.isInteger(mode) && mode >= 1 && mode <= modes ? mode - 1 : null,
      slower: settings.get("slower") === "10" ? 10 : 1,
    };
  }

  function amount(settings, name, zero = false) {
    const value = settings.has(name) ? Number(settings.get(name)) : NaN;
    return Number.isFinite(value) && (value > 0 || (zero && value === 0)) ? value : null;
  }

  // The address of choices; what is as the object has it is left out.
  function write(choices, data) {
    const settings = new URLSearchParams();
    const preset = data.materials[choices.name];
    if (choices.solidity !== Object.keys(data.bodies)[0]) settings.set("body", choices.solidity);
    settings.set("material", choices.name);
    for (const [key, short] of Object.entries(NUMBERS)) {
      if (choices.material[key] !== preset[key]) settings.set(short, digits(choices.material[key]));
    }
    if (choices.size !== data.size_m) settings.set("size", digits(choices.size));
    if (choices.contact !== data.audio.contact_s) settings.set("contact", digits(choices.contact));
    if (choices.observable !== data.audio.observable) settings.set("observable", choices.observable);
    if (choices.stored !== null) settings.set("point", choices.stored);
    else if (choices.at) settings.set("at", choices.at.map((one) => digits(one, 5)).join(","));
    if (choices.mode !== null) settings.set("mode", choices.mode + 1);
    if (choices.slower !== 1) settings.set("slower", choices.slower);
    return settings;
  }

  // The command that computes the same sound from the mesh.
  function command(choices, data, id) {
    const { material, name, solidity } = choices;
    const { mesh } = data;
    const body = data.bodies[solidity];
    const words = ["vibraverse strike", quoted(mesh.file)];
    const preset = data.materials[name];
    if (preset.known) words.push(`--material ${name}`);
    for (const [key, flag] of Object.entries(FLAGS)) {
      if (!preset.known || material[key] !== preset[key]) words.push(`--${flag} ${digits(material[key])}`);
    }
    words.push(`--size ${digits(choices.size)}`, `--modes ${body.modes[name].hz.length}`);
    if (body.order !== 2) words.push(`--order ${body.order}`);
    words.push(`--elements ${body.elements}`);
    if (solidity === "hollow") words.push(`--hollow ${digits(body.wall)}`);
    const at = choices.stored === null ? choices.at : body.strikes[name][choices.stored].position;
    if (at) words.push(`--at=${at.map((one, axis) => digits(one / mesh.scale + mesh.centre[axis], 6)).join(",")}`);
    if (choices.contact > 0) words.push(`--contact-s ${digits(choices.contact)}`);
    if (choices.observable !== "displacement") words.push(`--observable ${choices.observable}`);
    words.push(`-o ${id}.wav`);
    return words.join(" ");
  }

  const quoted = (text) => (/^[\w./-]+$/.test(text) ? text : `'${text.replace(/'/g, "'\\''")}'`);

  // A program that renders the same samples.
  function python(choices, data, found) {
    const list = (name, values) => `${name} = [${[...values].map((one) => digits(one)).join(", ")}]\n`;
    const audio = data.audio;
    return (
      "from vibraverse.physics.impulse import impact_sound\n\n" +
      list("hz", found.hz) +
      list("damping", found.damping) +
      (found.weights ? list("weights", found.weights) : "weights = None\n") +
      `sound = impact_sound(hz, damping, ${audio.sample_rate_hz}, ${audio.decay_db}, ${audio.max_s}, weights, ` +
      `${digits(choices.contact)}, "${choices.observable}")\n` +
      "print(sound.samples, sound.sample_rate_hz)\n"
    );
  }

  // The modes as a table, a line each.
  function csv(found, levels) {
    const rows = [...found.hz].map((hz, mode) =>
      [
        mode + 1,
        digits(hz, 9),
        digits(found.error[mode], 3),
        digits(found.damping[mode], 6),
        levels[mode].toFixed(2),
      ].join(","),
    );
    return ["mode,frequency_hz,relative_error,damping_per_s,level_db", ...rows, ""].join("\n");
  }

  // What a sound file says of itself: names of RIFF INFO fields and their texts.
  function info(choices, data, said) {
    const { facts } = data;
    const { young, density, poisson, alpha, beta } = choices.material;
    const where = choices.at ? `struck at ${choices.at.map((one) => digits(one, 5)).join(", ")}` : "all modes alike";
    const about = [
      `${choices.solidity} ${choices.name}`,
      `E ${digits(young)} Pa`,
      `rho ${digits(density)} kg/m3`,
      `nu ${digits(poisson)}`,
      `alpha ${digits(alpha)} 1/s`,
      `beta ${digits(beta)} s`,
      `longest side ${digits(choices.size)} m`,
      where,
      `contact ${digits(choices.contact)} s`,
      choices.observable,
      ...said,
    ];
    const found = { INAM: facts.title, ICMT: about.join("; "), ISFT: "VibraVerse" };
    if (facts.licence) found.ICOP = facts.licence;
    if (facts.attribution) found.IART = facts.attribution;
    return found;
  }

  return { read, write, command, python, csv, info, OBSERVABLES };
})();

if (typeof module !== "undefined") module.exports = share;
