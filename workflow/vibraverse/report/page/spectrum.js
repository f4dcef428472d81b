// The modes of a strike as strokes over frequency: as high as the level here, as wide as the frequency is uncertain.
"use strict";

const spectrum = (() => {
  const [LOW_HZ, FLOOR_DB] = [20, 60];
  const TICKS = [20, 50, 100, 200, 500, 1000, 2000, 5000, 10000];
  const { make } = elements;

  // Returns {element, show(…)}. `onmode` gets the mode that is chosen, or null for none.
  function create(onmode) {
    const svg = elements.draw("svg", { "aria-hidden": "true" });
    const strip = make("div.strip", { tabindex: 0, role: "slider", "aria-label": "Mode" }, svg);
    const reading = make("output.reading");
    const note = make("p.note");
    const caption = make("figcaption", make("strong", "Modes"), reading);
    const root = make("figure.spectrum", caption, strip, note);
    let shown = null; // what `show` got
    let hovered = null;

    const place = (hz) => (100 * Math.log(hz / LOW_HZ)) / Math.log(shown.highHz / LOW_HZ);
    const drawn = () =>
      [...shown.hz.keys()].filter((mode) => shown.hz[mode] >= LOW_HZ && shown.hz[mode] < shown.highHz);

    function draw() {
      const marks = TICKS.filter((hz) => hz < shown.highHz).flatMap((hz) => [
        elements.draw("line.tick", { x1: `${place(hz)}%`, x2: `${place(hz)}%`, y1: 0, y2: "86%" }),
        elements.draw(
          "text",
          { x: `${place(hz)}%`, y: "97%", class: hz > LOW_HZ ? "" : "first" },
          hz < 1000 ? `${hz}` : `${hz / 1000}k`,
        ),
      ]);
      const strokes = drawn().flatMap((mode) => {
        const height = Math.max(0.015, 1 + shown.levels[mode] / FLOOR_DB) * 80;
        const [x, y] = [place(shown.hz[mode]), `${86 - height}%`];
        const half = x - place(shown.hz[mode] * (1 - Math.min(0.5, shown.error[mode])));
        const state = `${shown.chosen === mode ? "chosen" : ""} ${hovered === mode ? "now" : ""}`;
        return [
          elements.draw("rect.unsure", { x: `${x - half}%`, width: `${2 * half}%`, y, height: `${height}%` }),
          elements.draw("line", { class: `stroke ${state}`, x1: `${x}%`, x2: `${x}%`, y1: "86%", y2: y }),
        ];
      });
      const unknown = shown.followingHz && shown.followingHz < shown.highHz ? [hatched(place(shown.followingHz))] : [];
      svg.replaceChildren(...unknown, ...marks, ...strokes);
      strip.className = `strip ${shown.kind} ${shown.chosen === null ? "" : "isolated"}`;
    }

    function hatched(from) {
      const room = 100 - from;
      const text =
        room > 24
          ? elements.draw(
              "text",
              { x: `${from + room / 2}%`, y: "14%", class: "beyond" },
              `not computed beyond mode ${shown.hz.length}`,
            )
          : null;
      return elements.draw(
        "g",
        elements.draw("rect.unknown", { x: `${from}%`, width: `${room}%`, y: 0, height: "86%" }),
        text,
      );
    }

    function read(mode) {
      if (mode === null) return "";
      const ring = shown.ring(mode);
      const parts = [
        `mode ${mode + 1}`,
        `${words.hertz(shown.hz[mode], shown.error[mode])} ± ${words.percent(shown.error[mode])}`,
        ring > 0 ? `rings ${words.duration(ring, 2)}` : "creeps",
        Number.isFinite(shown.levels[mode]) ? words.decibels(shown.levels[mode]).replace("+", "") : "not rendered",
      ];
      return parts.join(" · ");
    }

    function say() {
      const mode = hovered ?? shown.chosen;
      reading.textContent = read(mode) || "point at a stroke to read it, click to hear it alone";
      strip.setAttribute("aria-valuemin", 1);
      strip.setAttribute("aria-valuemax", shown.hz.length);
      strip.setAttribute("aria-valuenow", (mode ?? 0) + 1);
      strip.setAttribute("aria-valuetext", read(mode) || "all modes");
    }

    function nearest(event) {
      const box = strip.getBoundingClientRect();
      const at = (100 * (event.clientX - box.left)) / box.width;
      const far = (mode) => Math.abs(place(shown.hz[mode]) - at);
      return drawn().reduce((best, mode) => (best === null || far(mode) < far(best) ? mode : best), null);
    }

    function hover(mode) {
      if (hovered === mode) return;
      hovered = mode;
      draw();
      say();
    }

    const choose = (mode) => onmode(mode === shown.chosen ? null : mode);
    strip.addEventListener("pointermove", (event) => event.pointerType === "mouse" && hover(nearest(event)));
    strip.addEventListener("pointerleave", () => hover(null));
    strip.addEventListener("click", (event) => choose(nearest(event)));
    strip.addEventListener("blur", () => hover(null));
    strip.addEventListener("keydown", (event) => {
      const modes = drawn();
      const at = modes.indexOf(hovered ?? shown.chosen ?? -1);
      const to = { ArrowLeft: at - 1, ArrowRight: at + 1, Home: 0, End: modes.length - 1 }[event.key];
      if (to !== undefined && modes.length) hover(modes[Math.min(modes.length - 1, Math.max(0, to))]);
      else if (event.key === "Enter") choose(hovered ?? shown.chosen);
      else if (event.key === "Escape") onmode(null);
      else return;
      event.preventDefault();
      event.stopPropagation();
    });

    // Shows modes: {hz, error, levels, ring(mode), followingHz, highHz, kind, chosen}.
    function show(next) {
      shown = next;
      hovered = null;
      draw();
      say();
      const above = [...shown.hz].filter((hz) => hz >= shown.highHz).length;
      const below = [...shown.hz].filter((hz) => hz < LOW_HZ).length;
      const said = [];
      if (above)
        said.push(`${above} of ${shown.hz.length} modes lie above ${words.hertz(shown.highHz)}, which no ear hears.`);
      if (below) said.push(`${below} lie below ${LOW_HZ} Hz.`);
      if (shown.followingHz && shown.followingHz < 8000) {
        said.push(
          `Only ${shown.hz.length} modes are computed: above ${words.hertz(shown.followingHz, 0.01)} this sound lacks what a real one has.`,
        );
      }
      note.textContent = said.join(" ");
    }

    return { element: root, show };
  }

  return { create };
})();
