// Labels, rings around the foci, colour scales and axes, drawn as SVG over the scene so that they stay sharp.
"use strict";

const DIFFERENCE = 6; // dB at the ends of the colours of a difference
const LEVELS = 40; // range of the colours of levels [dB]
const MOST_NAMES = 8; // largest number of foci with names and large rings

const grouped = (number, digits = 0) =>
  number
    .toLocaleString("en", { minimumFractionDigits: digits, maximumFractionDigits: digits })
    .replace(/^-(?=[0.]+$)/, "") // no negative zero
    .replace("-", "−");
const decibels = (pressure) => 20 * Math.log10(Math.max(pressure, 1e-3) / Math.SQRT2 / 20e-6);

class Overlay {
  constructor(svg, facts, camera) {
    Object.assign(this, { svg, facts, camera, width: 1, height: 1 });
  }

  resize(width, height) {
    Object.assign(this, { width, height });
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  }

  // Position of a point in the camera's view, in pixels.
  seen(point) {
    const { x, y } = point.clone().project(this.camera);
    return [((1 + x) * this.width) / 2, ((1 - y) * this.height) / 2];
  }

  made(kind, attributes, text = "") {
    const piece = document.createElementNS(this.svg.namespaceURI, kind);
    for (const [name, value] of Object.entries(attributes)) piece.setAttribute(name, value);
    piece.textContent = text;
    return piece;
  }

  add(kind, attributes, text) {
    this.svg.append(this.made(kind, attributes, text));
  }

  write(x, y, text, size, anchor = "start") {
    const halo = { stroke: this.paper, "stroke-width": 3, "paint-order": "stroke", "stroke-linejoin": "round" };
    this.add("text", { x, y, fill: this.ink, "font-size": size, "text-anchor": anchor, ...halo }, text);
  }

  // shown: "pressure", "level" or "difference" for two drives given by name, or "" without a colour scale; array:
  // "phase", "amplitude" or "hidden"; turning: the position of the viewer. The scale states the largest amplitude.
  draw({ shown, drive, other, array, largest, turning }) {
    const style = getComputedStyle(this.svg);
    this.ink = style.getPropertyValue("--ink").trim();
    this.paper = style.getPropertyValue("--paper").trim();
    this.svg.replaceChildren();
    this.drawPaths();
    this.ringFoci();
    const length = Math.min(230, this.width / 2 - 36);
    const titles = {
      pressure: "peak pressure [Pa]",
      level: "level [dB re 20 µPa]",
      difference: `${drive} relative to ${other} [dB]`,
    };
    const colours = shown === "difference" ? "difference" : "pressure";
    if (shown) this.scale(18, length, colours, this.ticks(shown, length < 180 ? 3 : 4), titles[shown]);
    const right = this.width - length - 18;
    const turn = [[0, "−π"], [0.5, "0"], [1, "π"]];
    if (array === "phase") this.scale(right, length, array, turn, "transducers: phase [rad]");
    const ends = [[0, "0"], [1, grouped(largest, 2)]];
    if (array === "amplitude") this.scale(right, length, array, ends, "transducers: amplitude");
    this.axes(turning);
  }

  drawPaths() {
    for (const path of this.facts.paths) {
      const points = path.map((point) => this.seen(new THREE.Vector3(...point)).join()).join(" ");
      this.add("polygon", { points, fill: "none", stroke: this.paper, "stroke-width": 3 });
      const line = { points, fill: "none", stroke: "#e8590c", "stroke-width": 1.4, "stroke-dasharray": "4 3" };
      this.add("polygon", { ...line, class: "path" });
    }
  }

  ringFoci() {
    const few = this.facts.foci.length <= MOST_NAMES;
    const [middle] = this.seen(new THREE.Vector3(...this.facts.views.foci.middle));
    for (const { name, label = name, position } of this.facts.foci) {
      const [x, y] = this.seen(new THREE.Vector3(...position));
      const ring = { cx: x, cy: y, r: few ? 9 : 3, fill: "none" };
      this.add("circle", { ...ring, stroke: this.paper, "stroke-width": 3.5 });
      this.add("circle", { ...ring, stroke: "#e8590c", "stroke-width": 1.8 });
      if (!few || !label) continue;
      // A name that would leave a narrow screen is moved, also up or down, so that no two names overlap.
      const side = x < middle ? -1 : 1;
      const long = 6.6 * label.length; // approximate width
      const start = side < 0 ? Math.max(x - 14, long) : Math.min(x + 14, this.width - long);
      const moved = start === x + 14 * side ? 0 : 16 * side;
      this.write(start, y + 4 + moved, label, 13, side < 0 ? "end" : "start");
    }
  }

  scale(left, length, name, ticks, title) {
    const top = this.height - 32;
    const colours = this.facts.colours[name].filter((_, index, all) => index % 8 === 0 || index === all.length - 1);
    const gradient = this.made("linearGradient", { id: `scale-${name}` });
    for (const [index, colour] of colours.entries()) {
      gradient.append(this.made("stop", { offset: index / (colours.length - 1), "stop-color": colour }));
    }
    const plate = { x: left - 10, y: top - 22, width: length + 22, height: 52, rx: 5, fill: this.paper, opacity: 0.82 };
    this.add("rect", plate);
    const box = { x: left, y: top, width: length, height: 10, stroke: this.ink, "stroke-width": 0.5 };
    this.svg.append(gradient, this.made("rect", { ...box, fill: `url(#scale-${name})` }));
    this.write(left, top - 6, title, 12);
    for (const [share, text] of ticks) {
      const x = left + share * length;
      this.add("line", { x1: x, x2: x, y1: top + 10, y2: top + 14, stroke: this.ink });
      this.write(x, top + 26, text, 11, "middle");
    }
  }

  // Positions on the scale, from 0 to 1, and their labels.
  ticks(shown, count) {
    const most = this.facts.most;
    const signed = (share) => `${share > 0 ? "+" : ""}${grouped(share * DIFFERENCE)}`;
    if (shown === "difference") return [-1, -0.5, 0, 0.5, 1].map((share) => [(1 + share) / 2, signed(share)]);
    if (shown === "level") {
      const top = decibels(most);
      const levels = [0, 10, 20, 30].map((down) => 10 * Math.floor(top / 10) - down);
      return levels.map((level) => [1 - (top - level) / LEVELS, String(level)]);
    }
    const power = 10 ** Math.floor(Math.log10(most / count));
    const step = [1, 2, 2.5, 5, 10].map((factor) => factor * power).find((size) => size >= most / count);
    const digits = step < 1 ? 2 : 0;
    const whole = Math.floor(most / step);
    return [...Array(whole + 1).keys()].map((n) => [(n * step) / most, grouped(n * step, digits)]);
  }

  axes({ target, pixel }) {
    const [fromX, fromY] = this.seen(target);
    const [x, y] = [this.width - 44, 48];
    for (const [axis, name] of [..."xyz"].entries()) {
      const tip = target.clone().setComponent(axis, target.getComponent(axis) + 26 * pixel);
      const [toX, toY] = this.seen(tip);
      const [dx, dy] = [toX - fromX, toY - fromY];
      const line = { x1: x, y1: y, x2: x + dx, y2: y + dy };
      this.add("line", { ...line, stroke: this.paper, "stroke-width": 4.5 });
      this.add("line", { ...line, stroke: this.ink, "stroke-width": 1.8 });
      this.write(x + 1.35 * dx, y + 1.35 * dy + 4, name, 13, "middle");
    }
  }

  // The scene and its overlay as a single SVG.
  saved(canvas) {
    const { width, height } = this;
    const copy = this.svg.cloneNode(true);
    const words = { width, height, "font-family": "system-ui, sans-serif" };
    for (const [name, value] of Object.entries(words)) copy.setAttribute(name, value);
    copy.prepend(
      this.made("rect", { width, height, fill: this.paper }),
      this.made("image", { width, height, href: canvas.toDataURL("image/png") }),
    );
    return new XMLSerializer().serializeToString(copy);
  }
}
