// The map of reach: the skin coloured by the largest pressure that the array can produce there. Lengths are in mm.
"use strict";

class Reach extends Stage {
  constructor(root, facts, numbers) {
    super(root, facts, numbers, [0.5 * facts.views.first.reach, 12 * facts.views.array.reach]);
    this.readout = root.querySelector("output");
    this.ray = new THREE.Raycaster();
    for (const name of ["shown", "array", "points"]) this.control(name).addEventListener("input", () => this.choose());
    for (const button of root.querySelectorAll("[data-look]")) {
      button.addEventListener("click", () => this.look(button.dataset.look));
    }
    for (const event of ["pointermove", "pointerdown"]) this.canvas.addEventListener(event, (moved) => this.show(moved));
    this.canvas.addEventListener("pointerleave", () => (this.readout.hidden = true));
  }

  build() {
    this.bounds = this.array("bounds");
    // Range of the colours: the whole range of levels in steps of 5 dB, at most 40 dB
    const range = this.bounds.reduce((most, pressure) => Math.max(most, -this.below(pressure)), 0);
    this.span = Math.min(40, 5 * Math.ceil(range / 5 + 1e-6));
    this.uniforms.shown.value = 1; // do not fade low pressures
    this.surface = this.surfaceOf(this.array("vertices"), this.array("triangles"));
    this.elements = this.discs(16);
    this.colourDiscs(this.elements, "phase", new Array(this.array("positions").length / 3).fill(-1));
    const dots = new THREE.BufferGeometry();
    dots.setAttribute("position", this.numbersOf(new Float32Array(this.facts.points.flatMap((point) => point.position)), 3));
    this.dots = new THREE.Points(dots, new THREE.PointsMaterial({ color: 0x202020, size: 3, sizeAttenuation: false }));
    this.scene.add(this.surface, this.elements, this.dots, ...this.facts.sheets.map((corners) => this.sheet(corners)));
  }

  choose() {
    this.shown = this.control("shown").value;
    this.elements.visible = this.control("array").checked;
    this.dots.visible = this.control("points").checked;
    // The shader maps LEVELS dB to the colour scale; this value corrects for the range used here.
    const value = (pressure) => 10 ** ((LEVELS / 20) * (this.share(pressure) - 1) / 2);
    this.surface.geometry.setAttribute("one", this.numbersOf(Float32Array.from(this.bounds, value), 1));
    this.draw();
  }

  // Place of a pressure on the colour scale.
  share(pressure) {
    const { least, most } = this.facts;
    if (this.shown === "pressure") return Math.max(0, (pressure - least) / (most - least));
    return Math.max(0, 1 + this.below(pressure) / this.span);
  }

  below(pressure) {
    return 20 * Math.log10(pressure / this.facts.most);
  }

  prepare() {
    this.elements.material.uniforms.strength.value = 0.35; // they are only the background
  }

  annotate() {
    const { overlay, turning } = this;
    overlay.draw({ shown: "", array: "hidden", largest: 1, turning });
    const length = Math.min(260, overlay.width - 50);
    const [least, most] = [this.facts.least / 1e3, this.facts.most / 1e3];
    const range = most - least;
    const levels = [0, 0.2, 0.4, 0.6, 0.8, 1].map((share) => [1 - share, share ? grouped(-share * this.span) : "0"]);
    const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50].find((size) => range / size < 6) ?? 100;
    const first = Math.ceil(least / step - 1e-9);
    const ticks = [...Array(1 + Math.floor(most / step + 1e-9) - first).keys()].map((n) => (first + n) * step);
    const pressures = ticks.map((tick) => [(tick - least) / range, grouped(tick, step < 1 ? 1 : 0)]);
    const titles = { pressure: "largest peak pressure [kPa]", level: "below the strongest point [dB]" };
    const chosen = this.shown === "pressure" ? pressures : levels;
    overlay.scale(18, length, "pressure", chosen, titles[this.shown]);
  }

  show(event) {
    const box = this.canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    this.ray.setFromCamera({ x: (2 * x) / box.width - 1, y: 1 - (2 * y) / box.height }, this.camera);
    const [hit] = this.ray.intersectObject(this.surface, false);
    this.readout.hidden = !hit || (this.turning.dragging && event.type === "pointermove");
    if (this.readout.hidden) return;
    const span = (line) => Object.assign(document.createElement("span"), { textContent: line });
    this.readout.replaceChildren(...this.lines(hit).map(span));
    this.readout.style.left = `${Math.max(4, Math.min(x + 14, box.width - this.readout.offsetWidth - 4))}px`;
    this.readout.style.top = `${Math.max(4, y - this.readout.offsetHeight - 12)}px`;
  }

  // The part, the position and the interpolated bound at the point of the skin under the pointer.
  lines({ point, face }) {
    const corners = [face.a, face.b, face.c];
    const { position } = this.surface.geometry.attributes;
    const places = corners.map((corner) => new THREE.Vector3().fromBufferAttribute(position, corner));
    const weights = THREE.Triangle.getBarycoord(point, ...places, new THREE.Vector3()).toArray();
    const pressure = corners.reduce((sum, corner, index) => sum + weights[index] * this.bounds[corner], 0);
    const away = ({ position: at }) => point.distanceToSquared(new THREE.Vector3(...at));
    const nearest = this.facts.points.reduce((best, other) => (away(other) < away(best) ? other : best));
    const at = [..."xyz"].map((axis) => `${axis} ${grouped(point[axis], 1)}`).join(", ");
    const level = grouped(this.below(pressure), 1);
    return [`${nearest.place} at ${at} mm`, `at most ${grouped(pressure / 1e3, 2)} kPa`, `${level} dB from the strongest point`];
  }
}

(async function begin() {
  const [numbers] = await Promise.all([unpacked("viewer-numbers"), loadThree()]);
  document.documentElement.classList.add("in-space");
  const viewer = new Reach(element("viewer"), JSON.parse(element("viewer-facts").textContent), numbers);
  viewer.choose();
  viewer.fit();
  viewer.look("first");
  requestAnimationFrame(() => (viewer.root.dataset.firstPicture = performance.now().toFixed(0)));
})().catch((fault) => {
  document.documentElement.classList.remove("in-space");
  const words = `The scene in 3-D cannot be shown here (${fault.message}); a still picture follows.`;
  Object.assign(element("viewer-fault"), { hidden: false, textContent: words });
});
