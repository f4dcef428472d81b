// Small plots whose bars are links. Each plot is one stop of the Tab key; arrows move from bar to bar.
"use strict";

const plots = (() => {
  const { draw, make } = elements;
  const WIDTH = 360;
  const MOST_BINS = 22;
  const LETTER = 7; // width of a letter at a tick
  const FINENESS = [12, 9, 6, 4, 3, 2, 1]; // bins in a factor of ten

  // Logarithmic bins for positive values, as their edges; few enough to be hit with a finger.
  function edges(values) {
    const [low, high] = values.reduce(
      ([least, most], one) => [Math.min(least, one), Math.max(most, one)],
      [Infinity, 0],
    );
    for (const fineness of FINENESS) {
      const first = Math.floor(Math.log10(low) * fineness);
      const last = Math.floor(Math.log10(high) * fineness) + 1;
      if (last - first <= MOST_BINS || fineness === 1) {
        const at = (step) => Number((10 ** (step / fineness)).toPrecision(5));
        return Array.from({ length: last - first + 1 }, (_, step) => at(first + step));
      }
    }
    return [];
  }

  function counted(values, ends) {
    const counts = new Array(ends.length - 1).fill(0);
    for (const value of values) {
      let bin = 0;
      while (bin < counts.length - 1 && value >= ends[bin + 1]) bin += 1;
      counts[bin] += 1;
    }
    return counts;
  }

  // Powers of ten within a span, or 1, 2 and 5 times them where those are few.
  function ticks(low, high) {
    const found = [];
    for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power += 1) {
      for (const step of [1, 2, 5]) found.push(Number((step * 10 ** power).toPrecision(1)));
    }
    const inside = found.filter((one) => one >= low * 0.999 && one <= high * 1.001);
    const tens = inside.filter((one) => /^[0.]*1/.test(String(one)));
    return inside.length <= 7 || tens.length < 2 ? inside : tens;
  }

  const across = (value, ends, left, width) =>
    left + (width * Math.log(value / ends[0])) / Math.log(ends[ends.length - 1] / ends[0]);

  function scale(ends, left, width, y, say) {
    let free = left + 8; // where the next text may begin
    const marks = ticks(ends[0], ends[ends.length - 1]).filter((one) => {
      const x = across(one, ends, left, width);
      const half = (LETTER * say(one).length) / 2;
      if (x - half < free - 8 || x + half > left + width + 4) return false;
      free = x + half + 14;
      return true;
    });
    return marks.map((one) =>
      draw(
        "g.tick",
        { transform: `translate(${across(one, ends, left, width)} ${y})` },
        draw("line", { y2: 4 }),
        draw("text", { y: 16 }, say(one)),
      ),
    );
  }

  // Bars of one row: `series` are {name, values}, drawn one on the other; `href(low, high)` is where a bar leads.
  function row(series, ends, box, say, href) {
    const counts = series.map(({ values }) => counted(values, ends));
    const totals = ends.slice(1).map((_, bin) => counts.reduce((sum, some) => sum + some[bin], 0));
    const most = Math.max(1, ...totals);
    return totals.flatMap((total, bin) => {
      if (!total) return [];
      const x = across(ends[bin], ends, box.left, box.width);
      const wide = Math.max(1.5, across(ends[bin + 1], ends, box.left, box.width) - x - 1.5);
      const said = counts.map((some, which) => [some[bin], series[which].name]).filter(([count]) => count);
      const bodies = said.map(([count, name]) => `${words.count(count)} ${name}`).join(", ");
      const label = `${words.between([ends[bin], ends[bin + 1]], say)}: ${bodies}`;
      let y = box.bottom;
      const parts = said.map(([count, name]) => {
        const high = (box.height * count) / most;
        y -= high;
        return draw("rect", { class: name, x, y, width: wide, height: Math.max(0.5, high) });
      });
      const reach = draw("rect.reach", { x, y: box.bottom - box.height, width: wide, height: box.height });
      return [
        draw(
          "a.bar",
          { href: href(ends[bin], ends[bin + 1]), "aria-label": label },
          draw("title", label),
          reach,
          parts,
        ),
      ];
    });
  }

  function figure(title, note, content, wide = false) {
    return make(
      "figure",
      { class: wide ? "plot wide" : "plot" },
      make("figcaption", make("strong", title), note && make("small", note)),
      content,
    );
  }

  // A histogram on a logarithmic axis; null without values. `mark` is a value with a line of its own.
  function histogram({ title, note, series, say, href, mark }) {
    const values = series.flatMap((one) => one.values);
    if (!values.length) return null;
    const ends = edges(mark ? [...values, mark] : values);
    const box = { left: 4, width: WIDTH - 8, bottom: 118, height: 104 };
    const bars = row(series, ends, box, say, href);
    const svg = draw(
      "svg",
      { viewBox: `0 0 ${WIDTH} 142`, role: "group", "aria-label": title },
      draw("line.axis", { x1: box.left, x2: box.left + box.width, y1: box.bottom, y2: box.bottom }),
      mark &&
        draw("line.mark", {
          x1: across(mark, ends, box.left, box.width),
          x2: across(mark, ends, box.left, box.width),
          y1: 8,
          y2: box.bottom,
        }),
      scale(ends, box.left, box.width, box.bottom, say),
      bars,
    );
    elements.rove(svg, bars);
    return figure(title, note, svg);
  }

  // Histograms below one another on a common axis: `rows` are {name, series, href}.
  function ridges({ title, note, rows, say }) {
    const values = rows.flatMap((one) => one.series.flatMap((some) => some.values));
    if (!values.length) return null;
    const ends = edges(values);
    const [step, left] = [34, 74];
    const bottom = rows.length * step + 4;
    const bars = [];
    const parts = rows.map((one, place) => {
      const box = { left, width: WIDTH - left - 4, bottom: (place + 1) * step, height: step - 8 };
      const own = row(one.series, ends, box, (value) => say(value), one.href);
      own.forEach((bar) => bar.setAttribute("aria-label", `${one.name}, ${bar.getAttribute("aria-label")}`));
      bars.push(...own);
      return [
        draw(
          "text.name",
          { x: left - 8, y: box.bottom - 5 },
          one.name.length > 11 ? `${one.name.slice(0, 10)}…` : one.name,
        ),
        draw("line.axis", { x1: left, x2: WIDTH - 4, y1: box.bottom, y2: box.bottom }),
        own,
      ];
    });
    const svg = draw(
      "svg",
      { viewBox: `0 0 ${WIDTH} ${bottom + 22}`, role: "group", "aria-label": title },
      parts.flat(),
      scale(ends, left, WIDTH - left - 4, bottom - 4, say),
    );
    elements.rove(svg, bars);
    return figure(title, note, svg);
  }

  // Bars with names: `rows` are {name, value, said, href}, drawn from 0 to the largest.
  function bars({ title, note, rows }) {
    if (!rows.length) return null;
    const most = Math.max(...rows.map((one) => one.value));
    const links = rows.map((one) =>
      make(
        "a.named",
        { href: one.href },
        make("span.what", one.name),
        make("span.said", one.said),
        make("span.length", { "aria-hidden": "true", style: `--share: ${most > 0 ? one.value / most : 0}` }),
      ),
    );
    const list = make("div.bars", { role: "group", "aria-label": title }, links);
    elements.rove(list, links);
    return title ? figure(title, note, list, true) : list;
  }

  // Errors against unknowns, both logarithmic, of a body: {title, convergence: {kind: {unknowns, errors, slope}}}.
  function convergence(body, limits) {
    const [left, wide, top, bottom] = [38, 190, 10, 116];
    const x = (value) => across(value, limits.unknowns, left, wide);
    const y = (value) => bottom - across(value, limits.errors, 0, bottom - top);
    const curves = Object.entries(body.convergence).map(([kind, { unknowns, errors, slope }]) => {
      const [order, corrected] = kind.split(" ");
      const points = unknowns.map((one, place) => [x(one), y(errors[place])]);
      const [lastX, lastY] = points[points.length - 1];
      return draw(
        "g",
        { class: `curve ${order}${corrected ? "" : " dotted"}` },
        draw("polyline", { points: points.map((point) => point.join()).join(" ") }),
        points.map(([cx, cy]) => draw("circle", { cx, cy, r: 2.4 })),
        slope !== null && draw("text", { x: lastX + 6, y: lastY + 3 }, slope.toFixed(2).replace("-", "−")),
      );
    });
    const rows = ticks(...limits.errors).map((one) =>
      draw(
        "g",
        draw("line.grid", { x1: left, x2: left + wide, y1: y(one), y2: y(one) }),
        draw("text.side", { x: left - 5, y: y(one) + 3 }, `${Number((100 * one).toPrecision(1))} %`),
      ),
    );
    return draw(
      "svg",
      { viewBox: "0 0 260 136", role: "img", "aria-label": `${body.title}: errors against unknowns` },
      rows,
      scale(limits.unknowns, left, wide, bottom, (one) => (one < 1e4 ? words.count(one) : `${one / 1000} k`)),
      curves,
    );
  }

  return { histogram, ridges, bars, convergence, edges, counted };
})();

if (typeof module !== "undefined") module.exports = plots;
