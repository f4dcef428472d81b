/* The behaviour of the page of the dataset: filter, pictures that turn, and the strip of modes. */
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const { all, one, clamp, player } = shared;

  /* Numbers as people read them: three significant digits. */
  const plain = (value) => Number(value.toPrecision(3)).toLocaleString("en", { maximumFractionDigits: 20 });
  const hertz = (value) => (value < 10000 ? `${plain(value)} Hz` : `${plain(value / 1000)} kHz`);
  const seconds = (value) => (value <= 0 ? "does not ring" : value < 1 ? `${plain(value * 1000)} ms` : `${plain(value)} s`);

  /* The frequency axis is the same for every object, so that bodies can be compared down the page. */
  const [lowest, highest] = data.range_hz;
  const across = (hz) => Math.log(hz / lowest) / Math.log(highest / lowest);
  /* A stroke's length is the logarithm of its ring time, 1 ms to 10 s. */
  const strength = (ring) => (ring > 0 ? clamp((Math.log10(ring) + 3) / 4, 0.06, 1) : 0.06);

  /* The head's fingerprint: one row per body. */
  const fingerprint = one("#fingerprint");
  let fingerprintMaterial = data.materials[0];
  function drawFingerprint() {
    if (!fingerprint) return;
    const ratio = devicePixelRatio || 1;
    const rows = Object.values(data.objects).flatMap((object) =>
      Object.entries(object.modes[fingerprintMaterial] || {}));
    const width = fingerprint.clientWidth, height = clamp(rows.length * 9, 54, 200);
    fingerprint.style.height = `${height}px`;
    fingerprint.width = width * ratio;
    fingerprint.height = height * ratio;
    const brush = fingerprint.getContext("2d");
    const style = getComputedStyle(document.documentElement);
    const step = (height * ratio) / rows.length;
    brush.lineWidth = 1.4 * ratio;
    rows.forEach(([solidity, [frequencies, rings]], row) => {
      brush.strokeStyle = style.getPropertyValue(`--${solidity}`);
      frequencies.forEach((hz, mode) => {
        const x = across(hz) * width * ratio;
        brush.globalAlpha = 0.25 + 0.75 * strength(rings[mode]) ** 2;
        brush.beginPath();
        brush.moveTo(x, row * step + step * 0.1);
        brush.lineTo(x, row * step + step * 0.9);
        brush.stroke();
      });
    });
    one("#fingerprint-material").textContent = fingerprintMaterial;
  }

  /* The strip of modes: solid up, hollow down. */
  const WIDTH = 1000, HEIGHT = 132, MIDDLE = 58, REACH = 50;
  function strip(card, id) {
    const element = one(".strip", card);
    const reading = one(".reading", card);
    const table = one("details", card);
    let bodies = {}, mode = 0, material = "";
    const read = () => {
      const words = [`<b>mode ${mode + 1}</b>`];
      for (const [solidity, [frequencies, rings]] of Object.entries(bodies))
        if (frequencies[mode] !== undefined)
          words.push(`<span class="${solidity}">${solidity} ${hertz(frequencies[mode])}</span>, ${rings[mode] > 0 ? "rings " : ""}${seconds(rings[mode])}`);
      reading.innerHTML = words.join(" &ensp; ");
      element.setAttribute("aria-valuenow", mode + 1);
      element.setAttribute("aria-valuetext", reading.textContent);
      all("line.now", element).forEach((line) => line.classList.remove("now"));
      all(`line[data-mode="${mode}"]`, element).forEach((line) => line.classList.add("now"));
    };
    const fill = () => {
      if (!table.open) return;
      const names = Object.keys(bodies);
      const count = Math.max(...names.map((name) => bodies[name][0].length));
      const head = names.map((name) => `<th scope="col">${name} Hz</th><th scope="col">rings s</th>`).join("");
      const body = (index) => names.map((name) => {
        const [frequencies, rings] = bodies[name];
        return `<td>${frequencies[index] === undefined ? "–" : plain4(frequencies[index])}</td><td>${rings[index] > 0 ? plain(rings[index]) : "–"}</td>`;
      }).join("");
      const chunk = Math.ceil(count / 3);
      const parts = [];
      for (let start = 0; start < count; start += chunk) {
        const rows = [];
        for (let index = start; index < Math.min(count, start + chunk); index++)
          rows.push(`<tr><th scope="row">${index + 1}</th>${body(index)}</tr>`);
        parts.push(`<table><thead><tr><th scope="col">mode</th>${head}</tr></thead><tbody>${rows.join("")}</tbody></table>`);
      }
      one(".table", table).innerHTML = parts.join("");
    };
    const plain4 = (value) => Number(value.toPrecision(5)).toLocaleString("en", { maximumFractionDigits: 20 });
    const draw = () => {
      const parts = [];
      const heard = across(20000);
      if (heard < 1) parts.push(`<rect class="unheard" x="${heard * WIDTH}" y="0" width="${(1 - heard) * WIDTH}" height="${HEIGHT}"/>`);
      data.ticks_hz.forEach((hz) => parts.push(`<line class="tick" x1="${across(hz) * WIDTH}" x2="${across(hz) * WIDTH}" y1="0" y2="${HEIGHT}"/>`));
      for (const [solidity, [frequencies, rings]] of Object.entries(bodies))
        frequencies.forEach((hz, index) => {
          const x = (across(hz) * WIDTH).toFixed(2);
          const y = MIDDLE + (solidity === "solid" ? -REACH : REACH) * strength(rings[index]);
          parts.push(`<line class="${solidity}${rings[index] > 0 ? "" : " silent"}" data-mode="${index}" x1="${x}" x2="${x}" y1="${MIDDLE}" y2="${y.toFixed(1)}"/>`);
        });
      parts.push(`<line class="axis" x1="0" x2="${WIDTH}" y1="${MIDDLE}" y2="${MIDDLE}"/>`);
      const labels = data.ticks_hz.filter((hz) => across(hz) < 0.98 && across(hz) > 0.02)
        .map((hz) => `<b class="${/^1/.test(hz) ? "" : "minor"}" style="left:${100 * across(hz)}%">${hz < 1000 ? hz : `${hz / 1000} k`}</b>`);
      if (heard < 0.86) labels.push(`<i style="left:${100 * heard}%">beyond hearing</i>`);
      for (const solidity of Object.keys(bodies)) labels.push(`<em class="${solidity}">${solidity}</em>`);
      element.innerHTML = `<svg viewBox="0 0 ${WIDTH} ${HEIGHT}" preserveAspectRatio="none" aria-hidden="true">${parts.join("")}</svg>${labels.join("")}`;
    };
    element.addEventListener("pointermove", (event) => {
      const box = element.getBoundingClientRect();
      const x = (event.clientX - box.left) / box.width;
      const wanted = (event.clientY - box.top) / box.height < MIDDLE / HEIGHT ? "solid" : "hollow";
      const [frequencies] = bodies[wanted] || Object.values(bodies)[0] || [[]];
      let nearest = 0;
      frequencies.forEach((hz, index) => {
        if (Math.abs(across(hz) - x) < Math.abs(across(frequencies[nearest]) - x)) nearest = index;
      });
      mode = nearest;
      read();
    });
    element.addEventListener("keydown", (event) => {
      const last = Math.max(...Object.values(bodies).map(([frequencies]) => frequencies.length)) - 1;
      const next = { ArrowLeft: mode - 1, ArrowRight: mode + 1, Home: 0, End: last, PageUp: mode + 8, PageDown: mode - 8 }[event.key];
      if (next === undefined) return;
      event.preventDefault();
      mode = clamp(next, 0, last);
      read();
    });
    table.addEventListener("toggle", fill);
    return (name) => {
      if (name === material) return;
      material = name;
      bodies = data.objects[id].modes[name] || {};
      one(".of", card).textContent = `in ${name}`;
      draw();
      read();
      fill();
    };
  }

  /* Pictures: drag or slide to turn, choose a look. */
  function viewer(card, id) {
    const picture = one(".view", card);
    if (!picture) return () => {};
    const turn = one(".turn", card);
    const { pictures } = data.objects[id];
    let look = one(".looks input:checked", card).value;
    const show = () => { picture.src = `${data.assets}/${pictures[look][Number(turn.value)]}`; };
    const step = (views) => {
      const count = pictures[look].length;
      turn.value = (((Number(turn.value) + views) % count) + count) % count;
      show();
    };
    turn.addEventListener("input", show);
    all(".looks input", card).forEach((input) => input.addEventListener("change", () => { look = input.value; show(); }));
    let from = null;
    picture.addEventListener("pointerdown", (event) => { from = event.clientX; picture.setPointerCapture(event.pointerId); });
    picture.addEventListener("pointerup", () => { from = null; });
    picture.addEventListener("pointercancel", () => { from = null; });
    picture.addEventListener("pointermove", (event) => {
      if (from === null || Math.abs(event.clientX - from) < 36) return;
      step(event.clientX > from ? -1 : 1);
      from = event.clientX;
    });
    return (name) => {
      const input = all(".looks input", card).find((other) => other.value === name);
      if (!input || look === name) return;
      input.checked = true;
      look = name;
      show();
    };
  }

  /* A card: choosing a material shows its modes, and its look too once somebody has chosen. */
  const cards = all(".card").map((card) => {
    const { id } = card;
    const showModes = strip(card, id);
    const showLook = viewer(card, id);
    const choose = (name, withLook = true) => {
      all(".row", card).forEach((row) => {
        const chosen = row.dataset.material === name;
        row.classList.toggle("chosen", chosen);
        one(".material", row).setAttribute("aria-pressed", chosen);
      });
      showModes(name);
      if (withLook) showLook(name);
    };
    all(".row", card).forEach((row) => {
      one(".material", row).addEventListener("click", () => choose(row.dataset.material));
      all("audio", row).forEach((audio) => player(audio.parentElement, () => choose(row.dataset.material)));
    });
    const first = one(".row", card);
    if (first) choose(first.dataset.material, false);
    return { card, id, choose };
  });

  /* Filters. */
  const find = one("#find");
  if (find) {
    const family = one("#family");
    const filter = () => {
      const words = find.value.toLowerCase().split(/\s+/).filter(Boolean);
      const material = one(".segments input:checked").value;
      let count = 0;
      cards.forEach(({ card, id, choose }) => {
        const name = card.dataset.name.toLowerCase();
        const fits = words.every((word) => name.includes(word)) && (!family.value || card.dataset.family === family.value);
        card.hidden = !fits;
        one(`.gallery li[data-of="${CSS.escape(id)}"]`).hidden = !fits;
        count += fits;
        all(".row", card).forEach((row) => { row.hidden = Boolean(material) && row.dataset.material !== material; });
        if (material) choose(material);
      });
      shared.pauseHidden();
      one("#shown").textContent = `${count} ${count === 1 ? "object" : "objects"}`;
      one(".empty").hidden = count > 0;
      if (material && material !== fingerprintMaterial) {
        fingerprintMaterial = material;
        drawFingerprint();
      }
    };
    [find, family, ...all(".segments input")].forEach((input) => input.addEventListener("input", filter));
    one(".filters").addEventListener("submit", (event) => event.preventDefault());
    one("#reset").addEventListener("click", () => {
      find.value = family.value = "";
      filter();
      find.focus();
    });
    addEventListener("keydown", (event) => {
      if (event.key === "/" && !/INPUT|SELECT|TEXTAREA/.test(document.activeElement.tagName)) {
        event.preventDefault();
        find.focus();
      }
    });
  }
  /* Pages of the same dataset are the same wherever they lie: which folder to name is known when one is opened there. */
  const retry = one("#retry");
  if (retry && location.protocol === "file:") {
    const results = decodeURIComponent(location.pathname).split("/").slice(0, -2).join("/") || "/";
    const plainly = /^[\w@%+=:,./-]+$/.test(results);
    retry.textContent = `vibraverse refusals --results ${plainly ? results : `'${results.replaceAll("'", `'"'"'`)}'`} --retry`;
    one("#where").hidden = true;
  }
  addEventListener("resize", drawFingerprint);
  shared.themes(drawFingerprint);
})();
