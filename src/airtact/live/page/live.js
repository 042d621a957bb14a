// The controls and numbers of the live page, and its connection.
"use strict";

const SECONDS = 10; // time span of the curves
const OLD = 5; // age of the displayed pressure above which it is mentioned [s]
const STATES = {
  waiting: ["waiting for a hand", "#868e96"],
  playing: ["playing", "#2f9e44"],
  fading: ["fading: the hand was lost", "#e8590c"],
  silent: ["silent", "#868e96"],
  stopped: ["stopped for good", "#c92a2a"],
};
const RULES = {
  distances: "The phases are computed from path lengths, ignoring the hand.",
  phalanges: "The drive uses a solution for the last phalanges.",
  hand: "The drive uses a solution for the whole hand.",
  carried: "The drive uses a solution for the whole hand, moved with its bones.",
  contacts: "The drive uses a solution for the skin at the contacts.",
};
const CURVES = [
  ["latency, frame to sound [ms]", "#1971c2", 150],
  ["drives per second", "#2f9e44", 150],
  ["expected pressure, of the attainable [%]", "#e8590c", 110],
];

class Panel {
  constructor(root, facts) {
    Object.assign(this, { root, facts, history: [], rows: new Map(), foci: [], room: null, written: 0 });
    this.connect();
    for (const name of ["emergency", "start", "stop", "csv"]) {
      this.control(name).addEventListener("click", () => this[name]());
    }
    document.addEventListener("keydown", (event) => event.key === "Escape" && this.emergency());
    for (const input of root.querySelectorAll("[data-control]")) {
      input.addEventListener("input", () => this.change({ [input.name]: this.valueOf(input) }, input));
    }
    for (const input of root.querySelectorAll("[data-unit]")) input.addEventListener("input", () => this.word(input));
    this.control("across").addEventListener("input", (event) => this.send({ across: event.target.value }));
    this.control("layer").addEventListener("input", (event) => this.send({ offset: 1e-3 * event.target.value }));
    for (const input of this.fingers) input.addEventListener("input", () => this.open());
  }

  control(name) {
    return this.root.querySelector(`[name=${name}]`);
  }

  get fingers() {
    return [...this.root.querySelectorAll("[data-finger]")];
  }

  // --- to the loop -------------------------------------------------------------------------------------------------

  connect() {
    this.socket = new WebSocket(location.href.replace(/^http/, "ws").replace(/#.*/, ""));
    this.socket.binaryType = "arraybuffer";
    this.socket.onmessage = (message) => this.take(message.data);
    this.socket.onopen = () => this.lost && location.reload(); // it may be a new loop
    this.socket.onclose = () => {
      this.lost = true;
      this.write("no connection to the loop", "#c92a2a");
      setTimeout(() => this.connect(), 1000);
    };
  }

  send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  emergency() {
    this.send({ emergency: true });
  }

  start() {
    this.change({ playing: true });
  }

  stop() {
    this.change({ playing: false });
  }

  // Send changed controls. Pictures in transit still contain the old value, so the input ignores them for a while.
  change(controls, input) {
    if (input) input.until = performance.now() + 700;
    this.send({ controls });
  }

  valueOf(input) {
    if (input.type === "checkbox") return input.checked;
    return input.type === "range" ? input.value * input.dataset.scale : input.value;
  }

  word(input) {
    input.parentElement.querySelector("output").textContent = `${input.value} ${input.dataset.unit}`;
  }

  open() {
    this.send({ hand: { fingers: this.fingers.map((input) => Number(input.value)) } });
  }

  // --- from the loop -----------------------------------------------------------------------------------------------

  take(buffer) {
    const length = new DataView(buffer).getUint32(0, true);
    const facts = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
    const { foci, controls, stopped } = facts;
    this.foci = foci;
    const now = performance.now();
    this.history.push([facts.time, facts.drives, facts.latency, facts.kept]);
    this.write(...STATES[stopped ? "stopped" : facts.state]);
    if (stopped) this.control("emergency").textContent = "STOPPED FOR GOOD";
    this.control("emergency").disabled = stopped;
    this.control("start").disabled = stopped || controls.playing;
    this.control("stop").disabled = stopped || !controls.playing;
    if (now - this.written > 330) {
      this.written = now;
      this.update(facts);
    }
    if (this.room) this.room.take(facts, (name) => arrayIn(buffer, facts.arrays[name], 4 + length));
    else setTimeout(() => this.send({ drawn: true }), 200);
  }

  write(words, light) {
    const state = this.root.querySelector(".state");
    if (state.textContent !== words) state.textContent = words;
    state.style.setProperty("--light", light);
  }

  // Show the numbers, three times a second.
  update(facts) {
    const { sound, controls } = facts;
    const values = { ...controls, method: controls.method ?? this.facts.method, offset: controls.offset ?? this.facts.offset };
    for (const input of this.root.querySelectorAll("[data-control]")) {
      if (performance.now() < (input.until ?? 0)) continue;
      const value = values[input.name];
      if (input.type === "checkbox") input.checked = value;
      else input.value = input.type === "range" ? value / input.dataset.scale : value;
      if (input.dataset.unit) this.word(input);
    }
    const number = (value, unit = "", factor = 1) =>
      value === null || !Number.isFinite(value) ? "–" : `${grouped(factor * value)}${unit}`;
    const curves = this.curves();
    const numbers = {
      "drives per second": number(curves[1].at(-1)?.[1]),
      "latency, frame to sound": number(facts.latency, " ms", 1e3),
      "age of the solved hand": number(facts.age, " ms", 1e3),
      "expected share of attainable": number(facts.kept, " %", 100),
      "mean amplitude of the elements": number(facts.mean, " %", 100),
    };
    const rows = Object.entries(numbers).map((cells) => this.row(...cells));
    element("numbers").replaceChildren(...rows);
    element("rule").textContent = RULES[facts.rule];
    element("words").textContent = facts.status;
    let words = "";
    if (sound && sound.age > OLD) words = `The pressure shown is ${grouped(sound.age)} s old.`;
    else if (!sound && facts.mean > 0) words = "The pressure on the skin and in the slice has not been computed yet.";
    element("sound").textContent = words;
    this.showFoci(facts);
    this.drawCurves(curves);
  }

  row(...cells) {
    const row = document.createElement("tr");
    for (const cell of cells) row.insertCell().append(cell);
    return row;
  }

  // One row per focus, with a switch and a strength.
  showFoci({ foci, controls }) {
    if (foci.map(({ name }) => name).join("\n") !== [...this.rows.keys()].join("\n")) {
      this.rows = new Map(foci.map(({ name }) => [name, this.focusRow(name, controls.levels[name] ?? 1)]));
      element("foci").replaceChildren(...[...this.rows.values()].map(({ row }) => row));
    }
    for (const { name, pressure } of foci) {
      const { cell, on, level } = this.rows.get(name);
      cell.textContent = pressure === null ? "–" : `${grouped(pressure)} Pa`;
      if (performance.now() < (level.until ?? 0)) continue;
      const value = controls.levels[name] ?? 1;
      on.checked = value > 0;
      if (value > 0) level.value = 100 * value;
    }
  }

  focusRow(name, value) {
    const on = Object.assign(document.createElement("input"), { type: "checkbox", checked: value > 0 });
    const level = Object.assign(document.createElement("input"), { type: "range", min: 1, max: 100, value: 100 * value || 100 });
    on.setAttribute("aria-label", `${name} on`);
    level.setAttribute("aria-label", `strength of ${name}`);
    for (const input of [on, level]) {
      input.addEventListener("input", () => {
        level.until = performance.now() + 700;
        this.send({ levels: { [name]: on.checked ? level.value / 100 : 0 } });
      });
    }
    const row = this.row(name, on, level, "");
    return { row, on, level, cell: row.lastChild };
  }

  csv() {
    const quoted = (word) => `"${String(word).replaceAll('"', '""')}"`;
    const lines = this.foci.map(({ name, position, pressure }) => {
      const { on, level } = this.rows.get(name);
      return [quoted(name), ...(position ?? ["", "", ""]), pressure ?? "", on.checked ? level.value / 100 : 0].join();
    });
    const head = "focus,x [m],y [m],z [m],peak pressure [Pa],strength";
    save("foci.csv", new Blob([[head, ...lines, ""].join("\n")], { type: "text/csv" }));
  }

  // --- curves ------------------------------------------------------------------------------------------------------

  // Points of each curve: time relative to now [s], and value.
  curves() {
    const now = this.history.at(-1)[0];
    this.history = this.history.filter(([time]) => time > now - SECONDS);
    const rate = ([time, drives]) => {
      const first = this.history.find(([earlier]) => earlier >= time - 1);
      return time - first[0] > 0.5 ? (drives - first[1]) / (time - first[0]) : NaN;
    };
    const values = [(one) => 1e3 * (one[2] ?? NaN), rate, (one) => 100 * (one[3] ?? NaN)];
    return values.map((value) => this.history.map((one) => [one[0] - now, value(one)]));
  }

  drawCurves(curves) {
    const svgs = CURVES.map(([title, colour, high], index) => {
      const points = curves[index]
        .filter(([, value]) => Number.isFinite(value))
        .map(([time, value]) => `${100 * (1 + time / SECONDS)},${40 - (40 * Math.min(value, high)) / high}`);
      return `<p>${title}, up to ${high}</p><svg class="curve" viewBox="0 0 100 40" preserveAspectRatio="none"><polyline
        points="${points.join(" ")}" fill="none" stroke="${colour}" stroke-width="1.5" vector-effect="non-scaling-stroke"/></svg>`;
    });
    element("curves").innerHTML = svgs.join("");
  }
}

(async function begin() {
  const facts = JSON.parse(element("viewer-facts").textContent);
  const panel = new Panel(element("live"), facts);
  try {
    const [numbers] = await Promise.all([unpacked("viewer-numbers"), loadThree()]);
    const room = new Room(element("live"), facts, numbers);
    room.send = (message) => panel.send(message);
    panel.room = room;
    new Headset(room, panel);
  } catch (fault) {
    const words = `The scene in 3-D cannot be shown here (${fault.message}); the controls and numbers still work.`;
    Object.assign(element("viewer-fault"), { hidden: false, textContent: words });
  }
})();
