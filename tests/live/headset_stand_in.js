// The parts of a headset that the page uses (WebXR), with hands that the test sets: hands.left and hands.right are
// lists of 25 positions [m] in the headset's space, or null if not tracked. The viewer stands at (0, 1.6, 0) and looks along -z.
"use strict";

const hands = (window.hands = { left: null, right: null });
const matrix = (x, y, z) => new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1]);
const placed = (x, y, z) => ({ position: { x, y, z }, orientation: { x: 0, y: 0, z: 0, w: 1 }, matrix: matrix(x, y, z) });
const viewer = placed(0, 1.6, 0);
const projection = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1.002, -1, 0, 0, -0.04, 0]);

class StandInLayer {
  constructor() {
    Object.assign(this, { framebuffer: null, framebufferWidth: 300, framebufferHeight: 200, antialias: false });
  }
  getViewport() {
    return { x: 0, y: 0, width: 300, height: 200 };
  }
}

class StandInSession extends EventTarget {
  constructor() {
    super();
    Object.assign(this, { renderState: {}, environmentBlendMode: "opaque", visibilityState: "visible" });
    this.inputSources = ["left", "right"].map((handedness) => {
      const joints = [...Array(25).keys()].map((index) => [String(index), { handedness, index }]);
      return { handedness, hand: new Map(joints), targetRayMode: "tracked-pointer", profiles: [] };
    });
  }
  updateRenderState(changed) {
    Object.assign(this.renderState, changed);
  }
  async requestReferenceSpace() {
    return new EventTarget();
  }
  requestAnimationFrame(callback) {
    return setTimeout(() => callback(performance.now(), this.frame()), 16);
  }
  cancelAnimationFrame(number) {
    clearTimeout(number);
  }
  frame() {
    return {
      session: this,
      getViewerPose: () => ({ transform: viewer, views: [{ eye: "none", transform: viewer, projectionMatrix: projection }] }),
      getJointPose: ({ handedness, index }) => hands[handedness] && { transform: placed(...hands[handedness][index]), radius: 0.01 },
      getPose: () => null,
    };
  }
  async end() {
    this.dispatchEvent(Object.assign(new Event("end"), { session: this }));
  }
}

window.XRWebGLLayer = StandInLayer;
WebGL2RenderingContext.prototype.makeXRCompatible = async () => {};
Object.defineProperty(navigator, "xr", {
  value: {
    isSessionSupported: async (mode) => mode === "immersive-vr",
    requestSession: async () => new StandInSession(),
    addEventListener: () => {},
  },
});
