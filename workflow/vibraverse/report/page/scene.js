// The body as a model that turns and is struck: drawn with three (see front/), where the browser has WebGL. There is one
// canvas on the page; it is drawn anew only when something changes.
"use strict";

const scene = (() => {
  const CREASE = Math.cos((40 * Math.PI) / 180); // between faces; a larger angle looks sharp
  const VIEW_DEG = 28;
  const CLICK_PX = 6; // a pointer that moved farther was dragged
  const SWING = 0.11; // of the largest displacement of a mode that is shown, in mesh units
  const SWINGS_HZ = 1.2;
  const STEP = 0.12; // of a turn by a key, in radians
  let kept = null; // renderer, camera and what they show

  // Returns whether this browser can draw; the first call makes the renderer.
  function available() {
    if (typeof three === "undefined") return false;
    if (!kept) {
      try {
        kept = started();
      } catch {
        return false; // no WebGL
      }
    }
    return true;
  }

  function started() {
    const renderer = new three.WebGLRenderer({ antialias: true, alpha: true });
    renderer.toneMapping = three.NeutralToneMapping;
    renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    const world = new three.Scene();
    // Lights, and no picture of a room: without a GPU, blurring one for each roughness takes four seconds.
    const sky = new three.HemisphereLight(0xffffff, 0x8d8577, 1.5);
    sky.position.set(0, 0, 1); // z points up
    world.add(sky);
    const camera = new three.PerspectiveCamera(VIEW_DEG, 1, 0.1, 40);
    camera.up.set(0, 0, 1);
    for (const [strength, ...place] of [[3, -1.2, 1.3, 0.7], [0.7, 1.6, -0.3, 0.4]]) {
      const lamp = new three.DirectionalLight(0xffffff, strength);
      lamp.position.set(...place);
      camera.add(lamp);
    }
    world.add(camera);
    const geometry = new three.BufferGeometry();
    const material = new three.MeshStandardMaterial();
    const mesh = new three.Mesh(geometry, material);
    const marker = arrow();
    world.add(mesh, marker);
    const canvas = renderer.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "application");
    const orbit = new three.OrbitControls(camera, canvas);
    orbit.enablePan = false;
    orbit.rotateSpeed = 0.9;
    orbit.minDistance = 2.5;
    orbit.maxDistance = 14;
    canvas.style.touchAction = "pan-y"; // so that a finger can scroll past it
    return { renderer, world, camera, mesh, marker, orbit, canvas, body: null, frame: 0, move: null };
  }

  // A thin arrow that points at the origin from above; the mallet.
  function arrow() {
    const group = new three.Group();
    const paint = new three.MeshBasicMaterial();
    const shaft = new three.Mesh(new three.CylinderGeometry(0.012, 0.012, 0.24, 12), paint);
    const tip = new three.Mesh(new three.ConeGeometry(0.034, 0.09, 20), paint);
    const ball = new three.Mesh(new three.SphereGeometry(0.018, 16, 12), paint);
    shaft.position.y = 0.21;
    tip.position.y = 0.055;
    tip.rotation.x = Math.PI;
    group.add(shaft, tip, ball);
    group.visible = false;
    return group;
  }

  // Puts the model into an element. `onstrike` gets a place of the body; `onkey` a key that nothing here uses.
  function attach(host, { label, onstrike }) {
    const { canvas, orbit } = kept;
    host.prepend(canvas);
    canvas.setAttribute("aria-label", label);
    const draw = () => schedule();
    const sized = new ResizeObserver(() => resize(host));
    sized.observe(host);
    orbit.addEventListener("change", draw);
    const held = new AbortController();
    const listen = (target, name, handler, options = {}) =>
      target.addEventListener(name, handler, { ...options, signal: held.signal });
    let down = null;
    listen(canvas, "pointerdown", (event) => {
      down = event.isPrimary && event.button === 0 ? { x: event.clientX, y: event.clientY, dragged: false } : null;
    });
    listen(canvas, "pointermove", (event) => {
      if (down && Math.hypot(event.clientX - down.x, event.clientY - down.y) > CLICK_PX) down.dragged = true;
    });
    listen(canvas, "pointercancel", () => (down = null));
    listen(canvas, "pointerup", (event) => {
      const clicked = down && !down.dragged;
      down = null;
      if (!clicked) return;
      const box = canvas.getBoundingClientRect();
      const place = under(
        (2 * (event.clientX - box.left)) / box.width - 1,
        1 - (2 * (event.clientY - box.top)) / box.height,
      );
      if (place) onstrike(place);
    });
    listen(host, "wheel", (event) => event.ctrlKey || event.stopPropagation(), { capture: true }); // scrolls the page
    listen(canvas, "keydown", (event) => {
      const turns = { ArrowLeft: [-STEP, 0], ArrowRight: [STEP, 0], ArrowUp: [0, -STEP], ArrowDown: [0, STEP] };
      const nearer = { "+": 0.85, "=": 0.85, "-": 1 / 0.85 };
      if (turns[event.key]) turn(...turns[event.key]);
      else if (nearer[event.key]) kept.camera.position.multiplyScalar(nearer[event.key]);
      else if (event.key === "Enter") {
        const place = under(0, 0);
        if (place) onstrike(place);
      } else return;
      event.preventDefault();
      orbit.update();
      schedule();
    });
    return {
      detach() {
        move(null);
        held.abort();
        sized.disconnect();
        orbit.removeEventListener("change", draw);
        canvas.remove();
        kept.body = null;
      },
    };
  }

  function resize(host) {
    const { width, height } = host.getBoundingClientRect();
    if (!width || !height) return;
    kept.renderer.setSize(width, height, false);
    kept.camera.aspect = width / height;
    kept.camera.updateProjectionMatrix();
    schedule();
  }

  // Turns the camera around the body by azimuth and polar angle.
  function turn(azimuth, polar) {
    const { position } = kept.camera;
    const flat = Math.hypot(position.x, position.y);
    const distance = Math.hypot(flat, position.z);
    const around = Math.atan2(position.y, position.x) + azimuth;
    const down = Math.min(Math.PI - 0.05, Math.max(0.05, Math.atan2(flat, position.z) + polar));
    position.set(Math.sin(down) * Math.cos(around), Math.sin(down) * Math.sin(around), Math.cos(down));
    position.multiplyScalar(distance);
    kept.camera.lookAt(0, 0, 0);
  }

  // The place of the body at a point of the picture, from -1 to 1; null beside it.
  function under(x, y) {
    if (!kept.body) return null;
    const { camera } = kept;
    camera.updateMatrixWorld();
    const far = new three.Vector3(x, y, 0.5).unproject(camera);
    const origin = camera.position.toArray();
    return points.hit(
      kept.body,
      origin,
      far.toArray().map((one, axis) => one - origin[axis]),
    );
  }

  // Shows an unpacked body; `first` sets the camera so that it fits.
  function show(body, first) {
    const { mesh, camera } = kept;
    const places = new Float32Array(3 * body.faces.length);
    mesh.geometry.dispose();
    mesh.geometry = new three.BufferGeometry();
    for (const name of ["position", "normal"]) {
      const attribute = new three.BufferAttribute(name === "normal" ? new Float32Array(places.length) : places, 3);
      attribute.setUsage(three.DynamicDrawUsage);
      mesh.geometry.setAttribute(name, attribute);
    }
    kept.body = body;
    kept.smooth = neighbours(body);
    pose(null, 0);
    if (first) {
      let radius = 0;
      for (let vertex = 0; vertex < body.vertices; vertex += 1) {
        const [x, y, z] = [0, 1, 2].map((axis) => body.positions[axis * body.vertices + vertex]);
        radius = Math.max(radius, Math.hypot(x, y, z));
      }
      const distance = (1.06 * radius) / Math.sin((VIEW_DEG * Math.PI) / 360);
      const [azimuth, height] = [(25 * Math.PI) / 180, (24 * Math.PI) / 180];
      camera.position.set(
        distance * Math.cos(height) * Math.cos(azimuth),
        distance * Math.cos(height) * Math.sin(azimuth),
        distance * Math.sin(height),
      );
      camera.lookAt(0, 0, 0);
      kept.orbit.update();
    }
    schedule();
  }

  // For each corner of each face, the faces around its vertex that it is shaded together with.
  function neighbours(body) {
    const flat = faceNormals(body, body.positions);
    const around = Array.from({ length: body.vertices }, () => []);
    body.faces.forEach((vertex, corner) => around[vertex].push(Math.floor(corner / 3)));
    return Array.from(body.faces, (vertex, corner) => {
      const own = Math.floor(corner / 3);
      return around[vertex].filter((face) => {
        const [a, b] = [flat.subarray(3 * own, 3 * own + 3), flat.subarray(3 * face, 3 * face + 3)];
        const cosine = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        return cosine > CREASE * Math.hypot(...a) * Math.hypot(...b) || face === own;
      });
    });
  }

  // Twice the area of each face times its normal.
  function faceNormals(body, positions) {
    const found = new Float64Array(body.faces.length);
    const at = (vertex, axis) => positions[axis * body.vertices + vertex];
    for (let face = 0; 3 * face < body.faces.length; face += 1) {
      const [a, b, c] = body.faces.subarray(3 * face, 3 * face + 3);
      const [x1, y1, z1] = [at(b, 0) - at(a, 0), at(b, 1) - at(a, 1), at(b, 2) - at(a, 2)];
      const [x2, y2, z2] = [at(c, 0) - at(a, 0), at(c, 1) - at(a, 1), at(c, 2) - at(a, 2)];
      found[3 * face] = y1 * z2 - z1 * y2;
      found[3 * face + 1] = z1 * x2 - x1 * z2;
      found[3 * face + 2] = x1 * y2 - y1 * x2;
    }
    return found;
  }

  // Moves the vertices by a share of a shape, and shades them.
  function pose(shape, share) {
    const { body, mesh, smooth } = kept;
    const moved = shape ? body.positions.map((one, place) => one + share * shape[place]) : body.positions;
    const flat = faceNormals(body, moved);
    const { position, normal } = mesh.geometry.attributes;
    for (let corner = 0; corner < body.faces.length; corner += 1) {
      let [x, y, z] = [0, 0, 0];
      for (const face of smooth[corner]) {
        x += flat[3 * face];
        y += flat[3 * face + 1];
        z += flat[3 * face + 2];
      }
      const length = Math.hypot(x, y, z) || 1;
      const vertex = body.faces[corner];
      position.setXYZ(corner, moved[vertex], moved[body.vertices + vertex], moved[2 * body.vertices + vertex]);
      normal.setXYZ(corner, x / length, y / length, z / length);
    }
    position.needsUpdate = true;
    normal.needsUpdate = true;
    if (!shape) mesh.geometry.computeBoundingSphere();
  }

  // Shows a mode moving, from its shape as in struck.js; null stops.
  function move(shape) {
    cancelAnimationFrame(kept.swing);
    if (!kept.body) return;
    if (!shape) {
      pose(null, 0);
      schedule();
      return;
    }
    let most = 0;
    const { vertices } = kept.body;
    for (let vertex = 0; vertex < vertices; vertex += 1) {
      most = Math.max(most, Math.hypot(shape[vertex], shape[vertices + vertex], shape[2 * vertices + vertex]));
    }
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const swing = (time) => {
      pose(shape, (SWING / most) * (still ? 1 : Math.sin((2 * Math.PI * SWINGS_HZ * time) / 1000)));
      draw();
      if (!still) kept.swing = requestAnimationFrame(swing);
    };
    kept.swing = requestAnimationFrame(swing);
  }

  // Marks the struck place; null marks none. `colour` is that of a style sheet.
  function mark(place, colour) {
    const { marker } = kept;
    marker.visible = Boolean(place);
    if (place) {
      marker.position.set(...place.position);
      marker.quaternion.setFromUnitVectors(new three.Vector3(0, 1, 0), new three.Vector3(...place.normal));
      marker.children.forEach((one) => one.material.color.set(colour));
    }
    schedule();
  }

  // Gives the body the look of its material: {colour, metallic, roughness, clear}.
  function dress(look) {
    const { material } = kept.mesh;
    const shade = look.clear ? 0.8 : 1; // what is seen through it is bright or dark, and it must differ from both
    material.color = new three.Color().setRGB(...look.colour.map((one) => shade * one), "srgb");
    material.metalness = 0.45 * look.metallic; // a whole metal is black where it has nothing to mirror
    material.roughness = Math.max(look.roughness, 0.25);
    material.transparent = look.clear;
    material.opacity = look.clear ? 0.72 : 1;
    material.needsUpdate = true;
    schedule();
  }

  function schedule() {
    cancelAnimationFrame(kept.frame);
    kept.frame = requestAnimationFrame(draw);
  }

  const draw = () => kept.renderer.render(kept.world, kept.camera);

  return { available, attach, show, move, mark, dress };
})();
