// Rotates, moves and zooms a camera around a point with mouse, touch or keys; z stays upright.
"use strict";

class Turning {
  // changed() is called after each change. Distances are in the unit of the scene, angles in rad.
  constructor(canvas, camera, nearest, farthest, changed) {
    Object.assign(this, { canvas, camera, nearest, farthest, changed });
    Object.assign(this, { azimuth: 0, elevation: 0, distance: 1, target: new THREE.Vector3() });
    this.pointers = new Map();
    this.keys = {
      ArrowLeft: () => this.turn(-0.12, 0),
      ArrowRight: () => this.turn(0.12, 0),
      ArrowUp: () => this.turn(0, 0.12),
      ArrowDown: () => this.turn(0, -0.12),
      "+": () => this.zoom(0.87),
      "=": () => this.zoom(0.87),
      "-": () => this.zoom(1.15),
    };
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => this.release(event));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("keydown", (event) => this.type(event));
    const wheel = (event) => {
      event.preventDefault();
      this.zoom(Math.exp(0.0012 * event.deltaY));
    };
    canvas.addEventListener("wheel", wheel, { passive: false });
  }

  get dragging() {
    return this.pointers.size > 0;
  }

  // Look at a ball with this radius around a point, from the given azimuth and elevation.
  look(target, radius, [azimuth, elevation]) {
    const half = Math.sin((this.camera.fov * Math.PI) / 360);
    Object.assign(this, { azimuth, elevation, distance: radius / half / Math.min(1, this.camera.aspect) });
    this.target.set(...target);
    this.changed();
  }

  // Length of one pixel at the target, in units of the scene.
  get pixel() {
    return (2 * this.distance * Math.tan((this.camera.fov * Math.PI) / 360)) / this.canvas.clientHeight;
  }

  place() {
    const { azimuth, elevation, distance, target, camera } = this;
    const level = distance * Math.cos(elevation);
    const rise = distance * Math.sin(elevation);
    camera.position.set(level * Math.cos(azimuth), level * Math.sin(azimuth), rise).add(target);
    camera.up.set(0, 0, 1);
    camera.lookAt(target);
    camera.near = distance / 50;
    camera.far = 2 * distance + 2 * this.farthest;
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
  }

  turn(dx, dy) {
    this.azimuth -= dx;
    this.elevation = Math.max(-1.55, Math.min(1.55, this.elevation + dy));
    this.changed();
  }

  zoom(factor) {
    this.distance = Math.max(this.nearest, Math.min(this.farthest, factor * this.distance));
    this.changed();
  }

  slide(dx, dy) {
    const column = (index) => new THREE.Vector3().setFromMatrixColumn(this.camera.matrix, index);
    this.target.addScaledVector(column(0), -dx * this.pixel).addScaledVector(column(1), dy * this.pixel);
    this.changed();
  }

  press(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, event);
    if (this.pointers.size === 2) this.apart = this.spread();
  }

  drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    this.pointers.set(event.pointerId, event);
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    if (this.pointers.size === 2) {
      const spread = this.spread();
      this.zoom(this.apart / spread);
      this.apart = spread;
    } else if (event.shiftKey || event.buttons === 2) this.slide(dx, dy);
    else this.turn(0.008 * dx, 0.008 * dy);
  }

  release(event) {
    this.pointers.delete(event.pointerId);
    this.changed();
  }

  spread() {
    const [one, other] = [...this.pointers.values()];
    return Math.max(1, Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY));
  }

  type(event) {
    if (!this.keys[event.key]) return;
    event.preventDefault();
    this.keys[event.key]();
  }
}
