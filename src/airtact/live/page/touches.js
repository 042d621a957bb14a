// The page of a registration: the array with the points to touch, and the state of each touch. Lengths are in metres.
"use strict";

class Boards extends Stage {
  constructor(root, facts, numbers) {
    super(root, facts, numbers, [0.03, 20 * facts.views.first.reach]);
    this.fit();
    this.look("first");
  }

  build() {
    this.elements = this.discs(12);
    this.colourDiscs(this.elements, "phase", Array(this.elements.geometry.attributes.position.count / 12).fill(-1));
    const length = 0.35 * this.facts.views.first.reach;
    this.arrow = new THREE.ArrowHelper(new THREE.Vector3(), new THREE.Vector3(), length, 0xe8590c, 0.3 * length, 0.15 * length);
    this.arrow.visible = false;
    const sheets = this.facts.sheets.map((corners) => this.sheet(corners));
    this.scene.add(this.elements, this.arrow, ...sheets);
  }

  // Point at a touch, given its index, and turn the view if its face is not visible.
  point(index) {
    if (index === this.index) return;
    const first = this.index === undefined;
    this.index = index;
    const touch = this.facts.touches[index];
    this.arrow.visible = Boolean(touch);
    if (touch) {
      const [point, normal] = [touch.position, touch.normal].map((numbers) => new THREE.Vector3(...numbers));
      this.arrow.setDirection(normal.clone().negate());
      this.arrow.position.copy(point).addScaledVector(normal, 0.35 * this.facts.views.first.reach);
      const view = this.camera.position.clone().sub(point).normalize();
      if (first || view.dot(normal) < 0.3) {
        const { middle, reach } = this.facts.views.first;
        const rise = Math.asin(normal.z) + (normal.z > 0.5 ? -0.5 : 0.3);
        this.turning.look(middle, reach, [Math.atan2(normal.y, normal.x) + 0.5, rise]);
      }
    }
    this.draw();
  }

  prepare() {}

  annotate() {
    const now = this.facts.touches[this.index];
    this.overlay.facts.foci = now ? [{ name: `touch ${this.index + 1}`, position: now.position }] : [];
    this.overlay.draw({ shown: "", array: "hidden", largest: 1, turning: this.turning });
  }
}

class Guide {
  constructor(root, facts) {
    Object.assign(this, { root, facts, view: null, newest: {} });
    this.socket = new WebSocket(location.href.replace(/^http/, "ws").replace(/#.*/, ""));
    this.socket.onmessage = ({ data }) => this.take(JSON.parse(data));
    this.socket.onclose = () => {
      if (!this.newest.finished) this.write("The registration has ended", "The terminal states the reason.", 0);
    };
  }

  write(title, words, share) {
    this.root.querySelector("h1").textContent = title;
    element("words").textContent = words;
    this.root.querySelector("progress").value = share;
  }

  take(facts) {
    this.newest = facts;
    const { number, words, share, trouble, residuals, ignored, finished } = facts;
    if (finished) {
      const fault = ignored === null ? "" : `Touch ${ignored + 1} contradicts the others and is ignored. `;
      this.write("Done", `${fault}The terminal shows the pose of the tracker.`, 1);
    } else if (number) {
      const state = share === 1 ? "recorded; move away" : `hold for ${(1 - share).toFixed(1)} s`;
      this.write(`Touch ${number} of ${this.facts.touches.length}`, `${words}: ${trouble || state}`, share);
    }
    const rows = this.facts.touches.map((_, index) => this.row(index, facts));
    element("rows").replaceChildren(...rows);
    this.view?.point(finished ? -1 : number - 1);
  }

  row(index, { number, share, residuals = [], ignored = null, finished }) {
    const row = document.createElement("tr");
    const now = !finished && index === number - 1;
    const recorded = residuals.length || index < number - 1 || (now && share === 1);
    let state = recorded ? "recorded" : "";
    if (now && share < 1) state = residuals.length ? "repeat now" : "touch now";
    if (index === ignored) state = "ignored";
    row.className = [now && "now", (index === ignored || (now && residuals.length)) && "wrong"].filter(Boolean).join(" ");
    const residual = residuals.length ? `${(1e3 * residuals[index]).toFixed(1)} mm` : "";
    for (const text of [index + 1, state, residual]) row.insertCell().textContent = text;
    return row;
  }
}

(async function begin() {
  const facts = JSON.parse(element("viewer-facts").textContent);
  const guide = new Guide(element("touches"), facts);
  try {
    const [numbers] = await Promise.all([unpacked("viewer-numbers"), loadThree()]);
    guide.view = new Boards(element("touches"), facts, numbers);
    if (guide.newest.number) guide.take(guide.newest);
  } catch (fault) {
    const words = `The array cannot be shown here (${fault.message}); the instructions work.`;
    Object.assign(element("viewer-fault"), { hidden: false, textContent: words });
  }
})();
