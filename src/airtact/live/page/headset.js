// The live page in a headset (WebXR): the scene is drawn at its real position, and tracked hands are sent to the loop.
"use strict";

const PINCHED = 0.015; // largest distance between the tips of thumb and index finger in a pinch [m]
const HELD = 2000; // time for which both hands must pinch to place the scene [ms]
const [THUMB_TIP, INDEX_TIP] = [4, 9];

class Headset {
  constructor(room, panel) {
    Object.assign(this, { room, panel, sequence: { left: 0, right: 0 }, seen: {} });
    this.button = panel.control("enter");
    this.button.addEventListener("click", () => (this.session ? this.session.end() : this.enter()));
    panel.control("place").addEventListener("click", () => (this.placed = false));
    this.offer();
  }

  async offer() {
    for (const mode of ["immersive-ar", "immersive-vr"]) {
      if (this.mode || !(await navigator.xr?.isSessionSupported(mode).catch(() => false))) continue;
      this.mode = mode;
      this.button.hidden = false;
    }
  }

  async enter() {
    const { room, panel } = this;
    const { xr } = room.renderer;
    this.session = await navigator.xr.requestSession(this.mode, { optionalFeatures: ["hand-tracking"] });
    xr.enabled = true;
    xr.setReferenceSpaceType("local");
    for (let index = 0; index < 8; index++) xr.getController(index); // without them, three.js fails at the end of the session
    Object.assign(room.camera, { near: 0.02, far: 20 });
    await xr.setSession(this.session);
    this.session.addEventListener("end", () => this.leave());
    this.placed = false;
    this.button.textContent = "Leave AR/VR";
    panel.control("place").hidden = false;
    const words = panel.facts.follows
      ? "Pinch with both hands for 2 s to place the scene between them."
      : "To make the sound follow your hands, start the loop with --from page.";
    panel.root.querySelector("header .hint").textContent = words;
    room.renderer.setAnimationLoop((time, frame) => frame && this.draw(time, frame));
  }

  leave() {
    const { room, panel } = this;
    for (const side of ["left", "right"]) this.tell(side, performance.now(), null);
    this.session = null;
    room.renderer.setAnimationLoop(null);
    room.renderer.xr.enabled = false;
    room.scene.position.set(0, 0, 0);
    room.scene.quaternion.identity();
    this.button.textContent = "Enter AR/VR";
    panel.control("place").hidden = true;
    panel.root.querySelector("header .hint").textContent = "";
    room.wanted = false;
    room.fit();
  }

  draw(time, frame) {
    const { room } = this;
    const space = room.renderer.xr.getReferenceSpace();
    const viewer = frame.getViewerPose(space);
    if (!this.placed && viewer) this.placeBefore(viewer.transform);
    const pinches = {};
    for (const side of ["left", "right"]) {
      const source = [...frame.session.inputSources].find((one) => one.hand && one.handedness === side);
      const joints = source ? this.joints(frame, source.hand, space) : null;
      this.tell(side, time, joints);
      const [thumb, index] = joints ? [joints[THUMB_TIP], joints[INDEX_TIP]] : [];
      if (thumb?.distanceTo(index) < PINCHED) pinches[side] = thumb.clone().lerp(index, 0.5);
    }
    if (!pinches.left || !pinches.right) this.pinched = time;
    else if (time - this.pinched > HELD) {
      this.placeBetween(pinches.left, pinches.right);
      this.pinched = time;
    }
    room.renderer.render(room.scene, room.camera);
    room.answer();
  }

  // The 25 joints of a hand in the reference space; null if any joint is not tracked.
  joints(frame, hand, space) {
    const poses = [...hand.values()].map((joint) => frame.getJointPose(joint, space));
    if (!poses.every((pose) => pose)) return null;
    return poses.map(({ transform: { position } }) => new THREE.Vector3(position.x, position.y, position.z));
  }

  // Send a hand in scene coordinates, as trackers do; if it is lost, say so once.
  tell(side, time, joints) {
    const { room, panel } = this;
    if (!panel.facts.follows || (!joints && !this.seen[side])) return;
    this.seen[side] = Boolean(joints);
    room.scene.updateMatrixWorld();
    const landmarks = joints?.map((joint) => room.scene.worldToLocal(joint.clone()).toArray());
    const sequence = this.sequence[side]++;
    panel.send({ frame: { time: time / 1e3, side, sequence, landmarks } });
  }

  // Place the origin of the scene 0.5 m in front of the user and 0.4 m below the eyes, with y pointing away.
  placeBefore({ position, orientation }) {
    const turn = new THREE.Quaternion(orientation.x, orientation.y, orientation.z, orientation.w);
    const right = new THREE.Vector3(1, 0, 0).applyQuaternion(turn);
    const origin = new THREE.Vector3(position.x, position.y - 0.4, position.z);
    const ahead = this.turn(right);
    this.room.scene.position.copy(origin.addScaledVector(ahead, 0.5));
    this.placed = true;
  }

  // Place the origin of the scene between two points, with x pointing from the first to the second.
  placeBetween(left, right) {
    this.turn(right.clone().sub(left));
    this.room.scene.position.copy(left.clone().lerp(right, 0.5));
  }

  // Rotate the scene so that z points up and x in a given direction; return the direction of y.
  turn(right) {
    right.setY(0).normalize();
    const up = new THREE.Vector3(0, 1, 0);
    const ahead = new THREE.Vector3().crossVectors(up, right);
    this.room.scene.quaternion.setFromRotationMatrix(new THREE.Matrix4().makeBasis(right, ahead, up));
    return ahead;
  }
}
