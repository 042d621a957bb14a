// The scene of a page in space, by three.js: the array, the bodies with the pressure on them, the foci and a section
// through the field that moves. Lengths are in mm. Pressures come as bytes, 255 √(p / most).
"use strict";

(async function () {
  const root = document.getElementById("viewer");
  const canvas = root.querySelector("canvas");
  const overlay = root.querySelector("svg");
  const readout = root.querySelector("output");
  const control = (name) => root.querySelector(`[name=${name}]`);
  const DIFFERENCE = 12; // dB at the ends of its colours
  const LEVELS = 40; // dB that the colours of levels span
  const FAINT = 0.03; // shares of the largest pressure below which a difference is drawn grey

  async function unpacked(id) {
    const packed = Uint8Array.from(atob(document.getElementById(id).textContent.trim()), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).arrayBuffer();
  }

  const facts = JSON.parse(document.getElementById("viewer-facts").textContent);
  const [library, numbers] = await Promise.all([unpacked("three"), unpacked("viewer-numbers")]);
  const script = document.createElement("script");
  script.textContent = new TextDecoder().decode(library);
  document.head.append(script);

  const KINDS = { float32: Float32Array, uint8: Uint8Array, uint32: Uint32Array };
  const array = (name) => {
    const [kind, offset, count] = facts.arrays[name];
    return new KINDS[kind](numbers, offset, count);
  };

  // --- what there is ------------------------------------------------------------------------------------------------

  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true });
  renderer.setClearColor(0, 0);
  renderer.localClippingEnabled = true;
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(30, 1, 1, 10000);
  const vector = (numbers) => new THREE.Vector3(...numbers);
  const cutting = new THREE.Plane();

  function palette(name) {
    const bytes = new Uint8Array(facts.colours[name].flatMap((hex) => {
      const number = parseInt(hex.slice(1), 16);
      return [number >> 16, (number >> 8) & 255, number & 255, 255];
    }));
    const texture = new THREE.DataTexture(bytes, bytes.length / 4, 1);
    texture.minFilter = texture.magFilter = THREE.LinearFilter;
    texture.needsUpdate = true;
    return texture;
  }

  const uniforms = {
    pressures: { value: palette("pressure") },
    differences: { value: palette("difference") },
    shown: { value: 0 },
    plain: { value: false },
    first: { value: null },
    second: { value: null },
    depth: { value: null },
  };
  const COLOUR = `
    uniform sampler2D pressures, differences;
    uniform int shown;
    const vec3 BODY = vec3(0.72, 0.70, 0.68);
    vec3 coloured(float one, float other) {
      float p = one * one, q = other * other;
      if (shown == 2) {
        float decibels = 20.0 * log(max(p, 1e-5) / max(q, 1e-5)) / log(10.0);
        vec3 colour = texture(differences, vec2(clamp(0.5 + decibels / ${(2 * DIFFERENCE).toFixed(1)}, 0.002, 0.998), 0.5)).rgb;
        return mix(vec3(0.80), colour, smoothstep(0.0, ${FAINT}, max(p, q)));
      }
      float share = shown == 1 ? 1.0 + 20.0 / ${LEVELS.toFixed(1)} * log(max(p, 1e-5)) / log(10.0) : p;
      return texture(pressures, vec2(clamp(share, 0.002, 0.998), 0.5)).rgb;
    }`;

  const plane = new THREE.Mesh(
    new THREE.BufferGeometry().setIndex([0, 1, 2, 2, 1, 3]),
    new THREE.ShaderMaterial({
      uniforms,
      side: THREE.DoubleSide,
      vertexShader: `
        attribute vec3 place;
        varying vec3 at;
        void main() { at = place; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`,
      fragmentShader: `
        precision highp sampler3D;
        uniform sampler3D first, second, depth;
        varying vec3 at;
        ${COLOUR}
        void main() {
          float inside = smoothstep(0.49, 0.51, texture(depth, at).r);
          vec3 field = coloured(texture(first, at).r, texture(second, at).r);
          gl_FragColor = vec4(mix(field, BODY * 0.86, inside), 1.0);
        }`,
    }),
  );
  plane.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(12), 3));
  plane.geometry.setAttribute("place", new THREE.BufferAttribute(new Float32Array(12), 3));
  plane.frustumCulled = false;
  const edge = new THREE.LineLoop(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: 0x8a6fb0 }));
  edge.frustumCulled = false;

  const body = new THREE.Mesh(
    new THREE.BufferGeometry(),
    new THREE.ShaderMaterial({
      uniforms,
      side: THREE.DoubleSide,
      clipping: true,
      clippingPlanes: [],
      vertexShader: `
        attribute float one, other;
        varying vec3 facing, at;
        varying float a, b;
        #include <clipping_planes_pars_vertex>
        void main() {
          a = one; b = other; facing = normalMatrix * normal;
          vec4 mvPosition = modelViewMatrix * vec4(position, 1.0);
          gl_Position = projectionMatrix * mvPosition;
          #include <clipping_planes_vertex>
        }`,
      fragmentShader: `
        varying vec3 facing;
        varying float a, b;
        uniform bool plain;
        #include <clipping_planes_pars_fragment>
        ${COLOUR}
        void main() {
          #include <clipping_planes_fragment>
          vec3 normal = normalize(gl_FrontFacing ? facing : -facing);
          float lit = 0.5 + 0.5 * max(dot(normal, normalize(vec3(-0.35, 0.55, 0.8))), 0.0);
          float strength = shown == 2 ? 1.0 : smoothstep(0.0, 0.35, a * a);
          vec3 surface = plain ? BODY : mix(BODY, coloured(a, b), strength);
          gl_FragColor = vec4((gl_FrontFacing ? 1.0 : 0.45) * lit * surface, 1.0);
        }`,
    }),
  );
  if (facts.arrays.vertices) {
    body.geometry.setAttribute("position", new THREE.BufferAttribute(array("vertices"), 3));
    body.geometry.setIndex(new THREE.BufferAttribute(array("triangles"), 1));
    body.geometry.computeVertexNormals();
    scene.add(body);
  }

  const volume = (name) => {
    const texture = new THREE.Data3DTexture(array(name), ...facts.slices.counts);
    texture.format = THREE.RedFormat;
    texture.minFilter = texture.magFilter = THREE.LinearFilter;
    texture.unpackAlignment = 1;
    texture.needsUpdate = true;
    return texture;
  };
  const fields = facts.drives.map((_, index) => volume(`field ${index}`));
  uniforms.depth.value = volume("depth");
  scene.add(plane, edge);

  const elements = new THREE.InstancedMesh(
    new THREE.CircleGeometry(facts.radius, 18), new THREE.MeshBasicMaterial(), array("positions").length / 3,
  );
  const positions = array("positions"), normals = array("normals");
  const turned = new THREE.Object3D();
  for (let index = 0; index < elements.count; index++) {
    turned.position.fromArray(positions, 3 * index);
    turned.lookAt(vector(normals.slice(3 * index, 3 * index + 3)).add(turned.position));
    turned.updateMatrix();
    elements.setMatrixAt(index, turned.matrix);
  }
  elements.frustumCulled = false;
  scene.add(elements);

  // --- what is shown ------------------------------------------------------------------------------------------------

  const state = { drive: 0, other: Math.min(1, facts.drives.length - 1), axis: 2, layer: 0 };
  const slices = facts.slices;
  const axes = slices.axes.map(vector);
  const inPa = (byte) => facts.most * (byte / 255) ** 2;
  const decibels = (pressure) => 20 * Math.log10(pressure / Math.SQRT2 / 20e-6);
  const grouped = (number, digits = 0) => number.toLocaleString("en", { maximumFractionDigits: digits, minimumFractionDigits: digits });

  function chooseDrive() {
    state.drive = Number(control("drive").value);
    state.other = Number(control("other").value);
    uniforms.shown.value = ["pressure", "level", "difference"].indexOf(control("shown").value);
    uniforms.first.value = fields[state.drive];
    uniforms.second.value = fields[state.other];
    control("other").closest("label").hidden = uniforms.shown.value !== 2;
    uniforms.plain.value = !control("surfaces").checked || !facts.arrays["surface 0"];
    if (facts.arrays["surface 0"]) {
      body.geometry.setAttribute("one", new THREE.BufferAttribute(array(`surface ${state.drive}`), 1, true));
      body.geometry.setAttribute("other", new THREE.BufferAttribute(array(`surface ${state.other}`), 1, true));
    }
    const kind = control("array").value;
    elements.visible = kind !== "hidden";
    const values = array(`${kind === "amplitude" ? "amplitude" : "phase"} ${state.drive}`);
    const colours = facts.colours[kind === "amplitude" ? "amplitude" : "phase"];
    const largest = values.reduce((most, value) => Math.max(most, value), 0);
    const colour = new THREE.Color();
    values.forEach((value, index) => {
      const share = kind === "amplitude" ? value / largest : 0.5 + value / (2 * Math.PI);
      elements.setColorAt(index, colour.set(colours[Math.round(share * (colours.length - 1))]));
    });
    elements.instanceColor.needsUpdate = true;
    state.largest = largest;
    draw();
  }

  const along = (axis, index) => slices.corner[axis] + slices.steps[axis] * index;

  function moveSlice() {
    state.axis = Number(control("axis").value);
    const slider = control("layer");
    if (slider.dataset.axis !== String(state.axis)) {
      slider.dataset.axis = state.axis;
      slider.max = slices.counts[state.axis] - 1;
      slider.value = slices.start[state.axis];
    }
    state.layer = Number(slider.value);
    const [u, v] = [0, 1, 2].filter((axis) => axis !== state.axis);
    const corners = [[0, 0], [1, 0], [0, 1], [1, 1]].map(([s, t]) => {
      const index = [0, 0, 0];
      index[state.axis] = state.layer;
      index[u] = s * (slices.counts[u] - 1);
      index[v] = t * (slices.counts[v] - 1);
      return index;
    });
    const worlds = corners.map((index) => index.reduce(
      (point, step, axis) => point.addScaledVector(axes[axis], along(axis, step)), vector([0, 0, 0])));
    corners.forEach((index, corner) => {
      plane.geometry.attributes.position.setXYZ(corner, ...worlds[corner].toArray());
      plane.geometry.attributes.place.setXYZ(corner, ...index.map((step, axis) => (step + 0.5) / slices.counts[axis]));
    });
    plane.geometry.attributes.position.needsUpdate = plane.geometry.attributes.place.needsUpdate = true;
    edge.geometry.setFromPoints([0, 1, 3, 2].map((corner) => worlds[corner]));
    plane.visible = edge.visible = control("slice").checked;
    const words = `${slices.labels[state.axis]} = ${along(state.axis, state.layer).toFixed(1)} mm`.replace("-", "−");
    root.querySelector(".layer").textContent = words;
    slider.setAttribute("aria-valuetext", words);
    draw();
  }

  // --- from where it is seen ----------------------------------------------------------------------------------------

  const view = { azimuth: 0, elevation: 0, distance: 1, target: new THREE.Vector3() };

  function look(name) {
    const [from, reach] = name === "array" ? [facts.middle, facts.reach] : [facts.focus, facts.close];
    view.target.set(...from);
    view.distance = reach / Math.sin((camera.fov * Math.PI) / 360) / Math.min(1, camera.aspect);
    [view.azimuth, view.elevation] = facts.seen;
    draw();
  }

  let wanted = false, fine = 1, last = 0, frames = 0, settling = 0;
  function draw() {
    if (!wanted) requestAnimationFrame(paint);
    wanted = true;
  }

  function paint(now) {
    wanted = false;
    if (dragging) fine = now - last > 60 && now - last < 500 ? Math.max(0.5, 0.8 * fine) : fine;
    last = now;
    renderer.setPixelRatio(Math.min(devicePixelRatio, 2) * fine);
    const { azimuth, elevation, distance, target } = view;
    const from = [Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation)];
    camera.position.copy(target).addScaledVector(vector(from), distance);
    camera.up.set(0, 0, 1);
    camera.lookAt(target);
    camera.near = distance / 50;
    camera.far = 20 * distance + 4 * facts.reach;
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
    cutting.setFromNormalAndCoplanarPoint(axes[state.axis], axes[state.axis].clone().multiplyScalar(along(state.axis, state.layer)));
    if (cutting.distanceToPoint(camera.position) > 0) cutting.negate();
    body.material.clippingPlanes = control("cut").checked && plane.visible ? [cutting] : [];
    renderer.render(scene, camera);
    annotate();
    canvas.dataset.frames = ++frames;
    clearTimeout(settling);
    if (fine < 1 && !dragging) settling = setTimeout(() => { fine = 1; draw(); }, 150);
  }

  function fit() {
    const { width, height } = canvas.parentElement.getBoundingClientRect();
    if (!width || !height) return;
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    overlay.setAttribute("viewBox", `0 0 ${width} ${height}`);
    paint(performance.now());
  }

  // --- words and scales over the picture ----------------------------------------------------------------------------

  function piece(kind, attributes, text = "") {
    const made = document.createElementNS("http://www.w3.org/2000/svg", kind);
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    made.textContent = text;
    return made;
  }

  const seen = (point) => {
    const [, , width, height] = overlay.getAttribute("viewBox").split(" ").map(Number);
    const ndc = point.clone().project(camera);
    return [((1 + ndc.x) * width) / 2, ((1 - ndc.y) * height) / 2];
  };

  function bar(left, top, width, name, ticks, title, ink) {
    const stops = facts.colours[name].filter((_, index, all) => index % 8 === 0 || index === all.length - 1);
    const gradient = piece("linearGradient", { id: `scale-${name}` });
    stops.forEach((colour, index) => gradient.append(
      piece("stop", { offset: index / (stops.length - 1), "stop-color": colour })));
    overlay.append(gradient, piece("text", { x: left, y: top - 6, fill: ink, "font-size": 12 }, title));
    overlay.append(piece("rect", { x: left, y: top, width, height: 10, fill: `url(#scale-${name})`, stroke: ink, "stroke-width": 0.4 }));
    for (const [share, text] of ticks) {
      const x = left + share * width;
      overlay.append(piece("line", { x1: x, x2: x, y1: top + 10, y2: top + 14, stroke: ink }));
      overlay.append(piece("text", { x, y: top + 25, fill: ink, "font-size": 11, "text-anchor": "middle" }, text));
    }
  }

  function pressureTicks(narrow) {
    const most = facts.most;
    if (uniforms.shown.value === 2) return [-1, -0.5, 0, 0.5, 1].map((s) => [(1 + s) / 2, `${s > 0 ? "+" : s < 0 ? "−" : ""}${Math.abs(s * DIFFERENCE)}`]);
    if (uniforms.shown.value === 1) {
      const top = decibels(most);
      return [0, 10, 20, 30, 40].map((down) => 10 * Math.floor(top / 10) - down).filter((level) => level >= top - LEVELS)
        .map((level) => [1 - (top - level) / LEVELS, String(level)]);
    }
    const rough = most / (narrow ? 3 : 4), power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 2.5, 5, 10].map((factor) => factor * power).find((size) => size >= rough);
    return Array.from({ length: Math.floor(most / step) + 1 }, (_, n) => [(n * step) / most, grouped(n * step)]);
  }

  function annotate() {
    const [, , width, height] = overlay.getAttribute("viewBox").split(" ").map(Number);
    const style = getComputedStyle(root);
    const ink = style.getPropertyValue("--ink").trim(), paper = style.getPropertyValue("--paper").trim();
    const halo = { stroke: paper, "stroke-width": 3, "paint-order": "stroke", "stroke-linejoin": "round" };
    overlay.replaceChildren();
    const few = facts.foci.length <= 8;
    for (const focus of facts.foci) {
      const [x, y] = seen(vector(focus.position));
      const radius = few ? 8 : 3;
      overlay.append(piece("circle", { cx: x, cy: y, r: radius, fill: "none", stroke: paper, "stroke-width": 4 }));
      overlay.append(piece("circle", { cx: x, cy: y, r: radius, fill: "none", stroke: "#e8590c", "stroke-width": 2 }));
      if (!few) continue;
      const right = x >= seen(vector(facts.focus))[0];
      const side = { x: x + (right ? 14 : -14), y: y + 4, "text-anchor": right ? "start" : "end" };
      overlay.append(piece("text", { ...side, fill: ink, "font-size": 13, ...halo }, focus.name));
    }
    const length = Math.min(230, width / 2 - 40), top = height - 34;
    const names = ["peak pressure [Pa]", "sound pressure level [dB re 20 µPa]", `${facts.drives[state.drive]} over ${facts.drives[state.other]} [dB]`];
    bar(18, top, length, uniforms.shown.value === 2 ? "difference" : "pressure", pressureTicks(length < 180), names[uniforms.shown.value], ink);
    const kind = control("array").value;
    if (kind === "phase") bar(width - length - 18, top, length, "phase", [[0, "−π"], [0.5, "0"], [1, "π"]], "phase of the transducers [rad]", ink);
    if (kind === "amplitude") bar(width - length - 18, top, length, "amplitude", [[0, "0"], [1, grouped(state.largest, 2)]], "amplitude, of full scale", ink);
    const middle = [width - 40, 52];
    const origin = view.target.clone().project(camera), unit = (2 * view.distance) / height;
    [..."xyz"].forEach((name, axis) => {
      const tip = view.target.clone().setComponent(axis, view.target.getComponent(axis) + 24 * unit * Math.tan((camera.fov * Math.PI) / 360)).project(camera);
      const [dx, dy] = [((tip.x - origin.x) * width) / 2, (-(tip.y - origin.y) * height) / 2];
      overlay.append(piece("line", { x1: middle[0], y1: middle[1], x2: middle[0] + dx, y2: middle[1] + dy, stroke: ink, "stroke-width": 1.5 }));
      overlay.append(piece("text", { x: middle[0] + 1.35 * dx, y: middle[1] + 1.35 * dy + 4, fill: ink, "font-size": 12, "text-anchor": "middle" }, name));
    });
  }

  // --- what lies under the pointer ----------------------------------------------------------------------------------

  const ray = new THREE.Raycaster();
  const place = (point) => "xyz".split("").map((name, axis) => `${name} ${point.getComponent(axis).toFixed(1)}`).join(", ").replaceAll("-", "−");

  function compared(pressures) {
    const lines = facts.drives.map((name, index) => [name, pressures[index], index]).filter(([, , index]) => facts.drives.length < 4 || index === state.drive || index === state.other)
      .map(([name, pressure]) => `${name}: ${grouped(pressure)} Pa, ${grouped(decibels(Math.max(pressure, 1e-3)))} dB`);
    return lines;
  }

  function sampled(index) {
    const [nx, ny, nz] = slices.counts;
    const low = index.map((at, axis) => Math.max(0, Math.min(Math.floor(at), slices.counts[axis] - 2)));
    return (bytes) => {
      let sum = 0;
      for (let corner = 0; corner < 8; corner++) {
        const at = low.map((start, axis) => Math.min(start + ((corner >> axis) & 1), [nx, ny, nz][axis] - 1));
        const weight = at.reduce((product, where, axis) => product * Math.max(0, 1 - Math.abs(index[axis] - where)), 1);
        sum += weight * bytes[at[0] + nx * (at[1] + ny * at[2])];
      }
      return sum;
    };
  }

  function under(x, y) {
    const box = canvas.getBoundingClientRect();
    for (const focus of facts.foci) {
      const [fx, fy] = seen(vector(focus.position));
      if (Math.hypot(fx - x + box.left, fy - y + box.top) < 9)
        return [`focus ${focus.name} at ${place(vector(focus.position))} mm`, `asked: ${focus.asked}`, ...compared(focus.got)];
    }
    ray.setFromCamera({ x: (2 * (x - box.left)) / box.width - 1, y: 1 - (2 * (y - box.top)) / box.height }, camera);
    const drawn = [body, plane, elements].filter((one) => one.visible && (one !== body || facts.arrays.vertices));
    const clipped = body.material.clippingPlanes;
    const hit = ray.intersectObjects(drawn, false).find((one) => one.object !== body || !clipped.length || clipped[0].distanceToPoint(one.point) >= 0);
    if (!hit) return null;
    if (hit.object === elements) {
      const facing = vector(normals.slice(3 * hit.instanceId, 3 * hit.instanceId + 3));
      if (facing.dot(ray.ray.direction) > 0) return null;
      const [amplitude, phase] = ["amplitude", "phase"].map((kind) => array(`${kind} ${state.drive}`)[hit.instanceId]);
      return [`transducer ${hit.instanceId}, ${facts.drives[state.drive]}`, `phase ${phase.toFixed(2)} rad, amplitude ${amplitude.toFixed(2)}`.replace("-", "−")];
    }
    if (hit.object === body) {
      if (!facts.arrays["surface 0"]) return ["a body"];
      const corners = [hit.face.a, hit.face.b, hit.face.c];
      const mean = (name) => inPa(corners.reduce((sum, corner) => sum + array(name)[corner], 0) / 3);
      return [`surface at ${place(hit.point)} mm`, ...compared(facts.drives.map((_, index) => mean(`surface ${index}`)))];
    }
    const index = axes.map((axis, number) => (hit.point.dot(axis) - slices.corner[number]) / slices.steps[number]);
    const value = sampled(index);
    if (value(array("depth")) > 127.5) return [`inside a body, at ${place(hit.point)} mm`];
    return [`air at ${place(hit.point)} mm`, ...compared(facts.drives.map((_, number) => inPa(value(array(`field ${number}`)))))];
  }

  function report(event) {
    const lines = under(event.clientX, event.clientY);
    readout.hidden = !lines;
    if (!lines) return;
    readout.replaceChildren(...lines.map((line) => Object.assign(document.createElement("span"), { textContent: line })));
    const box = canvas.getBoundingClientRect();
    const left = Math.min(event.clientX - box.left + 14, box.width - readout.offsetWidth - 4);
    readout.style.left = `${Math.max(4, left)}px`;
    readout.style.top = `${Math.max(4, event.clientY - box.top - readout.offsetHeight - 12)}px`;
  }

  // --- mouse, touch and keys ----------------------------------------------------------------------------------------

  const pointers = new Map();
  let dragging = false, apart = 0;
  const turn = (dx, dy) => {
    view.azimuth -= dx;
    view.elevation = Math.max(-1.55, Math.min(1.55, view.elevation + dy));
    draw();
  };
  const zoom = (factor) => {
    view.distance = Math.max(0.2 * facts.close, Math.min(20 * facts.reach, factor * view.distance));
    draw();
  };
  const slide = (dx, dy) => {
    const unit = (2 * view.distance * Math.tan((camera.fov * Math.PI) / 360)) / canvas.clientHeight;
    view.target.addScaledVector(new THREE.Vector3().setFromMatrixColumn(camera.matrix, 0), -dx * unit);
    view.target.addScaledVector(new THREE.Vector3().setFromMatrixColumn(camera.matrix, 1), dy * unit);
    draw();
  };
  const spread = () => { const [a, b] = [...pointers.values()]; return Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY); };

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event);
    dragging = true;
    if (pointers.size === 2) apart = spread();
    report(event);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return report(event);
    pointers.set(event.pointerId, event);
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    if (Math.hypot(dx, dy) > 0) readout.hidden = true;
    if (pointers.size === 2) {
      const now = spread();
      zoom(apart / now);
      apart = now;
    } else if (event.shiftKey || event.buttons === 2) slide(dx, dy);
    else turn(0.008 * dx, 0.008 * dy);
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => {
    pointers.delete(event.pointerId);
    dragging = pointers.size > 0;
    draw();
  });
  canvas.addEventListener("pointerleave", () => { readout.hidden = true; });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(0.0012 * event.deltaY)); }, { passive: false });
  const KEYS = {
    ArrowLeft: () => turn(-0.12, 0), ArrowRight: () => turn(0.12, 0), ArrowUp: () => turn(0, 0.12), ArrowDown: () => turn(0, -0.12),
    "+": () => zoom(0.87), "=": () => zoom(0.87), "-": () => zoom(1.15),
    PageUp: () => { control("layer").stepUp(); moveSlice(); }, PageDown: () => { control("layer").stepDown(); moveSlice(); },
  };
  canvas.addEventListener("keydown", (event) => {
    if (!KEYS[event.key]) return;
    event.preventDefault();
    KEYS[event.key]();
  });

  for (const name of ["drive", "other", "shown", "surfaces", "array"]) control(name).addEventListener("input", chooseDrive);
  for (const name of ["axis", "layer", "slice"]) control(name).addEventListener("input", moveSlice);
  control("cut").addEventListener("input", draw);
  for (const button of root.querySelectorAll("[data-look]")) button.addEventListener("click", () => look(button.dataset.look));

  // --- pictures to keep ---------------------------------------------------------------------------------------------

  function drawing() {
    fine = 1;
    paint(performance.now());
    const [, , width, height] = overlay.getAttribute("viewBox").split(" ");
    const copy = overlay.cloneNode(true);
    for (const [name, value] of Object.entries({ width, height, xmlns: "http://www.w3.org/2000/svg", "font-family": "system-ui, sans-serif" })) copy.setAttribute(name, value);
    copy.prepend(
      piece("rect", { width, height, fill: getComputedStyle(root).getPropertyValue("--paper").trim() }),
      piece("image", { width, height, href: canvas.toDataURL("image/png") }),
    );
    return new XMLSerializer().serializeToString(copy);
  }

  function keep(name, blob) {
    const link = Object.assign(document.createElement("a"), { download: name, href: URL.createObjectURL(blob) });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  control("svg").addEventListener("click", () => keep(`${facts.title}.svg`, new Blob([drawing()], { type: "image/svg+xml" })));
  control("png").addEventListener("click", async () => {
    const picture = new Image();
    picture.src = `data:image/svg+xml,${encodeURIComponent(drawing())}`;
    await picture.decode();
    const sheet = document.createElement("canvas");
    [sheet.width, sheet.height] = [2 * picture.width, 2 * picture.height];
    sheet.getContext("2d").drawImage(picture, 0, 0, sheet.width, sheet.height);
    sheet.toBlob((blob) => keep(`${facts.title}.png`, blob), "image/png");
  });

  // --- begin --------------------------------------------------------------------------------------------------------

  document.documentElement.classList.add("in-space");
  new ResizeObserver(fit).observe(canvas.parentElement);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
  chooseDrive();
  moveSlice();
  fit();
  look("foci");
  requestAnimationFrame(() => { root.dataset.firstPicture = performance.now().toFixed(0); });
})().catch((fault) => {
  document.documentElement.classList.remove("in-space");
  document.querySelector("#viewer-fault").hidden = false;
  document.querySelector("#viewer-fault").textContent = `The scene in 3-D cannot be shown here (${fault.message}); still pictures follow.`;
});
