// What the reader takes away: a sound file, a link, a command, a program, a table.
"use strict";

const tools = (() => {
  const { make } = elements;

  // Returns an element. `current` returns {id, data, choices, found, levels, heard: {made, gain_db}}; `room` is
  // where a text goes that the browser does not let be copied.
  function create(current, room) {
    const button = (text, click) => make("button", { type: "button", class: "quiet", click }, text);
    const named = (ending) => {
      const { id, choices } = current();
      return `${id}-${choices.solidity}-${choices.name}.${ending}`;
    };

    function save(name, type, content) {
      const href = URL.createObjectURL(new Blob([content], { type }));
      make("a", { href, download: name }).click();
      setTimeout(() => URL.revokeObjectURL(href), 10_000);
      elements.say(`Saved ${name}.`);
    }

    async function copy(text) {
      try {
        await navigator.clipboard.writeText(text);
        elements.say("Copied.");
      } catch {
        // Browsers keep the clipboard from some pages: show the text, selected.
        const field = make("textarea.copied", { rows: 4, readonly: true, "aria-label": "Copy this" }, text);
        room.replaceChildren(field);
        field.focus();
        field.select();
      }
    }

    const state = () => current();
    return make(
      "div.tools",
      button("Save WAV", () => save(named("wav"), "audio/wav", wavBytes(state()))),
      button("Copy link", () => copy(location.href)),
      button("Copy command", () => copy(share.command(state().choices, state().data, state().id))),
      button("Copy Python", () => copy(share.python(state().choices, state().data, state().found))),
      button("Modes as CSV", () => save(named("csv"), "text/csv", share.csv(state().found, state().levels))),
    );
  }

  // The file of what was heard last, with the gain at which it was.
  function wavBytes({ data, choices, heard: { made, gain_db } }) {
    const factor = 10 ** (gain_db / 20);
    const samples = made.samples.map((one) => one * factor);
    return wav.bytes(samples, made.rate, share.info(choices, data, [`gain ${gain_db.toFixed(2)} dB`]));
  }

  return { create, wavBytes };
})();
