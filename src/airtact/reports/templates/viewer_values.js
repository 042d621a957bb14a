// The values at the position of the pointer.
"use strict";

class Values {
  constructor(viewer) {
    Object.assign(this, { viewer, ray: new THREE.Raycaster() });
  }

  hide() {
    this.viewer.readout.hidden = true;
  }

  show(event) {
    const { canvas, readout, turning } = this.viewer;
    const box = canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    const lines = turning.dragging && event.type === "pointermove" ? null : this.under(x, y, box);
    readout.hidden = !lines;
    if (!lines) return;
    const span = (line) => Object.assign(document.createElement("span"), { textContent: line });
    readout.replaceChildren(...lines.map(span));
    const left = Math.min(x + 14, box.width - readout.offsetWidth - 4);
    readout.style.left = `${Math.max(4, left)}px`;
    readout.style.top = `${Math.max(4, y - readout.offsetHeight - 12)}px`;
  }

  // Lines of text for the object at a pixel; null if there is none.
  under(x, y, box) {
    const { viewer } = this;
    const { facts, overlay, camera, surface, slice, elements, sheets } = viewer;
    for (const focus of facts.foci) {
      const point = new THREE.Vector3(...focus.position);
      const [fromX, fromY] = overlay.seen(point);
      if (Math.hypot(fromX - x, fromY - y) > 9) continue;
      const asked = focus.asked ? [`requested: ${focus.asked}`] : [];
      return [`focus ${focus.name} at ${this.place(point)}`, ...asked, ...this.each(focus.got)];
    }
    this.ray.setFromCamera({ x: (2 * x) / box.width - 1, y: 1 - (2 * y) / box.height }, camera);
    const drawn = [surface, slice, elements].filter((one) => one.visible);
    const hit = this.ray.intersectObjects(drawn, false).find((one) => this.stands(one));
    const [sheet] = this.ray.intersectObjects(sheets, false);
    if (sheet && (!hit || sheet.distance < hit.distance - 0.01)) return [`rigid plane at ${this.place(sheet.point)}`];
    if (!hit) return null;
    if (hit.object === elements) return this.transducer(this.numberOf(hit));
    return hit.object === surface ? this.onSurface(hit) : this.inAir(hit.point);
  }

  // Whether the hit object is visible: not cut away, and not the hidden back of a disc.
  stands(hit) {
    const { object, point } = hit;
    const { surface, elements } = this.viewer;
    const planes = surface.material.clippingPlanes;
    if (object === surface) return planes.every((plane) => plane.distanceToPoint(point) >= -0.01);
    if (object !== elements) return true;
    const normal = new THREE.Vector3().fromArray(this.viewer.array("normals"), 3 * this.numberOf(hit));
    return this.viewer.facts.backs || normal.dot(this.ray.ray.direction) < 0;
  }

  // Index of the transducer whose disc was hit.
  numberOf({ object, face }) {
    return Math.floor(face.a / object.corners);
  }

  place(point) {
    return `${[..."xyz"].map((name, axis) => `${name} ${grouped(point.getComponent(axis), 1)}`).join(", ")} mm`;
  }

  // A line for each drive, or for the two chosen drives if there are many.
  each(pressures) {
    const { facts, drive, other, shown } = this.viewer;
    const two = shown === "difference" ? [drive, other] : [drive];
    const chosen = facts.drives.length < 4 ? [...facts.drives.keys()] : two;
    const line = (index) => {
      const pressure = pressures[index];
      const pascal = grouped(pressure, pressure < 100 ? 1 : 0);
      return `${facts.drives[index]}: ${pascal} Pa, ${grouped(decibels(pressure), 1)} dB`;
    };
    const lines = chosen.map(line);
    if (shown !== "difference") return lines;
    const change = decibels(pressures[drive]) - decibels(pressures[other]);
    return [...lines, `difference: ${change > 0 ? "+" : ""}${grouped(change, 1)} dB`];
  }

  inPa(byte) {
    return this.viewer.facts.most * (byte / 255) ** 2;
  }

  transducer(index) {
    const { viewer } = this;
    const [amplitude, phase] = ["amplitude", "phase"].map((kind) => viewer.array(`${kind} ${viewer.drive}`)[index]);
    const words = `phase ${grouped(phase, 2)} rad, amplitude ${grouped(amplitude, 2)} of full scale`;
    return [`transducer ${index}, ${viewer.facts.drives[viewer.drive]}`, words];
  }

  onSurface({ point, face }) {
    const { viewer } = this;
    const corners = [face.a, face.b, face.c];
    const mean = (values) => corners.reduce((sum, corner) => sum + values[corner] / 3, 0);
    const pressures = viewer.facts.drives.map((_, index) => this.inPa(mean(viewer.array(`surface ${index}`))));
    return [`surface at ${this.place(point)}`, ...this.each(pressures)];
  }

  inAir(point) {
    const { axes, facts } = this.viewer;
    const { corner, steps } = facts.slices;
    const cell = axes.map((axis, number) => (point.dot(axis) - corner[number]) / steps[number]);
    if (this.sampled("depth", cell) > 127.5) {
      return [`inside a body${facts.sheets.length ? " or behind the plane" : ""}, at ${this.place(point)}`];
    }
    const pressures = facts.drives.map((_, index) => this.inPa(this.sampled(`field ${index}`, cell)));
    return [`air at ${this.place(point)}`, ...this.each(pressures)];
  }

  // Linear interpolation between the eight bytes around a point given in steps.
  sampled(name, cell) {
    const { counts } = this.viewer.facts.slices;
    const bytes = this.viewer.array(name);
    const low = cell.map((at, axis) => Math.max(0, Math.min(Math.floor(at), counts[axis] - 2)));
    let sum = 0;
    for (let corner = 0; corner < 8; corner++) {
      const [x, y, z] = low.map((start, axis) => start + ((corner >> axis) & 1));
      const weights = [x, y, z].map((at, axis) => Math.max(0, 1 - Math.abs(cell[axis] - at)));
      sum += weights[0] * weights[1] * weights[2] * bytes[x + counts[0] * (y + counts[1] * z)];
    }
    return sum;
  }
}
