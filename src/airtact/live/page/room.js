// The 3-D scene of the live page: array, hands, virtual objects, foci, contacts, and a slice of the field. Lengths are in metres.
"use strict";

const MOST_BALLS = 256; // largest number of foci, and of contacts, that are drawn

// A slice. Low pressures are transparent, so that objects behind it stay visible.
const FIELD = {
  vertexShader: `
    varying vec2 at;
    void main() {
      at = vec2(uv.x, 1.0 - uv.y); // the first row is at the top
      gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
    }`,
  fragmentShader: `
    uniform sampler2D field;
    varying vec2 at;
    ${COLOUR}
    void main() {
      float here = texture(field, at).r;
      gl_FragColor = vec4(coloured(here, here), clamp(0.1 + 3.0 * here * here, 0.0, 0.95));
    }`,
};

// Whether the scene is drawn in software; smooth edges would then almost double the time.
function bySoftware() {
  const context = document.createElement("canvas").getContext("webgl2");
  const named = context?.getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL;
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(context?.getParameter(named ?? context.RENDERER));
}

class Room extends Stage {
  constructor(root, facts, numbers) {
    super(root, facts, numbers, [0.03, 20 * facts.views.first.reach], !bySoftware());
    Object.assign(this, { kept: new Map(), hand: null, send: () => {}, undrawn: 0 });
    for (const name of ["array", "surfaces", "slice"]) {
      this.control(name).addEventListener("input", () => this.show());
    }
    // Before Turning, which turns the view.
    this.canvas.addEventListener("pointerdown", (event) => this.grab(event), { capture: true });
    this.canvas.addEventListener("pointermove", (event) => this.pull(event), { capture: true });
    for (const end of ["pointerup", "pointercancel"]) this.canvas.addEventListener(end, () => (this.grabbed = null));
    this.fit();
    this.look("first");
  }

  build() {
    this.elements = this.discs(6); // more corners would slow down a software renderer
    this.uniforms.field = { value: null };
    this.slice = new THREE.Mesh(
      new THREE.PlaneGeometry(this.facts.slice, this.facts.slice),
      new THREE.ShaderMaterial(
        { uniforms: this.uniforms, side: THREE.DoubleSide, transparent: true, depthWrite: false, ...FIELD }),
    );
    this.slice.visible = false;
    this.foci = this.balls(2e-3, 0xe8590c);
    this.contacts = this.balls(1.2e-3, 0x1864ab);
    this.skins = new Map();
    this.objects = new Map();
    const sheets = this.facts.sheets.map((corners) => this.sheet(corners));
    this.scene.add(this.elements, this.slice, this.foci, this.contacts, ...sheets);
  }

  // Balls that stay visible behind other objects.
  balls(radius, color) {
    const material = new THREE.MeshBasicMaterial({ color, depthTest: false, transparent: true });
    const balls = new THREE.InstancedMesh(new THREE.SphereGeometry(radius, 10, 8), material, MOST_BALLS);
    Object.assign(balls, { count: 0, frustumCulled: false, renderOrder: 1 });
    return balls;
  }

  placeBalls(balls, points) {
    balls.count = Math.min(points.length, MOST_BALLS);
    const at = new THREE.Matrix4();
    for (let index = 0; index < balls.count; index++) {
      balls.setMatrixAt(index, at.makeTranslation(...points[index]));
    }
    balls.instanceMatrix.needsUpdate = true;
  }

  // Show a picture, given its facts and a function that returns its arrays by name.
  take(facts, array) {
    for (const key of this.kept.keys()) if (!facts.keys.includes(key)) this.kept.delete(key);
    for (const key of facts.keys.filter((one) => !this.kept.has(one))) {
      const names = Object.keys(facts.arrays).filter((name) => name.startsWith(`${key} `));
      this.kept.set(key, Object.fromEntries(names.map((name) => [name.slice(key.length + 1), array(name)])));
    }
    this.newest = facts;
    this.phases = Array.from(array("phase"), (byte) => (byte === 255 ? -1 : byte / 254));
    this.amplitudes = Array.from(array("amplitude"), (byte) => byte / 255);
    this.placeBalls(this.foci, facts.foci.map((focus) => focus.position).filter((point) => point));
    this.placeBalls(this.contacts, facts.contacts);
    this.update(this.skins, facts.skins, ({ key }) => this.skin(key));
    this.update(this.objects, facts.objects, ({ key }) => {
      const { vertices, triangles } = this.kept.get(key);
      return this.virtualObject(vertices, triangles);
    });
    for (const { name } of facts.skins) {
      const { geometry } = this.skins.get(name);
      geometry.setAttribute("position", this.numbersOf(array(name).slice(), 3));
      geometry.computeVertexNormals();
      geometry.boundingSphere = null;
    }
    for (const object of facts.objects) {
      if (this.grabbed?.name !== object.name) this.pose(this.objects.get(object.name), object);
    }
    if (!this.grabbed) this.hand = facts.hand;
    if (facts.sound) this.takeSound(facts.sound);
    this.undrawn += 1;
    this.show();
  }

  // Match the drawn objects to a list: create an object if it is missing or has another key.
  update(drawn, wanted, make) {
    for (const [name, mesh] of drawn) {
      if (wanted.some((one) => one.name === name && one.key === mesh.key)) continue;
      this.scene.remove(mesh);
      mesh.geometry.dispose();
      drawn.delete(name);
    }
    for (const one of wanted) {
      if (drawn.has(one.name)) continue;
      const mesh = Object.assign(make(one), { name: one.name, key: one.key });
      drawn.set(one.name, mesh);
      this.scene.add(mesh);
    }
  }

  skin(key) {
    const { triangles } = this.kept.get(key);
    const count = triangles.reduce((most, vertex) => Math.max(most, vertex), 0) + 1;
    const mesh = this.surfaceOf(new Float32Array(3 * count), triangles);
    this.colourSkin(mesh, new Uint8Array(count));
    this.sound = null; // the newest pressure does not belong to this mesh
    return mesh;
  }

  colourSkin({ geometry }, pressures) {
    for (const name of ["one", "other"]) geometry.setAttribute(name, this.numbersOf(pressures, 1, true));
  }

  takeSound({ key, most, middle, axes }) {
    this.slice.position.set(...middle);
    const [right, up, normal] = axes.map((axis) => new THREE.Vector3(...axis));
    this.slice.quaternion.setFromRotationMatrix(new THREE.Matrix4().makeBasis(right, up, normal));
    if (this.sound === key) return;
    this.sound = key;
    this.overlay.facts.most = most;
    const { skin, field } = this.kept.get(key);
    this.colourSkin(this.skins.get("hand"), skin);
    const side = Math.sqrt(field.length);
    const texture = new THREE.DataTexture(field, side, side, THREE.RedFormat);
    texture.minFilter = texture.magFilter = THREE.LinearFilter;
    texture.unpackAlignment = 1;
    texture.needsUpdate = true;
    this.uniforms.field.value?.dispose();
    this.uniforms.field.value = texture;
  }

  pose(mesh, { position, turn }) {
    mesh.position.set(...position);
    mesh.quaternion.set(...turn);
  }

  show() {
    if (!this.newest) return;
    const shown = this.control("array").value;
    const heard = Boolean(this.newest.sound);
    this.elements.visible = shown !== "hidden";
    this.colourDiscs(this.elements, shown === "amplitude" ? shown : "phase", shown === "amplitude" ? this.amplitudes : this.phases);
    this.uniforms.plain.value = !heard || !this.control("surfaces").checked;
    this.slice.visible = heard && this.control("slice").checked;
    this.draw();
  }

  // In a headset, the session requests pictures.
  draw() {
    if (!this.renderer.xr.isPresenting) super.draw();
  }

  prepare() {}

  annotate() {
    const { newest, turning, overlay } = this;
    if (!newest) return;
    const words = ({ name, pressure }) => (pressure === null ? name : `${name}  ${grouped(pressure)} Pa`);
    const foci = newest.foci.filter((focus) => focus.position);
    overlay.facts.foci = foci.map((focus) => ({ name: words(focus), position: focus.position }));
    // Labels point away from the centre of the foci.
    const mean = (axis) => foci.reduce((sum, { position }) => sum + position[axis] / foci.length, 0);
    overlay.facts.views.foci.middle = [0, 1, 2].map(mean);
    const heard = newest.sound && (this.slice.visible || !this.uniforms.plain.value);
    overlay.draw({ shown: heard ? "pressure" : "", array: this.control("array").value, largest: 1, turning });
    this.answer();
  }

  // Request one new picture for each that was drawn.
  answer() {
    for (; this.undrawn > 0; this.undrawn--) this.send({ drawn: true });
  }

  // --- dragging ----------------------------------------------------------------------------------------------------

  pointed(event) {
    const box = this.canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    const ray = new THREE.Raycaster();
    ray.setFromCamera({ x: (2 * x) / box.width - 1, y: 1 - (2 * y) / box.height }, this.camera);
    return ray;
  }

  // Grab the hand or object under the pointer, if any.
  grab(event) {
    const hand = this.facts.dragged ? [this.skins.get("hand")] : [];
    const things = [...hand, ...this.objects.values()].filter((thing) => thing);
    const [hit] = this.pointed(event).intersectObjects(things, false);
    if (!hit || event.shiftKey || event.button) return;
    event.stopImmediatePropagation();
    this.canvas.setPointerCapture(event.pointerId);
    const isHand = hit.object === this.skins.get("hand");
    const from = isHand
      ? { position: new THREE.Vector3(...this.hand.position), turn: new THREE.Quaternion(...this.hand.turn) }
      : { position: hit.object.position.clone(), turn: hit.object.quaternion.clone() };
    const plane = new THREE.Plane().setFromNormalAndCoplanarPoint(
      this.camera.getWorldDirection(new THREE.Vector3()), hit.point);
    const start = { point: hit.point, x: event.clientX, y: event.clientY };
    this.grabbed = { ...from, name: isHand ? null : hit.object.name, isHand, plane, start };
  }

  pull(event) {
    if (!this.grabbed) return;
    event.stopImmediatePropagation();
    const { plane, start, name, isHand } = this.grabbed;
    const [position, turn] = [this.grabbed.position.clone(), this.grabbed.turn.clone()];
    if (this.control("drag").value === "turn") {
      const axis = (column) => new THREE.Vector3().setFromMatrixColumn(this.camera.matrixWorld, column);
      const about = (column, angle) => new THREE.Quaternion().setFromAxisAngle(axis(column), angle);
      turn.premultiply(about(1, 0.008 * (event.clientX - start.x)));
      turn.premultiply(about(0, 0.008 * (event.clientY - start.y)));
    } else {
      const point = this.pointed(event).ray.intersectPlane(plane, new THREE.Vector3());
      if (point) position.add(point).sub(start.point);
    }
    const moved = { position: position.toArray(), turn: turn.toArray() };
    if (isHand) {
      this.hand = moved;
      this.send({ hand: moved });
    } else {
      this.pose(this.objects.get(name), moved);
      const pose = { translation: moved.position, quaternion: moved.turn };
      this.send({ object: { type: "objects", version: 1, move: [{ name, pose }] } });
    }
    this.draw();
  }
}
