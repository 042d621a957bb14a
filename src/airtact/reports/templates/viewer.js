// The 3-D scene of a report: the array, the bodies with the pressure on them, the foci, and a movable slice through the
// field. Lengths are in mm.
"use strict";

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

class Viewer extends Stage {
  constructor(root, facts, numbers) {
    super(root, facts, numbers, [0.5 * facts.views.foci.reach, 12 * facts.views.array.reach]);
    this.readout = root.querySelector("output");
    this.connect();
  }

  // --- what there is -----------------------------------------------------------------------------------------------

  build() {
    const { facts, uniforms } = this;
    this.renderer.localClippingEnabled = true;
    this.axes = facts.slices.axes.map((axis) => new THREE.Vector3(...axis));
    this.fields = facts.drives.map((_, index) => this.volume(`field ${index}`));
    Object.assign(uniforms, { first: { value: this.fields[0] }, second: { value: this.fields[0] } });
    this.slice = new THREE.Mesh(
      this.meshOf(new Float32Array(12), new Uint32Array([0, 1, 2, 2, 1, 3])),
      new THREE.ShaderMaterial({ uniforms, side: THREE.DoubleSide, ...SLICE }),
    );
    this.slice.geometry.setAttribute("cell", this.numbersOf(new Float32Array(12), 3));
    this.edge = new THREE.LineLoop(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: 0x8a6fb0 }));
    const solid = "vertices" in facts.arrays;
    const [vertices, triangles] = ["vertices", "triangles"].map((name) => (solid ? this.array(name) : []));
    this.surface = this.surfaceOf(new Float32Array(vertices), new Uint32Array(triangles), { clipping: true });
    this.surface.visible = solid;
    this.elements = this.discs(16);
    this.sheets = facts.sheets.map((corners) => this.sheet(corners));
    this.objects = facts.objects.map((name) =>
      this.virtualObject(this.array(`object ${name} vertices`), this.array(`object ${name} triangles`)));
    for (const drawn of [this.slice, this.edge]) drawn.frustumCulled = false;
    this.scene.add(this.slice, this.edge, this.surface, this.elements, ...this.sheets, ...this.objects);
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
    const values = Array.from(this.array(`${kind} ${this.drive}`));
    const share = (value) => (kind === "amplitude" ? value / this.largest : 0.5 + value / (2 * Math.PI));
    this.colourDiscs(this.elements, kind, values.map(share));
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

  prepare() {
    const { turning, facts } = this;
    const { first, array } = facts.views;
    const far = facts.backs ? 1 : Math.min(1, Math.max(0, (turning.distance - 5 * first.reach) / array.reach));
    this.elements.material.uniforms.strength.value = 0.3 + 0.7 * far; // close up, they are only the background
    this.surface.material.clippingPlanes = this.cutting();
  }

  annotate() {
    const { shown, emitted, largest, turning } = this;
    const [drive, other] = [this.drive, this.other].map((index) => this.facts.drives[index]);
    this.overlay.draw({ shown, drive, other, array: emitted, largest, turning });
  }

  // The clipping plane that removes everything between the viewer and the slice.
  cutting() {
    if (!this.control("cut").checked || !this.slice.visible) return [];
    const plane = new THREE.Plane(this.axes[this.axis].clone(), -this.along(this.axis, this.layer));
    return [plane.distanceToPoint(this.camera.position) > 0 ? plane.negate() : plane];
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
  }

  // --- pictures to keep --------------------------------------------------------------------------------------------

  still() {
    this.fine = 1;
    this.paint(performance.now());
    return new Blob([this.overlay.saved(this.canvas)], { type: "image/svg+xml" });
  }

  keep(ending, blob) {
    save(`${this.facts.title}.${ending}`, blob);
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
  const [numbers] = await Promise.all([unpacked("viewer-numbers"), loadThree()]);
  document.documentElement.classList.add("in-space");
  const viewer = new Viewer(element("viewer"), JSON.parse(element("viewer-facts").textContent), numbers);
  viewer.choose();
  viewer.moveSlice();
  viewer.fit();
  viewer.look("first");
  requestAnimationFrame(() => (viewer.root.dataset.firstPicture = performance.now().toFixed(0)));
})().catch((fault) => {
  document.documentElement.classList.remove("in-space");
  const words = `The scene in 3-D cannot be shown here (${fault.message}); still pictures follow.`;
  Object.assign(element("viewer-fault"), { hidden: false, textContent: words });
});
