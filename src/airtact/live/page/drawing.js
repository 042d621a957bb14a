// Speeds up drawing on computers without a graphics card. The page of viser runs this once, after connecting.
//
// By default viser draws at full speed for 250 ms after each update, and computes lighting for each pixel. With this
// script an update draws about one picture, and array and hand take their vertex colours from invisible points that are
// sent with them. Foci are visible through the hand. Objects that are missing are skipped.
(() => {
  const viewer = window.__viserMutable;
  const drawing = () => viewer.scene?.__r3f?.root?.getState();
  if (!drawing() || viewer.cheap) return; // it comes again when a connection that was lost is back
  viewer.cheap = true;

  const SOON = 20; // ms from an update to its picture: what follows from it is in place then
  const REST = 250; // ms from the last update to one more picture, with what took longer to load
  let soon, later;
  viewer.requestRender = () => {
    viewer.drainMessageQueue?.();
    soon ??= setTimeout(() => {
      soon = undefined;
      drawing().invalidate();
    }, SOON);
    clearTimeout(later);
    later = setTimeout(() => drawing().invalidate(), REST);
  };

  const gl = drawing().gl;
  const context = gl.getContext();
  const named = context.getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER;
  const bySoftware = /swiftshader|llvmpipe|softpipe|software|basic render/i.test(context.getParameter(named));
  for (const notice of document.querySelectorAll(".mantine-Notification-root")) {
    if (notice.textContent.startsWith("Software WebGL")) notice.querySelector("button")?.click(); // it covers the scene
  }
  const LEAST = bySoftware ? 75 : 0; // ms between two pictures
  const draw = gl.render;
  let drawn = -Infinity;
  let waiting;
  gl.render = (...given) => {
    const wait = drawn + LEAST - performance.now();
    if (wait <= 0 || given[1] !== viewer.camera) {
      drawn = performance.now();
      draw.apply(gl, given);
    } else {
      waiting ??= setTimeout(() => {
        waiting = undefined;
        drawing().invalidate();
      }, wait);
    }
  };

  const meshIn = (name) => {
    let found;
    viewer.nodeRefFromName[name]?.traverse((part) => {
      if (!found && (part.isMesh || part.isPoints) && part.geometry?.attributes.position) found = part;
    });
    return found;
  };

  let Unlit;
  const coloured = (name) => {
    const mesh = meshIn(name);
    const colours = meshIn(name + "-colours")?.geometry.attributes.color;
    if (!mesh || colours?.count !== mesh.geometry.attributes.position.count) return;
    if (mesh.geometry.attributes.color !== colours) mesh.geometry.setAttribute("color", colours);
    if (mesh.material.unlit) return;
    mesh.material = new Unlit({ vertexColors: true, toneMapped: false });
    mesh.material.unlit = true;
  };

  const throughSkin = (points) => {
    if (!points || points.material.seen) return;
    points.renderOrder = 1000; // after skin and slice, which hide nothing of them
    Object.assign(points.material, { transparent: true, depthTest: false, depthWrite: false, seen: true });
  };

  viewer.scene.onBeforeRender = () => {
    if (!Unlit) {
      viewer.scene.traverse((part) => {
        if (part.material?.type === "MeshBasicMaterial") Unlit ??= part.material.constructor;
        if (part.material && part.material === viewer.backgroundMaterial) part.visible = false; // covers all, shows nothing
      });
    }
    if (Unlit) ["/array", "/hand"].forEach(coloured);
    throughSkin(meshIn("/foci"));
  };
})();
