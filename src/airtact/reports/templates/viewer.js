// The 3-D scene of a page, drawn with three.js: the array, the bodies with the pressure on them, the foci, and a movable
// slice through the field. Lengths are in mm. Pressures are stored as bytes, 255 √(p / most).
"use strict";

const FAINT = 0.1; // share of the largest pressure below which a difference fades to grey
const SHEET = 0x735c40; // colour of a rigid plane
const OBJECT = 0x2f7fb8; // colour of a virtual object
const SLOW = 60; // ms between frames above which a drag is drawn more coarsely

// Colour of a pressure, or of the ratio of two pressures, from the square roots of pressure / largest.
const COLOUR = `
  uniform sampler2D pressures, differences;
  uniform int shown;
  const vec3 BODY = vec3(0.72, 0.70, 0.68);
  float decibels(float ratio) { return 20.0 * log(ratio) / log(10.0); }
  vec3 coloured(float one, float other) {
    float p = max(one * one, 1e-5), q = max(other * other, 1e-5);
    if (shown == 2) {
      float share = 0.5 + decibels(p / q) / ${(2 * DIFFERENCE).toFixed(1)};
      vec3 colour = texture(differences, vec2(clamp(share, 0.004, 0.996), 0.5)).rgb;
      return mix(vec3(0.80), colour, smoothstep(${0.5 * FAINT}, ${1.5 * FAINT}, max(p, q)));
    }
    float share = shown == 1 ? 1.0 + decibels(p) / ${LEVELS.toFixed(1)} : p;
    return texture(pressures, vec2(clamp(share, 0.004, 0.996), 0.5)).rgb;
  }`;

const SLICE = {
  vertexShader: `
    attribute vec3 cell;
    varying vec3 at;
    void main() { at = cell; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`,
  fragmentShader: `
    precision highp sampler3D;
    uniform sampler3D first, second; // pressure and depth
    varying vec3 at;
    ${COLOUR}
    void main() {
      vec2 here = texture(first, at).rg;
      vec3 field = coloured(here.r, shown == 2 ? texture(second, at).r : here.r);
      gl_FragColor = vec4(mix(field, 0.86 * BODY, smoothstep(0.48, 0.52, here.g)), 1.0);
    }`,
};

// Discs that fade into the background. Transparent discs would be slow.
const DISCS = {
  vertexShader: `
    varying vec3 colour;
    void main() {
      colour = instanceColor;
      gl_Position = projectionMatrix * modelViewMatrix * instanceMatrix * vec4(position, 1.0);
    }`,
  fragmentShader: `
    uniform vec3 paper;
    uniform float strength;
    varying vec3 colour;
    void main() { gl_FragColor = vec4(mix(paper, colour, gl_FrontFacing ? strength : 0.5 * strength), 1.0); }`,
};

const SURFACE = {
  vertexShader: `
    attribute float one, other;
    varying vec3 facing;
    varying float a, b;
    #include <clipping_planes_pars_vertex>
    void main() {
      a = one;
      b = other;
      facing = normalMatrix * normal;
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
      float strength = plain ? 0.0 : shown > 0 ? 1.0 : smoothstep(0.0, 0.2, a * a);
      gl_FragColor = vec4((gl_FrontFacing ? lit : 0.45) * mix(BODY, coloured(a, b), strength), 1.0);
    }`,
};

const element = (id) => document.getElementById(id);

async function unpacked(id) {
  const packed = Uint8Array.from(atob(element(id).textContent.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

class Viewer {
  constructor(root, facts, numbers) {
    Object.assign(this, { root, facts, numbers, fine: 1, last: 0, frames: 0, wanted: false });
    this.canvas = root.querySelector("canvas");
    this.readout = root.querySelector("output");
    this.axes = facts.slices.axes.map((axis) => new THREE.Vector3(...axis));
    this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: true, alpha: true });
    this.renderer.setClearColor(0, 0);
    this.renderer.localClippingEnabled = true;
    this.camera = new THREE.PerspectiveCamera(30, 1, 1, 1000);
    this.scene = new THREE.Scene();
    this.build();
    this.overlay = new Overlay(root.querySelector("svg"), facts, this.camera);
    const limits = [0.5 * facts.views.foci.reach, 12 * facts.views.array.reach];
    this.turning = new Turning(this.canvas, this.camera, ...limits, () => this.draw());
    this.connect();
  }

  control(name) {
    return this.root.querySelector(`[name=${name}]`);
  }

  array(name) {
    const kinds = { float32: Float32Array, uint8: Uint8Array, uint32: Uint32Array };
    const [kind, offset, count] = this.facts.arrays[name];
    return new kinds[kind](this.numbers, offset, count);
  }

  // --- what there is -----------------------------------------------------------------------------------------------

  build() {
    const { facts } = this;
    this.fields = facts.drives.map((_, index) => this.volume(`field ${index}`));
    this.uniforms = {
      pressures: { value: this.palette("pressure") },
      differences: { value: this.palette("difference") },
      shown: { value: 0 },
      plain: { value: false },
      first: { value: this.fields[0] },
      second: { value: this.fields[0] },
    };
    const both = { uniforms: this.uniforms, side: THREE.DoubleSide };
    this.slice = new THREE.Mesh(new THREE.BufferGeometry(), new THREE.ShaderMaterial({ ...both, ...SLICE }));
    this.slice.geometry.setIndex([0, 1, 2, 2, 1, 3]);
    for (const name of ["position", "cell"]) {
      this.slice.geometry.setAttribute(name, this.numbersOf(new Float32Array(12), 3));
    }
    this.edge = new THREE.LineLoop(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: 0x8a6fb0 }));
    this.surface = new THREE.Mesh(
      new THREE.BufferGeometry(), new THREE.ShaderMaterial({ ...both, ...SURFACE, clipping: true }));
    this.surface.visible = "vertices" in facts.arrays;
    if (this.surface.visible) {
      this.surface.geometry.setAttribute("position", this.numbersOf(this.array("vertices"), 3));
      this.surface.geometry.setIndex(this.numbersOf(this.array("triangles"), 1));
      this.surface.geometry.computeVertexNormals();
    }
    this.elements = this.discs();
    this.sheets = facts.sheets.map((corners) => this.sheet(corners));
    this.objects = facts.objects.map((name) => this.virtualObject(name));
    for (const drawn of [this.slice, this.edge, this.elements]) drawn.frustumCulled = false;
    this.scene.add(this.slice, this.edge, this.surface, this.elements, ...this.sheets, ...this.objects);
  }

  // A virtual object: its front and back are translucent, so that the skin inside stays visible.
  virtualObject(name) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", this.numbersOf(this.array(`object ${name} vertices`), 3));
    geometry.setIndex(this.numbersOf(this.array(`object ${name} triangles`), 1));
    const glass = { transparent: true, opacity: 0.3, depthWrite: false, side: THREE.DoubleSide };
    return new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ color: OBJECT, ...glass }));
  }

  // A rigid plane: a translucent sheet from the front, and only its edge from behind, so that it tints no pressure.
  sheet(corners) {
    const points = corners.map((corner) => new THREE.Vector3(...corner));
    const geometry = new THREE.BufferGeometry().setFromPoints(points).setIndex([0, 1, 2, 0, 2, 3]);
    const glass = { transparent: true, opacity: 0.3, depthWrite: false };
    const behind = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 4 }; // elements may lie on it
    const sheet = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ color: SHEET, ...glass, ...behind }));
    const line = new THREE.BufferGeometry().setFromPoints(points);
    sheet.add(new THREE.LineLoop(line, new THREE.LineBasicMaterial({ color: SHEET })));
    return sheet;
  }

  numbersOf(values, size, normalised = false) {
    return new THREE.BufferAttribute(values, size, normalised);
  }

  palette(name) {
    const parts = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
    const bytes = this.facts.colours[name].flatMap((hex) => [...parts(hex), 255]);
    const texture = new THREE.DataTexture(new Uint8Array(bytes), bytes.length / 4, 1);
    texture.minFilter = texture.magFilter = THREE.LinearFilter;
    texture.needsUpdate = true;
    return texture;
  }

  volume(name) {
    const [pressure, depth] = [this.array(name), this.array("depth")];
    const both = new Uint8Array(2 * depth.length);
    for (let index = 0; index < depth.length; index++) {
      both[2 * index] = pressure[index];
      both[2 * index + 1] = depth[index];
    }
    const texture = new THREE.Data3DTexture(both, ...this.facts.slices.counts);
    texture.format = THREE.RGFormat;
    texture.minFilter = texture.magFilter = THREE.LinearFilter;
    texture.unpackAlignment = 1;
    texture.needsUpdate = true;
    return texture;
  }

  discs() {
    const [positions, normals] = [this.array("positions"), this.array("normals")];
    const uniforms = { paper: { value: new THREE.Color() }, strength: { value: 1 } };
    const side = this.facts.backs ? THREE.DoubleSide : THREE.FrontSide; // backs of a box would hide the bodies
    const material = new THREE.ShaderMaterial({ uniforms, side, ...DISCS });
    const circle = new THREE.CircleGeometry(this.facts.radius, 16);
    const discs = new THREE.InstancedMesh(circle, material, positions.length / 3);
    const turned = new THREE.Object3D();
    for (let index = 0; index < discs.count; index++) {
      turned.position.fromArray(positions, 3 * index);
      turned.lookAt(new THREE.Vector3().fromArray(normals, 3 * index).add(turned.position));
      turned.updateMatrix();
      discs.setMatrixAt(index, turned.matrix);
    }
    return discs;
  }

  // --- what is shown -----------------------------------------------------------------------------------------------

  choose() {
    const { uniforms, facts } = this;
    [this.drive, this.other] = ["drive", "other"].map((name) => Number(this.control(name).value));
    this.shown = this.control("shown").value;
    this.control("other").closest("label").hidden = this.shown !== "difference";
    uniforms.shown.value = ["pressure", "level", "difference"].indexOf(this.shown);
    uniforms.first.value = this.fields[this.drive];
    uniforms.second.value = this.fields[this.other];
    uniforms.plain.value = !this.control("surfaces").checked;
    if (this.surface.visible) {
      const { geometry } = this.surface;
      geometry.setAttribute("one", this.numbersOf(this.array(`surface ${this.drive}`), 1, true));
      geometry.setAttribute("other", this.numbersOf(this.array(`surface ${this.other}`), 1, true));
    }
    this.emitted = this.control("array").value;
    this.elements.visible = this.emitted !== "hidden";
    this.largest = this.array(`amplitude ${this.drive}`).reduce((most, value) => Math.max(most, value), 0);
    const kind = this.emitted === "amplitude" ? "amplitude" : "phase";
    const shades = facts.colours[kind];
    const colour = new THREE.Color();
    for (const [index, value] of this.array(`${kind} ${this.drive}`).entries()) {
      const share = kind === "amplitude" ? value / this.largest : 0.5 + value / (2 * Math.PI);
      this.elements.setColorAt(index, colour.set(shades[Math.round(share * (shades.length - 1))]));
    }
    this.elements.instanceColor.needsUpdate = true;
    this.draw();
  }

  along(axis, step) {
    return this.facts.slices.corner[axis] + this.facts.slices.steps[axis] * step;
  }

  point(steps) {
    const sum = (point, step, axis) => point.addScaledVector(this.axes[axis], this.along(axis, step));
    return steps.reduce(sum, new THREE.Vector3());
  }

  moveSlice() {
    const { counts, start, labels } = this.facts.slices;
    const slider = this.control("layer");
    this.axis = Number(this.control("axis").value);
    if (slider.dataset.axis !== String(this.axis)) {
      slider.dataset.axis = this.axis;
      slider.max = counts[this.axis] - 1;
      slider.value = start[this.axis];
    }
    this.layer = Number(slider.value);
    const [u, v] = [0, 1, 2].filter((axis) => axis !== this.axis);
    const corners = [[0, 0], [1, 0], [0, 1], [1, 1]].map(([right, up]) => {
      const steps = [];
      steps[this.axis] = this.layer;
      steps[u] = right * (counts[u] - 1);
      steps[v] = up * (counts[v] - 1);
      return steps;
    });
    const { position, cell } = this.slice.geometry.attributes;
    for (const [corner, steps] of corners.entries()) {
      position.setXYZ(corner, ...this.point(steps).toArray());
      cell.setXYZ(corner, ...steps.map((step, axis) => (step + 0.5) / counts[axis]));
    }
    position.needsUpdate = cell.needsUpdate = true;
    this.edge.geometry.setFromPoints([0, 1, 3, 2].map((corner) => this.point(corners[corner])));
    this.slice.visible = this.edge.visible = this.control("slice").checked;
    const words = `${labels[this.axis]} = ${grouped(this.along(this.axis, this.layer), 1)} mm`;
    this.root.querySelector(".layer").textContent = words;
    slider.setAttribute("aria-valuetext", words);
    this.draw();
  }

  look(name) {
    const { middle, reach, seen } = this.facts.views[name];
    this.turning.look(middle, reach, seen);
  }

  draw() {
    if (!this.wanted) requestAnimationFrame((now) => this.paint(now));
    this.wanted = true;
  }

  paint(now) {
    this.wanted = false;
    const { turning, facts } = this;
    if (this.overlay.width < 100) return; // not laid out yet
    const since = now - this.last;
    this.last = now;
    if (turning.dragging && since > SLOW && since < 10 * SLOW) this.fine = Math.max(0.4, 0.8 * this.fine);
    const ratio = Math.min(devicePixelRatio, 2) * this.fine;
    if (ratio !== this.renderer.getPixelRatio()) this.renderer.setPixelRatio(ratio); // it makes all buffers anew
    turning.place();
    const { first, array } = facts.views;
    const far = facts.backs ? 1 : Math.min(1, Math.max(0, (turning.distance - 5 * first.reach) / array.reach));
    const { paper, strength } = this.elements.material.uniforms;
    paper.value.set(getComputedStyle(this.root).getPropertyValue("--paper").trim());
    strength.value = 0.3 + 0.7 * far; // close up they are the background
    this.surface.material.clippingPlanes = this.cutting();
    this.renderer.render(this.scene, this.camera);
    const { shown, emitted, largest } = this;
    const [drive, other] = [this.drive, this.other].map((index) => facts.drives[index]);
    this.overlay.draw({ shown, drive, other, array: emitted, largest, turning });
    this.canvas.dataset.frames = ++this.frames;
    clearTimeout(this.settling);
    if (this.fine < 1 && !turning.dragging) this.settling = setTimeout(() => this.sharpen(), 150);
  }

  sharpen() {
    this.fine = 1;
    this.draw();
  }

  // The clipping plane that removes everything between the viewer and the slice.
  cutting() {
    if (!this.control("cut").checked || !this.slice.visible) return [];
    const plane = new THREE.Plane(this.axes[this.axis].clone(), -this.along(this.axis, this.layer));
    return [plane.distanceToPoint(this.camera.position) > 0 ? plane.negate() : plane];
  }

  fit() {
    const { width, height } = this.canvas.parentElement.getBoundingClientRect();
    if (!width || !height) return;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.overlay.resize(width, height);
    this.paint(performance.now());
  }

  connect() {
    for (const name of ["drive", "other", "shown", "surfaces", "array"]) {
      this.control(name).addEventListener("input", () => this.choose());
    }
    for (const name of ["axis", "layer", "slice"]) this.control(name).addEventListener("input", () => this.moveSlice());
    this.control("cut").addEventListener("input", () => this.draw());
    for (const button of this.root.querySelectorAll("[data-look]")) {
      button.addEventListener("click", () => this.look(button.dataset.look));
    }
    const step = (way) => {
      this.control("layer")[way]();
      this.moveSlice();
    };
    Object.assign(this.turning.keys, { PageUp: () => step("stepUp"), PageDown: () => step("stepDown") });
    const values = new Values(this);
    for (const event of ["pointermove", "pointerdown"]) this.canvas.addEventListener(event, (moved) => values.show(moved));
    this.canvas.addEventListener("pointerleave", () => values.hide());
    this.control("svg").addEventListener("click", () => this.keep("svg", this.still()));
    this.control("png").addEventListener("click", () => this.keepPng());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  // --- pictures to keep --------------------------------------------------------------------------------------------

  still() {
    this.fine = 1;
    this.paint(performance.now());
    return new Blob([this.overlay.saved(this.canvas)], { type: "image/svg+xml" });
  }

  keep(ending, blob) {
    const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob) });
    link.download = `${this.facts.title}.${ending}`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
  }

  async keepPng() {
    const drawn = new Image();
    drawn.src = `data:image/svg+xml,${encodeURIComponent(await this.still().text())}`;
    await drawn.decode();
    const size = { width: 2 * drawn.width, height: 2 * drawn.height };
    const sheet = Object.assign(document.createElement("canvas"), size);
    sheet.getContext("2d").drawImage(drawn, 0, 0, sheet.width, sheet.height);
    sheet.toBlob((blob) => this.keep("png", blob), "image/png");
  }
}

(async function begin() {
  const [library, numbers] = await Promise.all([unpacked("three"), unpacked("viewer-numbers")]);
  const script = document.createElement("script");
  script.textContent = new TextDecoder().decode(library);
  document.head.append(script);
  document.documentElement.classList.add("in-space");
  const viewer = new Viewer(element("viewer"), JSON.parse(element("viewer-facts").textContent), numbers);
  viewer.choose();
  viewer.moveSlice();
  viewer.fit();
  viewer.look("first");
  new ResizeObserver(() => viewer.fit()).observe(viewer.canvas.parentElement);
  requestAnimationFrame(() => (viewer.root.dataset.firstPicture = performance.now().toFixed(0)));
})().catch((fault) => {
  document.documentElement.classList.remove("in-space");
  const words = `The scene in 3-D cannot be shown here (${fault.message}); still pictures follow.`;
  Object.assign(element("viewer-fault"), { hidden: false, textContent: words });
});
