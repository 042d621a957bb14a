// The headset that iwer emulates (WebXR), with hands that the test sets: hands.left and hands.right are lists of 25
// positions [m] in the headset's space. The viewer stands at (0, 1.6, 0) and looks along -z.
"use strict";

const hands = (window.hands = { left: null, right: null });
const device = new IWER.XRDevice(IWER.metaQuest3);
device.installRuntime({ forceInstall: true }); // Chromium has WebXR, but no headset
device.primaryInputMode = "hand";
device.hands.right.connected = false;
for (const [side, hand] of Object.entries(device.hands)) {
  hand.position.set(0, 0, 0);
  hand.quaternion.set(0, 0, 0, 1);
  // The emulator's own hands have three poses; these have the test's joints.
  hand.updateHandPose = function () {
    if (!hands[side]) return;
    for (const [index, joint] of [...this.inputSource.hand.values()].entries()) {
      const key = Object.getOwnPropertySymbols(joint).find((symbol) => joint[symbol]?.offsetMatrix);
      joint[key].offsetMatrix.set([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, ...hands[side][index], 1]);
    }
  };
}
