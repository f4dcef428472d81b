// Places on the surface of an unpacked body: where a ray meets it, what is nearest, and named ones all around. A place
// is {face, barycentric, position, normal}, in mesh units. Nothing here touches the page.
"use strict";

const points = (() => {
  const AWAY = 6; // beyond every body, which lies within ±0.9
  const SAME = 1e-9;
  const SIDES = [
    ["front", [1, 0, 0]],
    ["back", [-1, 0, 0]],
    ["right", [0, 1, 0]],
    ["left", [0, -1, 0]],
    ["top", [0, 0, 1]],
    ["bottom", [0, 0, -1]],
  ];

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const plus = (a, b, share) => [a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const size = (a) => Math.sqrt(dot(a, a));
  const unit = (a) => a.map((one) => one / size(a));

  const vertex = (body, place) => [0, 1, 2].map((axis) => body.positions[axis * body.vertices + place]);
  const corners = (body, face) => [0, 1, 2].map((corner) => vertex(body, body.faces[3 * face + corner]));
  const normalOf = ([a, b, c]) => unit(cross(minus(b, a), minus(c, a)));

  function place(body, face, barycentric) {
    const triangle = corners(body, face);
    const position = triangle.reduce((sum, one, corner) => plus(sum, one, barycentric[corner]), [0, 0, 0]);
    return { face, barycentric, position, normal: normalOf(triangle) };
  }

  // The first place of the surface along a ray that comes from outside; null where it misses (Möller and Trumbore,
  // J. Graph. Tools 2, 21, 1997).
  function hit(body, origin, direction) {
    let best = null;
    for (let face = 0; 3 * face < body.faces.length; face += 1) {
      const [a, b, c] = corners(body, face);
      const [first, second] = [minus(b, a), minus(c, a)];
      const side = cross(direction, second);
      const determinant = dot(first, side);
      if (determinant <= 0) continue; // seen from behind
      const start = minus(origin, a);
      const u = dot(start, side) / determinant;
      if (u < 0 || u > 1) continue;
      const other = cross(start, first);
      const v = dot(direction, other) / determinant;
      if (v < 0 || u + v > 1) continue;
      const distance = dot(second, other) / determinant;
      if (distance > 0 && (!best || distance < best.distance))
        best = { distance, face, barycentric: [1 - u - v, u, v] };
    }
    return best && place(body, best.face, best.barycentric);
  }

  // Barycentric coordinates of the point of a triangle that is nearest to `point`.
  function inTriangle(triangle, point) {
    const normal = cross(minus(triangle[1], triangle[0]), minus(triangle[2], triangle[0]));
    const area = dot(normal, normal);
    const inside = [0, 1, 2].map((corner) => {
      const [b, c] = [triangle[(corner + 1) % 3], triangle[(corner + 2) % 3]];
      return dot(normal, cross(minus(c, b), minus(point, b))) / area;
    });
    if (inside.every((one) => one >= 0)) return inside;
    let best = null;
    for (let start = 0; start < 3; start += 1) {
      const end = (start + 1) % 3;
      const side = minus(triangle[end], triangle[start]);
      const along = Math.min(1, Math.max(0, dot(minus(point, triangle[start]), side) / dot(side, side)));
      const distance = size(minus(point, plus(triangle[start], side, along)));
      if (!best || distance < best.distance) best = { distance, start, end, along };
    }
    const found = [0, 0, 0];
    found[best.start] = 1 - best.along;
    found[best.end] = best.along;
    return found;
  }

  // The angle of a triangle at a place in it: 2π inside, π on an edge, else that of the corner.
  function angleAt(triangle, barycentric) {
    const touched = [0, 1, 2].filter((corner) => barycentric[corner] > SAME);
    if (touched.length > 1) return Math.PI * (touched.length - 1);
    const [a, b, c] = [0, 1, 2].map((turn) => triangle[(touched[0] + turn) % 3]);
    const [first, second] = [minus(b, a), minus(c, a)];
    return Math.atan2(size(cross(first, second)), dot(first, second));
  }

  // The place of the surface that is nearest to a point. On an edge or at a corner the normal is the mean over the faces
  // there, weighted by angle, as in physics/impulse.py.
  function nearest(body, point) {
    let found = [];
    let distance = Infinity;
    for (let face = 0; 3 * face < body.faces.length; face += 1) {
      const barycentric = inTriangle(corners(body, face), point);
      if (!barycentric.every(Number.isFinite)) continue; // a face without an area
      const here = place(body, face, barycentric);
      here.distance = size(minus(here.position, point));
      distance = Math.min(distance, here.distance);
      found.push(here);
    }
    found = found.filter((one) => one.distance <= distance + SAME);
    const best = found[0];
    const meeting = found.filter((one) => size(minus(one.position, best.position)) <= SAME);
    const mean = meeting.reduce(
      (sum, one) => plus(sum, one.normal, angleAt(corners(body, one.face), one.barycentric)),
      [0, 0, 0],
    );
    const normal = size(mean) > SAME ? unit(mean) : best.normal;
    return { face: best.face, barycentric: best.barycentric, position: best.position, normal };
  }

  // Places with names: the six sides and the eight corners between them, each where a ray to the middle meets the body;
  // where it meets none, as in a ring, at the vertex that lies farthest in that direction.
  function named(body) {
    const directions = [...SIDES];
    for (const [depth, x] of SIDES.slice(0, 2)) {
      for (const [across, y] of SIDES.slice(2, 4)) {
        for (const [height, z] of SIDES.slice(4, 6)) {
          directions.push([`${depth} ${across} ${height}`, unit([x[0], y[1], z[2]])]);
        }
      }
    }
    return directions.map(([name, direction]) => {
      const origin = direction.map((one) => AWAY * one);
      const back = direction.map((one) => -one);
      return { name, ...(hit(body, origin, back) || nearest(body, farthest(body, direction))) };
    });
  }

  function farthest(body, direction) {
    let best = vertex(body, 0);
    for (let number = 1; number < body.vertices; number += 1) {
      const here = vertex(body, number);
      if (dot(here, direction) > dot(best, direction)) best = here;
    }
    return best;
  }

  return { hit, nearest, named };
})();

if (typeof module !== "undefined") module.exports = points;
