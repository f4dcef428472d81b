// A sound as a WAV file with 24 bits, which says what it is. Nothing here touches the page.
"use strict";

const wav = (() => {
  const FULL = 0x7fffff;

  // The bytes of a mono file. `samples` are from -1 to 1; `info` maps names of RIFF INFO fields, such as INAM, to texts.
  function bytes(samples, rate, info) {
    const listed = chunk("LIST", [
      ascii("INFO"),
      ...Object.entries(info).map(([name, text]) => chunk(name, [utf8(text)])),
    ]);
    const format = new DataView(new ArrayBuffer(16));
    [1, 1].forEach((value, place) => format.setUint16(2 * place, value, true)); // PCM, mono
    format.setUint32(4, rate, true);
    format.setUint32(8, 3 * rate, true);
    format.setUint16(12, 3, true);
    format.setUint16(14, 24, true);
    const data = new Uint8Array(3 * samples.length);
    samples.forEach((one, place) => {
      const value = Math.round(FULL * Math.min(1, Math.max(-1, one)));
      for (let byte = 0; byte < 3; byte += 1) data[3 * place + byte] = (value >> (8 * byte)) & 0xff;
    });
    const parts = [ascii("WAVE"), chunk("fmt ", [new Uint8Array(format.buffer)]), listed, chunk("data", [data])];
    return chunk("RIFF", parts);
  }

  function chunk(name, parts) {
    const size = parts.reduce((sum, one) => sum + one.length, 0);
    const found = new Uint8Array(8 + size + (size % 2)); // chunks begin at even places
    found.set(ascii(name));
    new DataView(found.buffer).setUint32(4, size, true);
    let place = 8;
    for (const part of parts) {
      found.set(part, place);
      place += part.length;
    }
    return found;
  }

  const ascii = (text) => Uint8Array.from(text, (one) => one.charCodeAt(0));
  const utf8 = (text) => new Uint8Array([...new TextEncoder().encode(text), 0]);

  return { bytes };
})();

if (typeof module !== "undefined") module.exports = wav;
