"use strict";
// Draws the page's data. Positions are in m, colors and curves in the units of their quantities. All text
// from the data is set as text, never as HTML.
(async function () {
  const byId = (id) => document.getElementById(id);
  const fail = (message) => {
    byId("problem").textContent = message;
    byId("problem").hidden = false;
  };

  // ---- Data -------------------------------------------------------------------------------------------

  const data = JSON.parse(byId("content").textContent);
  let bytes;
  try {
    const packed = Uint8Array.from(atob(byId("block").textContent.trim()), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    bytes = await new Response(stream).arrayBuffer();
  } catch (error) {
    fail("The numbers of this page cannot be read: the file is damaged, or the browser is older than 2023.");
    return;
  }
  const KINDS = { int16: Int16Array, uint16: Uint16Array, uint32: Uint32Array, uint8: Uint8Array, float32: Float32Array };
  const numbers = (reference) => new KINDS[reference.type](bytes, reference.at, reference.count);

  const F = data.frames;
  const root = numbers(data.root);
  const transforms = numbers(data.transforms);
  for (const axis of data.axes) {
    axis.center = numbers(axis.center);
    axis.direction = numbers(axis.direction);
  }
  for (const muscle of data.muscles) {
    for (const path of muscle.paths) {
      path.counts = numbers(path.counts);
      path.vertices = numbers(path.vertices);
      path.surface = numbers(path.surface);
      path.first = new Uint32Array(F + 1);
      for (let frame = 0; frame < F; frame++) path.first[frame + 1] = path.first[frame] + path.counts[frame];
    }
  }
  const quantities = {};
  for (const quantity of data.quantities) {
    for (const series of quantity.series) series.values = numbers(series.values);
    quantities[quantity.key] = quantity;
  }
  const placements = data.placements.length;

  // First element of a quantity's frames, for a muscle and a coordinate.
  function place(quantity, muscle, coordinate) {
    const byMuscle = quantity.axes.includes("muscle");
    const byCoordinate = quantity.axes.includes("coordinate");
    if (byMuscle && byCoordinate) return (muscle * data.coordinates.length + coordinate) * F;
    return (byMuscle ? muscle : coordinate) * F;
  }

  // ---- State ------------------------------------------------------------------------------------------

  const state = {
    motion: 0, frame: 0, muscle: 0, coordinate: 0, coloring: data.coloring, playing: false,
    view: placements > 1 ? "overlaid" : "0", bones: true, wraps: true, axes: true, hold: true,
    visible: data.muscles.map(() => true),
  };
  const motion = () => data.motions[state.motion];
  const current = () => motion().first + state.frame;

  // ---- Colors -----------------------------------------------------------------------------------------

  const RAMPS = {
    // Light to dark, and blue to vermilion through light gray: told apart with any kind of color vision.
    sequential: [[0.50, 0.67, 0.75], [0.95, 0.74, 0.32], [0.86, 0.35, 0.12], [0.44, 0.04, 0.14]],
    diverging: [[0.0, 0.27, 0.52], [0.30, 0.60, 0.80], [0.86, 0.86, 0.86], [0.93, 0.60, 0.35], [0.70, 0.25, 0.0]],
  };
  const PLAIN = { 0: [0.66, 0.25, 0.21], before: [0.55, 0.55, 0.55], after: [0.0, 0.45, 0.70] };
  const NONE = [0.82, 0.82, 0.82];
  const STYLES = {
    reference: { color: "#8a8a8a", dash: "" }, main: { color: "#0072b2", dash: "" },
    other: { color: "#d55e00", dash: "4 3" }, measured: { color: "#000000", dash: "" },
  };
  function ramp(name, share) {
    const colors = RAMPS[name];
    const at = Math.min(Math.max(share, 0), 1) * (colors.length - 1);
    const low = Math.min(Math.floor(at), colors.length - 2);
    return colors[low].map((part, index) => part + (at - low) * (colors[low + 1][index] - part));
  }
  const css = (color) => `rgb(${color.map((part) => Math.round(255 * part)).join(" ")})`;

  const ranges = {};
  // Largest absolute value over all frames, of all muscles or of all coordinates.
  function largest(quantity) {
    const key = `${quantity.key} ${quantity.axes.length > 1 ? state.coordinate : ""}`;
    if (!(key in ranges)) {
      let most = 0;
      for (const series of quantity.series) {
        const rows = quantity.axes.length > 1 ? data.muscles.map((_, row) => place(quantity, row, state.coordinate)) : [0];
        const length = quantity.axes.length > 1 ? F : series.values.length;
        for (const first of rows) {
          for (let index = first; index < first + length; index++) {
            const size = Math.abs(series.values[index]);
            if (size > most) most = size;
          }
        }
      }
      ranges[key] = most || 1;
    }
    return ranges[key];
  }
  const coloring = () => quantities[state.coloring];
  const spans = (muscle, coordinate) => {
    const arms = quantities.moment_arm;
    if (!arms) return true;
    const first = place(arms, muscle, coordinate) + motion().first;
    const values = arms.series[0].values;
    for (let index = first; index < first + motion().progress.length; index += 5) {
      if (Math.abs(values[index]) > 1e-3) return true;
    }
    return false;
  };
  // Value that colors a muscle in a placement; undefined if there is none.
  function colorValue(quantity, muscle, placement) {
    if (!quantity.axes.includes("muscle") && !spans(muscle, state.coordinate)) return undefined;
    const at = place(quantity, muscle, state.coordinate) + current();
    // Series of later placements hold only what differs from the first one.
    const used = quantity.key === "moment_arm" ? Math.min(placement, placements - 1) : quantity.series.length - 1;
    let value = quantity.series[used].values[at];
    if (Number.isNaN(value) && quantity.key === "moment_arm") value = quantity.series[0].values[at];
    return Number.isNaN(value) ? undefined : value;
  }
  function toColor(quantity, value) {
    if (value === undefined) return NONE;
    const share = value / largest(quantity);
    return ramp(quantity.colors, quantity.colors === "diverging" ? 0.5 + 0.5 * share : share);
  }
  function colorOf(muscle, placement) {
    const quantity = coloring();
    // A quantity with one series for all muscles, such as the force, is that of the last placement.
    const ofLast = quantity && quantity.axes.includes("muscle") && quantity.series.length < placements;
    if (placements > 1 && placement === 0 && (state.view === "overlaid" || ofLast)) return PLAIN.before;
    if (!quantity) return placements > 1 ? (placement ? PLAIN.after : PLAIN.before) : PLAIN[0];
    return toColor(quantity, colorValue(quantity, muscle, placement));
  }

  // ---- Scene ------------------------------------------------------------------------------------------

  const stage = byId("stage");
  const canvas = byId("canvas");
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: false });
  } catch (error) {
    fail("This browser cannot draw in three dimensions (WebGL 2 is missing or switched off).");
    return;
  }
  byId("problem").hidden = true;
  document.querySelector("main").hidden = false;
  renderer.setClearColor(0xf7f8fa);
  renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
  renderer.setScissorTest(true);

  const scene = new THREE.Scene();
  const moved = new THREE.Group(); // everything, relative to the root body or to ground
  scene.add(moved);
  scene.add(new THREE.HemisphereLight(0xffffff, 0x9aa0a8, 2.1));
  const camera = new THREE.PerspectiveCamera(28, 1, 0.02, 40);
  const headlight = new THREE.DirectionalLight(0xffffff, 1.4);
  headlight.position.set(0.3, 0.6, 1);
  camera.add(headlight);
  scene.add(camera);
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.addEventListener("change", () => draw());

  // Bodies, with what is fixed to them; transforms are applied as matrices.
  const bodies = data.bodies.map(() => {
    const body = new THREE.Group();
    body.matrixAutoUpdate = false;
    moved.add(body);
    return body;
  });
  function geometryOf(mesh) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(numbers(mesh.vertices), 3));
    geometry.setIndex(new THREE.BufferAttribute(numbers(mesh.triangles), 1));
    geometry.computeVertexNormals();
    return geometry;
  }
  const boneParts = [];
  const boneMaterial = new THREE.MeshStandardMaterial({ color: 0xe8dfcc, roughness: 0.85, side: THREE.DoubleSide });
  for (const bone of data.bones) {
    const mesh = new THREE.Mesh(geometryOf(bone), boneMaterial);
    bodies[bone.body].add(mesh);
    boneParts.push(mesh);
  }
  const UP = new THREE.Vector3(0, 1, 0);
  const rod = new THREE.CylinderGeometry(1, 1, 1, 12, 1);
  const ball = new THREE.SphereGeometry(1, 14, 10);
  function between(mesh, start, end, radius) {
    const along = end.clone().sub(start);
    mesh.position.copy(start).addScaledVector(along, 0.5);
    mesh.quaternion.setFromUnitVectors(UP, along.clone().normalize());
    mesh.scale.set(radius, along.length(), radius);
  }
  const withSurface = new Set(data.bones.map((bone) => bone.body));
  const stickMaterial = new THREE.MeshStandardMaterial({ color: 0xd9cfb8, roughness: 0.85 });
  for (const stick of data.sticks) {
    if (withSurface.has(stick.body)) continue;
    stick.ends.forEach(([start, end], index) => {
      const mesh = new THREE.Mesh(rod, stickMaterial);
      between(mesh, new THREE.Vector3(...start), new THREE.Vector3(...end), 0.007);
      bodies[stick.body].add(mesh);
      boneParts.push(mesh);
      for (const point of index ? [end] : [start, end]) {
        const knob = new THREE.Mesh(ball, stickMaterial);
        knob.position.set(...point);
        knob.scale.setScalar(0.012);
        bodies[stick.body].add(knob);
        boneParts.push(knob);
      }
    });
  }

  // Joint axes: a rod with a cone at the end of positive rotation.
  const cone = new THREE.CylinderGeometry(0, 1, 1, 14, 1);
  const axes = data.axes.map((axis) => {
    const group = new THREE.Group();
    const material = new THREE.MeshStandardMaterial({ color: 0x3a3a3a, roughness: 0.6 });
    const line = new THREE.Mesh(rod, material);
    const tip = new THREE.Mesh(cone, material);
    group.add(line, tip);
    const when = axis.before ? " before personalisation" : "";
    group.userData = { label: `axis of ${data.coordinates[axis.coordinate]} (${axis.joint})${when}` };
    moved.add(group);
    return { axis, group, line, tip, material };
  });
  const AXIS = 0.065;

  // Wraps: translucent surfaces with lines; those that a path touches in this frame are stronger.
  const wraps = [];
  for (const wrap of data.wraps) {
    wrap.shapes.forEach((shape, placement) => {
      if (shape.body < 0) return;
      const geometry = geometryOf(shape);
      const surface = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({
        color: 0x56b4e9, transparent: true, opacity: 0.25, side: THREE.DoubleSide, depthWrite: false,
      }));
      surface.renderOrder = 1;
      const outline = new THREE.BufferGeometry();
      outline.setAttribute("position", geometry.getAttribute("position"));
      outline.setIndex(new THREE.BufferAttribute(numbers(shape.lines), 1));
      const lines = new THREE.LineSegments(outline, new THREE.LineBasicMaterial({
        color: 0x0072b2, transparent: true, opacity: 0.4,
      }));
      bodies[shape.body].add(surface, lines);
      surface.userData = { label: wrap.name };
      wraps.push({ name: wrap.name, only: wrap.shapes.length === 1, placement, surface, lines });
    });
  }

  // Muscles: a rod for each segment and a ball at each vertex, one set for each placement.
  const paths = [];
  for (let placement = 0; placement < placements; placement++) {
    let most = 0;
    for (let frame = 0; frame < F; frame++) {
      let count = 0;
      for (const muscle of data.muscles) count += muscle.paths[Math.min(placement, muscle.paths.length - 1)].counts[frame];
      most = Math.max(most, count);
    }
    const make = (geometry) => {
      const material = new THREE.MeshStandardMaterial({ color: 0xffffff, roughness: 0.55 });
      const mesh = new THREE.InstancedMesh(geometry, material, Math.max(most, 1));
      mesh.frustumCulled = false;
      mesh.setColorAt(0, new THREE.Color(1, 1, 1)); // makes the colors
      moved.add(mesh);
      return mesh;
    };
    paths.push({ rods: make(rod), balls: make(ball), muscleOf: new Int32Array(Math.max(most, 1)), ballOf: new Int32Array(Math.max(most, 1)) });
  }
  const RADIUS = 0.0032;

  // Layer 0: what all views show. Layer 1 and 2: placements.
  for (const part of wraps) {
    const layer = part.only ? 0 : part.placement + 1;
    part.surface.layers.set(layer);
    part.lines.layers.set(layer);
  }
  paths.forEach((part, placement) => {
    part.rods.layers.set(placement + 1);
    part.balls.layers.set(placement + 1);
  });

  function pathOf(muscle, placement) {
    const own = data.muscles[muscle].paths;
    return own[Math.min(placement, own.length - 1)];
  }
  // In the overlaid view paths that calibration left alone are drawn once.
  const drawnIn = (muscle, placement) =>
    state.visible[muscle] &&
    !(state.view === "overlaid" && placement === 0 && placements > 1 && data.muscles[muscle].paths.length === 1);

  const matrix = new THREE.Matrix4();
  const start = new THREE.Vector3(), end = new THREE.Vector3(), along = new THREE.Vector3();
  const middle = new THREE.Vector3(), scale = new THREE.Vector3(), turn = new THREE.Quaternion();
  const color = new THREE.Color();
  const POINT = 128;

  function placePaths(placement, touched) {
    const { rods, balls, muscleOf, ballOf } = paths[placement];
    const frame = current();
    let rodCount = 0, ballCount = 0;
    data.muscles.forEach((muscle, number) => {
      if (!drawnIn(number, placement)) return;
      const path = pathOf(number, placement);
      const shade = colorOf(number, placement);
      const faint = state.view === "overlaid" && placements > 1 && placement === 0;
      const radius = RADIUS * (number === state.muscle ? 1.5 : 1) * (faint ? 0.75 : 1);
      const first = path.first[frame], last = path.first[frame + 1];
      for (let vertex = first; vertex < last; vertex++) {
        start.fromArray(path.vertices, 3 * vertex).multiplyScalar(data.step);
        const flags = path.surface[vertex];
        const isPoint = flags >= POINT;
        const surface = flags % POINT;
        const before = vertex > first ? path.surface[vertex - 1] % POINT : 0;
        const isEnd = (surface > 0) !== (before > 0);
        const thick = radius * (surface || before ? 1.45 : 1);
        matrix.makeScale(1, 1, 1).scale(scale.setScalar(isEnd ? 1.75 * radius : isPoint ? 1.5 * radius : thick)).setPosition(start);
        balls.setMatrixAt(ballCount, matrix);
        if (isEnd) color.setRGB(1, 1, 1);
        else if (isPoint) color.setRGB(0.1, 0.1, 0.1);
        else color.setRGB(...shade, "srgb");
        balls.setColorAt(ballCount, color);
        ballOf[ballCount++] = number;
        if (surface) touched.add(muscle.wraps[surface - 1]);
        if (vertex + 1 < last) {
          end.fromArray(path.vertices, 3 * (vertex + 1)).multiplyScalar(data.step);
          along.copy(end).sub(start);
          const length = along.length();
          middle.copy(start).addScaledVector(along, 0.5);
          turn.setFromUnitVectors(UP, length > 0 ? along.multiplyScalar(1 / length) : UP);
          const width = surface ? 1.45 * radius : radius;
          matrix.compose(middle, turn, scale.set(width, length, width));
          rods.setMatrixAt(rodCount, matrix);
          color.setRGB(...shade, "srgb");
          rods.setColorAt(rodCount, color);
          muscleOf[rodCount++] = number;
        }
      }
    });
    for (const [mesh, count] of [[rods, rodCount], [balls, ballCount]]) {
      mesh.count = count;
      mesh.instanceMatrix.needsUpdate = true;
      mesh.instanceColor.needsUpdate = true;
      mesh.boundingSphere = null; // of an earlier frame; picking needs the present one
    }
  }

  function placeAll() {
    const frame = current();
    bodies.forEach((body, index) => {
      const at = 12 * (index * F + frame);
      body.matrix.set(...transforms.subarray(at, at + 12), 0, 0, 0, 1);
      body.matrixWorldNeedsUpdate = true;
    });
    moved.position.set(0, 0, 0);
    if (!state.hold) {
      const origin = 3 * motion().first;
      moved.position.set(...[0, 1, 2].map((part) => root[3 * frame + part] - root[origin + part]));
    }
    boneParts.forEach((part) => { part.visible = state.bones; });
    const touched = new Set();
    for (let placement = 0; placement < placements; placement++) placePaths(placement, touched);
    const owned = new Set();
    data.muscles.forEach((muscle, index) => { if (state.visible[index]) muscle.wraps.forEach((name) => owned.add(name)); });
    for (const part of wraps) {
      const visible = state.wraps && owned.has(part.name);
      const touches = touched.has(part.name);
      const before = !part.only && part.placement === 0;
      part.surface.visible = part.lines.visible = visible;
      part.surface.material.color.set(before ? 0x9a9a9a : 0x56b4e9);
      part.lines.material.color.set(before ? 0x6a6a6a : 0x0072b2);
      part.surface.material.opacity = touches ? 0.24 : 0.06;
      part.lines.material.opacity = touches ? 0.42 : 0.12;
    }
    const quantity = coloring();
    const byJoint = quantity && !quantity.axes.includes("muscle");
    for (const part of axes) {
      part.group.visible = state.axes;
      const chosen = part.axis.coordinate === state.coordinate && !part.axis.before;
      start.fromArray(part.axis.center, 3 * frame);
      along.fromArray(part.axis.direction, 3 * frame);
      const reach = AXIS * (chosen ? 1.25 : 1);
      const tail = start.clone().addScaledVector(along, -reach);
      const tip = start.clone().addScaledVector(along, reach);
      between(part.line, tail, tip, chosen ? 0.0024 : 0.0012);
      part.tip.position.copy(tip).addScaledVector(along, 0.008);
      part.tip.quaternion.setFromUnitVectors(UP, along);
      part.tip.scale.set(chosen ? 0.007 : 0.0045, 0.018, chosen ? 0.007 : 0.0045);
      if (part.axis.before) {
        part.material.color.set(0xe69f00);
      } else if (byJoint) {
        const value = quantity.series[0].values[part.axis.coordinate * F + frame];
        part.material.color.setRGB(...toColor(quantity, Number.isNaN(value) ? undefined : value), "srgb");
      } else {
        part.material.color.set(chosen ? 0x009e73 : 0x6d6d6d);
      }
    }
  }

  // ---- Drawing ----------------------------------------------------------------------------------------

  let pending = false;
  function draw() {
    if (pending) return;
    pending = true;
    requestAnimationFrame(() => { pending = false; drawNow(); });
  }
  function views(width) {
    const side = state.view === "side" && placements > 1;
    const half = Math.floor(width / 2);
    if (side) return [{ left: 0, width: half, layers: [0, 1] }, { left: half, width: width - half, layers: [0, 2] }];
    const layers = state.view === "overlaid" ? [0, 1, 2] : [0, Number(state.view) + 1];
    return [{ left: 0, width, layers }];
  }
  function drawNow() {
    const width = stage.clientWidth, height = stage.clientHeight;
    const size = renderer.getSize(new THREE.Vector2());
    if (size.x !== width || size.y !== height) renderer.setSize(width, height, false);
    for (const view of views(width)) {
      camera.aspect = view.width / height;
      camera.updateProjectionMatrix();
      camera.layers.disableAll();
      view.layers.forEach((layer) => camera.layers.enable(layer));
      renderer.setViewport(view.left, 0, view.width, height);
      renderer.setScissor(view.left, 0, view.width, height);
      renderer.render(scene, camera);
    }
  }

  // Look at all muscles over the present motion, from the present direction or from the side of the leg.
  function lookAtModel(direction) {
    const box = new THREE.Box3();
    const point = new THREE.Vector3();
    const first = motion().first, end = first + motion().progress.length;
    for (const muscle of data.muscles) {
      const path = muscle.paths[0];
      for (let vertex = path.first[first]; vertex < path.first[end]; vertex += 3) {
        box.expandByPoint(point.fromArray(path.vertices, 3 * vertex).multiplyScalar(data.step));
      }
    }
    const middle = box.getCenter(new THREE.Vector3());
    const size = box.getSize(new THREE.Vector3());
    // z points to the right. Of two legs, the right one is nearer.
    const side = middle.z < -0.02 ? -1 : 1;
    const from = direction || new THREE.Vector3(0.42, 0.12, side);
    const span = Math.max(size.y, 0.2);
    const wide = Math.max(size.x, size.z, 0.15);
    const aspect = stage.clientWidth / stage.clientHeight / (state.view === "side" ? 2 : 1);
    const half = Math.tan((Math.PI / 180) * camera.fov / 2);
    const distance = 1.12 * Math.max(span / 2 / half, wide / 2 / half / aspect) + wide / 2;
    controls.target.copy(middle);
    camera.position.copy(from).normalize().multiplyScalar(distance).add(middle);
    controls.update();
  }

  // ---- Picking ----------------------------------------------------------------------------------------

  const raycaster = new THREE.Raycaster();
  function under(event) {
    const box = canvas.getBoundingClientRect();
    const x = event.clientX - box.left, y = event.clientY - box.top;
    const view = views(box.width).find((one) => x >= one.left && x < one.left + one.width);
    if (!view) return null;
    camera.aspect = view.width / box.height;
    camera.updateProjectionMatrix();
    raycaster.setFromCamera(new THREE.Vector2(2 * (x - view.left) / view.width - 1, 1 - 2 * y / box.height), camera);
    raycaster.layers.disableAll();
    view.layers.forEach((layer) => raycaster.layers.enable(layer));
    const muscles = [];
    paths.forEach((part, placement) => {
      if (!view.layers.includes(placement + 1)) return;
      for (const [mesh, owners] of [[part.rods, part.muscleOf], [part.balls, part.ballOf]]) {
        for (const hit of raycaster.intersectObject(mesh)) {
          muscles.push({ distance: hit.distance, muscle: owners[hit.instanceId], placement });
        }
      }
    });
    if (muscles.length) return muscles.sort((one, other) => one.distance - other.distance)[0];
    const parts = [];
    if (state.axes) axes.forEach((part) => parts.push(part.line, part.tip));
    wraps.forEach((part) => { if (part.surface.visible) parts.push(part.surface); });
    const hit = raycaster.intersectObjects(parts, false)[0];
    if (!hit) return null;
    return { label: hit.object.userData.label || hit.object.parent.userData.label };
  }
  let pressed = null;
  canvas.addEventListener("pointerdown", (event) => { pressed = [event.clientX, event.clientY]; byId("tip").hidden = true; });
  canvas.addEventListener("pointerup", (event) => {
    const still = pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < 4;
    pressed = null;
    if (!still) return;
    const found = under(event);
    if (found && found.muscle !== undefined) change({ muscle: found.muscle });
  });
  canvas.addEventListener("pointermove", (event) => {
    const tip = byId("tip");
    const found = pressed ? null : under(event);
    tip.hidden = !found;
    if (!found) return;
    const box = stage.getBoundingClientRect();
    let label = found.label;
    if (found.muscle !== undefined) {
      label = data.muscles[found.muscle].name;
      const quantity = coloring();
      const value = quantity && colorValue(quantity, found.muscle, found.placement);
      if (value !== undefined) label += `: ${short(value)} ${quantity.unit}`;
    }
    tip.textContent = label;
    const left = event.clientX - box.left + 12;
    tip.style.left = `${Math.min(left, Math.max(0, box.width - tip.offsetWidth - 4))}px`;
    tip.style.top = `${event.clientY - box.top + 14}px`;
  });
  canvas.addEventListener("pointerleave", () => { byId("tip").hidden = true; });

  // ---- Curves -----------------------------------------------------------------------------------------

  const SVG = "http://www.w3.org/2000/svg";
  const W = 360, H = 118, LEFT = 40, RIGHT = 14, TOP = 6, BOTTOM = 18;
  function element(name, attributes, text) {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    return made;
  }
  function node(name, text, kind) {
    const made = document.createElement(name);
    if (text !== undefined) made.textContent = text;
    if (kind) made.className = kind;
    return made;
  }
  const short = (value) => {
    const size = Math.abs(value);
    return (size >= 100 ? value.toFixed(0) : size >= 10 ? value.toFixed(1) : value.toFixed(2)).replace(/^-/, "\u2212");
  };
  // Round numbers between two values.
  function ticks(low, high, most) {
    const rough = (high - low) / most;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [1, 2, 2.5, 5, 10].find((factor) => factor * power >= 0.999 * rough);
    const found = [];
    for (let at = Math.ceil(low / step) * step; at <= high + 1e-9 * step; at += step) found.push(Number(at.toPrecision(12)));
    return found;
  }
  let panels = [];
  function buildCurves() {
    const holder = byId("curves");
    holder.replaceChildren();
    panels = [];
    const { first, progress, unit } = motion();
    const low = Math.min(...progress), high = Math.max(...progress);
    const toX = (value) => LEFT + (W - LEFT - RIGHT) * (high > low ? (value - low) / (high - low) : 0.5);
    for (const quantity of data.quantities) {
      if (!quantity.curve) continue;
      const at = place(quantity, state.muscle, state.coordinate) + first;
      const series = quantity.series
        .map((one) => ({ ...one, values: one.values.subarray(at, at + progress.length) }))
        .filter((one) => !one.values.every(Number.isNaN));
      const about = quantity.axes.includes("coordinate") ? ` about ${data.coordinates[state.coordinate]}` : "";
      const whose = quantity.axes.includes("muscle") ? ` of ${data.muscles[state.muscle].name}` : "";
      const figure = node("figure");
      figure.append(node("figcaption", `${quantity.title}${whose}${about} (${quantity.unit})`));
      holder.append(figure);
      const spanned = quantity.axes.length < 2 || spans(state.muscle, state.coordinate);
      if (!series.length || !spanned) {
        figure.append(node("p", spanned ? "not known" : "zero: the muscle does not span it", "none"));
        continue;
      }
      let least = Infinity, most = -Infinity;
      for (const one of series) for (const value of one.values) {
        if (value < least) least = value;
        if (value > most) most = value;
      }
      // Without a least span, rounding errors of a constant would fill the panel.
      const spare = Math.max(0.06 * (most - least), 0.5 * Math.max(0, 0.5 - (most - least)));
      least -= spare;
      most += spare;
      const toY = (value) => TOP + (H - TOP - BOTTOM) * (1 - (value - least) / (most - least));
      const svg = element("svg", { viewBox: `0 0 ${W} ${H}`, preserveAspectRatio: "none", role: "img",
        "aria-label": `${quantity.title}${whose}${about}` });
      for (const value of ticks(least, most, 4)) {
        svg.append(element("line", { x1: LEFT, x2: W - RIGHT, y1: toY(value), y2: toY(value), stroke: value === 0 ? "#bbb" : "#ececec" }));
        svg.append(element("text", { x: LEFT - 4, y: toY(value) + 3.5, "text-anchor": "end" }, String(value).replace("-", "\u2212")));
      }
      for (const value of ticks(low, high, 5)) {
        svg.append(element("text", { x: toX(value), y: H - 5, "text-anchor": "middle" }, String(value).replace("-", "\u2212")));
      }
      for (const one of series) {
        let path = "", gap = true;
        one.values.forEach((value, index) => {
          if (Number.isNaN(value)) { gap = true; return; }
          path += `${gap ? "M" : "L"}${toX(progress[index]).toFixed(1)} ${toY(value).toFixed(2)}`;
          gap = false;
        });
        const style = STYLES[one.style];
        svg.append(element("path", { d: path, fill: "none", stroke: style.color, "stroke-width": 1.6,
          "stroke-dasharray": style.dash, "vector-effect": "non-scaling-stroke" }));
      }
      const cursor = element("line", { y1: TOP, y2: H - BOTTOM, stroke: "#1a1a1a", "stroke-width": 1,
        "vector-effect": "non-scaling-stroke", "data-cursor": quantity.key });
      svg.append(cursor);
      const seek = (event) => {
        if (event.type === "pointermove" && !event.buttons) return;
        const box = svg.getBoundingClientRect();
        const value = low + (high - low) * ((event.clientX - box.left) / box.width * W - LEFT) / (W - LEFT - RIGHT);
        let nearest = 0;
        progress.forEach((one, index) => { if (Math.abs(one - value) < Math.abs(progress[nearest] - value)) nearest = index; });
        change({ frame: nearest });
      };
      svg.addEventListener("pointerdown", seek);
      svg.addEventListener("pointermove", seek);
      figure.append(svg);
      const key = node("p", undefined, "key");
      for (const one of series) {
        const entry = node("span");
        const mark = node("i");
        one.reading = node("b");
        mark.style.borderTopColor = STYLES[one.style].color;
        if (STYLES[one.style].dash) mark.style.borderTopStyle = "dashed";
        entry.append(mark, one.name, one.reading);
        key.append(entry);
      }
      figure.append(key);
      panels.push({ series, cursor, toX, progress });
    }
    const axis = node("p", `Horizontal: ${unit}.`, "none");
    holder.append(axis);
    followCurves();
  }
  function followCurves() {
    for (const panel of panels) {
      const x = panel.toX(panel.progress[state.frame]);
      panel.cursor.setAttribute("x1", x);
      panel.cursor.setAttribute("x2", x);
      for (const one of panel.series) {
        const value = one.values[state.frame];
        one.reading.textContent = Number.isNaN(value) ? "" : short(value);
      }
    }
  }

  // ---- Controls ---------------------------------------------------------------------------------------

  function option(select, value, text) {
    const made = node("option", text);
    made.value = value;
    select.append(made);
  }
  data.motions.forEach((one, index) => option(byId("motion"), index, one.name));
  // Coordinates about which some muscle has a moment arm, or something else is known.
  const known = (quantity, coordinate) => quantity.axes.length === 1 && quantity.axes[0] === "coordinate" &&
    quantity.series.some((one) => one.values.subarray(coordinate * F, (coordinate + 1) * F).some((value) => value === value));
  data.coordinates.forEach((name, index) => {
    const spanned = data.muscles.some((_, muscle) => spans(muscle, index));
    if (spanned || data.quantities.some((quantity) => known(quantity, index))) option(byId("coordinate"), index, name);
  });
  option(byId("coloring"), "", "nothing");
  for (const quantity of data.quantities) {
    if (quantity.colors) option(byId("coloring"), quantity.key, `${quantity.title.toLowerCase()} (${quantity.unit})`);
  }
  byId("view-choice").hidden = placements < 2;
  byId("hold-name").textContent = `hold ${data.root_body}`;

  const rows = data.muscles.map((muscle, index) => {
    const row = node("li");
    const check = node("input");
    check.type = "checkbox";
    check.checked = true;
    check.setAttribute("aria-label", `show ${muscle.name}`);
    check.addEventListener("change", () => {
      state.visible[index] = check.checked;
      change({});
    });
    const swatch = node("span", undefined, "swatch");
    const name = node("button", muscle.name);
    name.type = "button";
    name.addEventListener("click", () => change({ muscle: index }));
    const on = node("span", undefined, "on");
    row.append(check, swatch, name, on);
    byId("muscles").append(row);
    return { row, check, swatch, on };
  });
  function touches(index) {
    const path = pathOf(index, placements - 1);
    const found = new Set();
    for (let vertex = path.first[current()]; vertex < path.first[current() + 1]; vertex++) {
      const surface = path.surface[vertex] % POINT;
      if (surface) found.add(data.muscles[index].wraps[surface - 1]);
    }
    return [...found];
  }
  function show(which) {
    data.muscles.forEach((_, index) => { state.visible[index] = which(index); });
    rows.forEach((row, index) => { row.check.checked = state.visible[index]; });
    change({});
  }
  byId("all").addEventListener("click", () => show(() => true));
  byId("only").addEventListener("click", () => show((index) => index === state.muscle));
  byId("touching").addEventListener("click", () => show((index) => touches(index).length > 0));
  byId("search").addEventListener("input", (event) => {
    const wanted = event.target.value.trim().toLowerCase();
    rows.forEach((row, index) => { row.row.hidden = !data.muscles[index].name.toLowerCase().includes(wanted); });
  });

  function refresh(old) {
    const { progress, unit, time } = motion();
    const quantity = coloring();
    byId("frame").max = progress.length - 1;
    byId("frame").value = state.frame;
    const isTime = unit.startsWith("%");
    byId("progress").textContent = `${String(Number(progress[state.frame].toFixed(1))).replace("-", "\u2212")} ${unit}` + (isTime ? ` (${time[state.frame].toFixed(2)} s)` : "");
    byId("frame").setAttribute("aria-valuetext", byId("progress").textContent);
    byId("motion").value = state.motion;
    byId("coordinate").value = state.coordinate;
    byId("coloring").value = quantity ? state.coloring : "";
    byId("view").value = state.view;
    byId("play").textContent = state.playing ? "Pause" : "Play";
    byId("play").setAttribute("aria-pressed", state.playing);
    stage.classList.toggle("side", state.view === "side" && placements > 1);
    const captions = byId("captions").children;
    captions[0].textContent = placements < 2 ? "" : state.view === "side" ? data.placements[0]
      : state.view === "overlaid" ? `gray: ${data.placements[0]}; colored: ${data.placements[1]}` : data.placements[Number(state.view)];
    captions[1].textContent = placements > 1 && state.view === "side" ? data.placements[1] : "";
    byId("legend").hidden = !quantity;
    if (quantity) {
      const about = quantity.axes.includes("coordinate") ? ` about ${data.coordinates[state.coordinate]}` : "";
      byId("legend-title").textContent = `${quantity.title}${about} (${quantity.unit})`;
      const stops = Array.from({ length: 13 }, (_, index) => css(ramp(quantity.colors, index / 12)));
      byId("legend-bar").style.background = `linear-gradient(to right, ${stops.join(", ")})`;
      const most = largest(quantity);
      const ends = quantity.colors === "diverging" ? [-most, 0, most] : [0, most / 2, most];
      [...byId("legend-ends").children].forEach((one, index) => { one.textContent = short(ends[index]); });
    }
    byId("count").textContent = `${state.visible.filter(Boolean).length} of ${data.muscles.length} shown`;
    rows.forEach((row, index) => {
      row.row.classList.toggle("chosen", index === state.muscle);
      row.swatch.style.background = css(colorOf(index, placements - 1));
      row.on.textContent = touches(index).join(", ");
    });
    if (!old || old.motion !== state.motion || old.muscle !== state.muscle || old.coordinate !== state.coordinate) buildCurves();
    else followCurves();
    placeAll();
    draw();
  }
  function change(changes) {
    const old = { ...state };
    Object.assign(state, changes);
    state.frame = Math.min(Math.max(Math.round(state.frame), 0), motion().progress.length - 1);
    refresh(old);
    const divided = "view" in changes && (changes.view === "side") !== (old.view === "side");
    if (divided || state.motion !== old.motion) {
      lookAtModel(divided ? undefined : camera.position.clone().sub(controls.target));
      draw();
    }
  }

  byId("frame").addEventListener("input", (event) => change({ frame: Number(event.target.value) }));
  byId("motion").addEventListener("change", (event) => {
    const motion = Number(event.target.value);
    // A motion of one coordinate is best seen in the moment arms about it.
    const moving = data.coordinates.indexOf(data.motions[motion].name);
    change(moving < 0 ? { motion } : { motion, coordinate: moving });
  });
  byId("coordinate").addEventListener("change", (event) => change({ coordinate: Number(event.target.value) }));
  byId("coloring").addEventListener("change", (event) => change({ coloring: event.target.value }));
  byId("view").addEventListener("change", (event) => change({ view: event.target.value }));
  for (const name of ["bones", "wraps", "axes", "hold"]) {
    byId(name).addEventListener("change", (event) => change({ [name]: event.target.checked }));
  }

  // A gait cycle plays in its own time, a joint's range in 3 s.
  function durationOf(one) {
    return one.unit.startsWith("%") ? one.time[one.time.length - 1] - one.time[0] : 3 * Number(byId("speed").value);
  }
  let begun = 0, from = 0;
  function step() {
    if (!state.playing) return;
    const count = motion().progress.length;
    const passed = (performance.now() - begun) / 1000 * Number(byId("speed").value) / durationOf(motion());
    const frame = Math.floor(from + passed * (count - 1)) % count;
    if (frame !== state.frame) change({ frame });
    requestAnimationFrame(step);
  }
  function play() {
    begun = performance.now();
    from = state.frame;
    requestAnimationFrame(step);
  }
  byId("play").addEventListener("click", () => {
    change({ playing: !state.playing });
    if (state.playing) play();
  });
  byId("speed").addEventListener("change", () => { begun = performance.now(); from = state.frame; });
  for (const name of ["input", "pointerdown"]) {
    byId("frame").addEventListener(name, () => { if (state.playing) change({ playing: false }); });
  }

  // The moment arm that calibration changed most on average.
  function mostChanged() {
    const arms = quantities.moment_arm;
    const [before, after] = arms.series;
    let found = null, most = 0;
    data.muscles.forEach((one, muscle) => data.coordinates.forEach((_, coordinate) => {
      if (one.paths.length < 2) return;
      const first = place(arms, muscle, coordinate);
      let sum = 0;
      for (let index = first; index < first + F; index++) sum += Math.abs(after.values[index] - before.values[index]);
      if (sum > most) { most = sum; found = { muscle, coordinate }; }
    }));
    return found;
  }
  // The coordinate at first: the one with the largest error.
  const chosen = coloring();
  if (chosen && chosen.axes.includes("coordinate")) {
    let most = -1;
    data.coordinates.forEach((_, coordinate) => {
      const values = chosen.axes.length > 1 ? [] : chosen.series[0].values.subarray(coordinate * F, (coordinate + 1) * F);
      values.forEach((value) => { if (value > most) { most = value; state.coordinate = coordinate; } });
    });
  }
  const changed = placements > 1 ? mostChanged() : null;
  if (changed) Object.assign(state, changed);
  else state.muscle = Math.max(0, data.muscles.findIndex((_, index) => touches(index).length > 0));
  // If a muscle does not span the chosen coordinate, its moment arm would be zero throughout.
  if (!spans(state.muscle, state.coordinate)) {
    const byGap = chosen && !chosen.axes.includes("muscle");
    if (byGap) state.muscle = Math.max(0, data.muscles.findIndex((_, index) => spans(index, state.coordinate)));
    else state.coordinate = Math.max(0, data.coordinates.findIndex((_, index) => spans(state.muscle, index)));
  }
  lookAtModel();
  refresh(null);
  const list = byId("muscles");
  list.scrollTop = rows[state.muscle].row.offsetTop - list.offsetTop - 40;
  new ResizeObserver(() => draw()).observe(stage);

  // For tests and for use from the browser's console: what is drawn, in m relative to ground.
  window.wrapjaxView = {
    state,
    change,
    draw: drawNow,
    drawn(muscle, placement = 0) {
      const number = data.muscles.findIndex((one) => one.name === muscle);
      const { rods, muscleOf } = paths[placement];
      const found = [];
      const origin = 3 * current();
      for (let index = 0; index < rods.count; index++) {
        if (muscleOf[index] !== number) continue;
        rods.getMatrixAt(index, matrix);
        const ends = [-0.5, 0.5].map((share) => start.set(0, share, 0).applyMatrix4(matrix).toArray());
        for (const point of found.length ? [ends[1]] : ends) found.push(point.map((value, part) => value + root[origin + part]));
      }
      return found;
    },
  };
})();
