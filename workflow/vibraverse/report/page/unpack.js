// The data of a body as report/packing.py writes them, back to numbers; tests/test_page_body.py compares the two.
"use strict";

const unpack = (() => {
  const TYPES = {
    int16: Int16Array,
    uint16: Uint16Array,
    float32: Float32Array,
    float64: Float64Array,
  };

  async function inflated(base64) {
    const bytes = Uint8Array.from(atob(base64), (one) => one.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  // The values of a field. Its bytes lie in planes, the lowest byte of every value first.
  async function values(field) {
    const planes = await inflated(field.data);
    const Type = TYPES[field.type];
    const size = Type.BYTES_PER_ELEMENT;
    const count = planes.length / size;
    const bytes = new Uint8Array(planes.length);
    for (let plane = 0; plane < size; plane += 1) {
      for (let place = 0; place < count; place += 1) bytes[place * size + plane] = planes[plane * count + place];
    }
    const stored = new Type(bytes.buffer);
    const row = count / field.steps.length;
    if (field.steps.length === 1 && field.steps[0] === 1) return stored;
    return Float64Array.from(stored, (one, place) => one * field.steps[Math.floor(place / row)]);
  }

  // A body with the values of all its fields in place of the packed ones.
  async function body(data) {
    const found = { ...data, vertices: data.positions.shape[1], columnCount: data.columns.shape[0] };
    const fields = Object.keys(data).filter((name) => data[name] && data[name].data);
    await Promise.all(fields.map(async (name) => (found[name] = await values(data[name]))));
    found.modeCount = found.angular.length / found.poisson.length;
    return found;
  }

  // The angular frequencies of an unpacked body at a stop, for E = ρ = 1 and a mesh unit of 1 m.
  function angular(unpacked, stop) {
    return unpacked.angular.subarray(stop * unpacked.modeCount, (stop + 1) * unpacked.modeCount);
  }

  // The matrix (m, k) of the node nearest to a Poisson's ratio, row by row.
  function rotation(unpacked, node) {
    const size = unpacked.modeCount * unpacked.columnCount;
    return unpacked.rotations.subarray(node * size, (node + 1) * size);
  }

  // The motion (k) of the shape columns along a normal, at a place within a face by its barycentric coordinates.
  function gains(unpacked, face, barycentric, normal) {
    const found = new Float64Array(unpacked.columnCount);
    for (let corner = 0; corner < 3; corner += 1) {
      const vertex = unpacked.faces[3 * face + corner];
      for (let axis = 0; axis < 3; axis += 1) {
        const share = barycentric[corner] * normal[axis];
        for (let column = 0; column < found.length; column += 1) {
          found[column] += share * unpacked.columns[(3 * column + axis) * unpacked.vertices + vertex];
        }
      }
    }
    return found;
  }

  return { body, angular, rotation, gains };
})();

if (typeof module !== "undefined") module.exports = unpack;
