// How the sound of a strike fades: levels over time and frequency. All sounds of an object share one axis of time.
"use strict";

const spectrogram = (() => {
  const WINDOW = 1024; // samples
  const COLUMNS = 420;
  const FLOOR_DB = 80;
  const [LOW_HZ, ROWS] = [50, 120];
  const COLOURS = [
    [0, 0, 4],
    [40, 17, 89],
    [114, 31, 129],
    [183, 55, 121],
    [241, 96, 93],
    [254, 159, 109],
    [252, 253, 191],
  ];
  const { make } = elements;

  // The levels in decibels of the transform of `WINDOW` samples (Cooley and Tukey, Math. Comput. 19, 297, 1965).
  function transform(re, im) {
    const size = re.length;
    for (let place = 1, other = 0; place < size; place += 1) {
      let bit = size >> 1;
      for (; other & bit; bit >>= 1) other ^= bit;
      other ^= bit;
      if (place < other) {
        [re[place], re[other]] = [re[other], re[place]];
        [im[place], im[other]] = [im[other], im[place]];
      }
    }
    for (let length = 2; length <= size; length *= 2) {
      for (let step = 0; step < length / 2; step += 1) {
        const [cosine, sine] = [Math.cos((-2 * Math.PI * step) / length), Math.sin((-2 * Math.PI * step) / length)];
        for (let start = step; start < size; start += length) {
          const end = start + length / 2;
          const [x, y] = [re[end] * cosine - im[end] * sine, re[end] * sine + im[end] * cosine];
          re[end] = re[start] - x;
          im[end] = im[start] - y;
          re[start] += x;
          im[start] += y;
        }
      }
    }
  }

  // Powers (columns, rows) of samples, rows from low to high on a logarithmic axis.
  function powers(samples, rate, seconds) {
    const hop = (seconds * rate) / COLUMNS;
    const found = [];
    for (let column = 0; column < COLUMNS && column * hop < samples.length; column += 1) {
      const [re, im] = [new Float64Array(WINDOW), new Float64Array(WINDOW)];
      const start = Math.floor(column * hop) - WINDOW / 2;
      for (let place = 0; place < WINDOW; place += 1) {
        const one = samples[start + place] || 0;
        re[place] = one * (0.5 - 0.5 * Math.cos((2 * Math.PI * place) / WINDOW));
      }
      transform(re, im);
      const rows = new Float64Array(ROWS);
      for (let row = 0; row < ROWS; row += 1) {
        const bin = (hertz(row + 0.5, rate) * WINDOW) / rate;
        const [low, share] = [Math.floor(bin), bin % 1];
        const power = (at) => re[at] ** 2 + im[at] ** 2;
        rows[row] = (1 - share) * power(low) + share * power(low + 1);
      }
      found.push(rows);
    }
    return found;
  }

  const hertz = (row, rate) => LOW_HZ * (rate / 2 / LOW_HZ) ** (row / ROWS);

  function colour(share) {
    const at = Math.min(0.9999, Math.max(0, share)) * (COLOURS.length - 1);
    const [from, to] = [COLOURS[Math.floor(at)], COLOURS[Math.floor(at) + 1]];
    return from.map((one, channel) => one + (at % 1) * (to[channel] - one));
  }

  // Round times after 0 on an axis, five at most: a one, a two or a five apart.
  function ticks(seconds) {
    const ten = 10 ** Math.floor(Math.log10(seconds / 5));
    const step = ten * [1, 2, 5, 10].find((one) => 5 * one * ten >= seconds * (1 - 1e-9));
    return Array.from({ length: Math.floor(seconds / step + 1e-9) }, (_, place) => step * (place + 1));
  }

  // Returns {element, show(samples, rate), follow(voice)}; `seconds` is the length of the axis, `audio` how sounds end.
  function create(seconds, audio) {
    const canvas = make("canvas", {
      width: COLUMNS,
      height: ROWS,
      role: "img",
      "aria-label": "Spectrogram of the last strike",
    });
    const cursor = make("i.cursor", { hidden: true });
    const marks = ticks(seconds).map((time) => {
      const share = time / seconds;
      return make("span", { style: `left:${100 * share}%`, class: share > 0.96 && "end" }, words.duration(time));
    });
    const heights = make("div.heights", { "aria-hidden": "true" });
    const note = make("p.note");
    const root = make(
      "figure.spectrogram",
      make(
        "figcaption",
        make("strong", "Sound"),
        make("span.of", `the same ${words.duration(seconds, 2)} for every material and body`),
      ),
      make("div.picture", canvas, heights, cursor),
      make("div.times", { "aria-hidden": "true" }, make("span", { style: "left:0" }, "0"), marks),
      note,
    );
    let frame = 0;

    function show(samples, rate) {
      const columns = powers(samples, rate, seconds);
      const most = columns.reduce((best, rows) => Math.max(best, ...rows), 0) || 1;
      const picture = new ImageData(COLUMNS, ROWS);
      for (let column = 0; column < COLUMNS; column += 1) {
        for (let row = 0; row < ROWS; row += 1) {
          const power = column < columns.length ? columns[column][row] : 0;
          const at = 4 * ((ROWS - 1 - row) * COLUMNS + column);
          picture.data.set([...colour(1 + (10 * Math.log10(power / most + 1e-12)) / FLOOR_DB), 255], at);
        }
      }
      canvas.getContext("2d").putImageData(picture, 0, 0);
      const top = [500, 1000, 2000, 5000, 10000].filter((one) => one < rate / 2);
      heights.replaceChildren(
        ...top.map((one) => {
          const share = Math.log(one / LOW_HZ) / Math.log(rate / 2 / LOW_HZ);
          return make("b", { style: `bottom:${100 * share}%` }, one < 1000 ? `${one}` : `${one / 1000}k`);
        }),
      );
      const length = samples.length / rate;
      const said = [];
      if (length > 1.001 * seconds) said.push(`It lasts ${words.duration(length)}; the rest is not shown.`);
      if (length >= audio.max_s) said.push(`Sounds end after ${words.duration(audio.max_s)}; this one rings on.`);
      else if (length) {
        said.push(`After ${words.duration(length)} all modes together have fallen by ${audio.decay_db} dB.`);
      }
      note.textContent = said.join(" ");
    }

    // Moves the cursor with a voice of sound.js.
    function follow(voice, length) {
      cancelAnimationFrame(frame);
      const step = () => {
        const time = voice ? voice.time() : Infinity;
        cursor.hidden = !(time <= Math.min(length, seconds));
        cursor.style.left = `${(100 * time) / seconds}%`;
        if (!cursor.hidden) frame = requestAnimationFrame(step);
      };
      step();
    }

    return { element: root, show, follow };
  }

  return { create, transform, ticks };
})();

if (typeof module !== "undefined") module.exports = spectrogram;
