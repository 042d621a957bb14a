// The common parts of all 3-D scenes, drawn with three.js: the array, bodies with the pressure on them, rigid planes,
// virtual objects, and the camera. The scene is only drawn after changes. Pressures are bytes: 255 √(p / most).
"use strict";

const FAINT = 0.1; // share of the largest pressure below which a difference fades to grey
const SHEET = 0x735c40; // colour of a rigid plane
const OBJECT = 0x2f7fb8; // colour of a virtual object
const SILENT = [150, 150, 155]; // colour of a transducer without sound
const SLOW = 60; // time between frames above which dragging draws at a lower resolution [ms]

// Colour of a pressure, or of the ratio of two pressures, from the square roots of pressure / largest.
const COLOUR = `
  uniform sampler2D pressures, differences;
  uniform int shown;
  const vec3 BODY = vec3(0.72, 0.70, 0.68);
  float decibels(float ratio) { return 20.0 * log(ratio) / log(10.0); }
  vec3 coloured(float one, float other) {
    float p = max(one * one, 1e-5), q = max(other * other, 1e-5);
    if (shown == 2) {
      float share = 0.5 + decibels(p / q) / ${(2 * DIFFERENCE).toFixed(1)};
      vec3 colour = texture(differences, vec2(clamp(share, 0.004, 0.996), 0.5)).rgb;
      return mix(vec3(0.80), colour, smoothstep(${0.5 * FAINT}, ${1.5 * FAINT}, max(p, q)));
    }
    float share = shown == 1 ? 1.0 + decibels(p) / ${LEVELS.toFixed(1)} : p;
    return texture(pressures, vec2(clamp(share, 0.004, 0.996), 0.5)).rgb;
  }`;

// Discs that fade into the background. Transparent discs would be slow.
const DISCS = {
  vertexShader: `
    attribute vec3 shade;
    varying vec3 colour;
    void main() {
      colour = shade;
      gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
    }`,
  fragmentShader: `
    uniform vec3 paper;
    uniform float strength;
    varying vec3 colour;
    void main() { gl_FragColor = vec4(mix(paper, colour, gl_FrontFacing ? strength : 0.5 * strength), 1.0); }`,
};

const SURFACE = {
  vertexShader: `
    attribute float one, other;
    varying vec3 facing;
    varying float a, b;
    #include <clipping_planes_pars_vertex>
    void main() {
      a = one;
      b = other;
      facing = normalMatrix * normal;
      vec4 mvPosition = modelViewMatrix * vec4(position, 1.0);
      gl_Position = projectionMatrix * mvPosition;
      #include <clipping_planes_vertex>
    }`,
  fragmentShader: `
    varying vec3 facing;
    varying float a, b;
    uniform bool plain;
    #include <clipping_planes_pars_fragment>
    ${COLOUR}
    void main() {
      #include <clipping_planes_fragment>
      vec3 normal = normalize(gl_FrontFacing ? facing : -facing);
      float lit = 0.5 + 0.5 * max(dot(normal, normalize(vec3(-0.35, 0.55, 0.8))), 0.0);
      float strength = plain ? 0.0 : shown > 0 ? 1.0 : smoothstep(0.0, 0.2, a * a);
      gl_FragColor = vec4((gl_FrontFacing ? lit : 0.45) * mix(BODY, coloured(a, b), strength), 1.0);
    }`,
};

// Red, green and blue of a colour such as "#ffffff".
const parts = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
const element = (id) => document.getElementById(id);

async function unpacked(id) {
  const packed = Uint8Array.from(atob(element(id).textContent.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

// A typed array in a buffer, from its kind, offset and count.
function arrayIn(buffer, [kind, offset, count], start = 0) {
  const kinds = { float32: Float32Array, uint8: Uint8Array, uint32: Uint32Array };
  return new kinds[kind](buffer, start + offset, count);
}

// Run three.js, which is embedded in the page and defines THREE.
async function loadThree() {
  const script = document.createElement("script");
  script.textContent = new TextDecoder().decode(await unpacked("three"));
  document.head.append(script);
}

class Stage {
  // limits: smallest and largest distance of the camera; antialias: whether edges are smooth.
  constructor(root, facts, numbers, limits, antialias = true) {
    Object.assign(this, { root, facts, numbers, fine: 1, last: 0, frames: 0, wanted: false });
    this.canvas = root.querySelector("canvas");
    this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias, alpha: true });
    this.renderer.setClearColor(0, 0);
    this.camera = new THREE.PerspectiveCamera(30, 1, 1, 1000);
    this.scene = new THREE.Scene();
    this.uniforms = {
      pressures: { value: this.palette("pressure") },
      differences: { value: this.palette("difference") },
      shown: { value: 0 },
      plain: { value: false },
    };
    this.build();
    this.overlay = new Overlay(root.querySelector("svg"), facts, this.camera);
    this.turning = new Turning(this.canvas, this.camera, ...limits, () => this.draw());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    new ResizeObserver(() => this.fit()).observe(this.canvas.parentElement);
  }

  control(name) {
    return this.root.querySelector(`[name=${name}]`);
  }

  array(name) {
    return arrayIn(this.numbers, this.facts.arrays[name]);
  }

  // --- pieces ------------------------------------------------------------------------------------------------------

  // Triangles whose colour is the pressure in the attributes "one" and "other".
  surfaceOf(vertices, triangles, settings = {}) {
    const mesh = new THREE.Mesh(
      this.meshOf(vertices, triangles),
      new THREE.ShaderMaterial({ uniforms: this.uniforms, side: THREE.DoubleSide, ...SURFACE, ...settings }),
    );
    mesh.geometry.computeVertexNormals();
    return mesh;
  }

  meshOf(vertices, triangles) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", this.numbersOf(vertices, 3));
    return geometry.setIndex(this.numbersOf(triangles, 1));
  }

  // A virtual object. Its front and back are translucent, so that the skin inside stays visible.
  virtualObject(vertices, triangles) {
    const glass = { transparent: true, opacity: 0.3, depthWrite: false, side: THREE.DoubleSide };
    return new THREE.Mesh(
      this.meshOf(vertices, triangles), new THREE.MeshBasicMaterial({ color: OBJECT, ...glass }));
  }

  // A rigid plane: a translucent sheet from the front, but only its edge from behind, so that it does not tint the pressure.
  sheet(corners) {
    const points = corners.map((corner) => new THREE.Vector3(...corner));
    const geometry = new THREE.BufferGeometry().setFromPoints(points).setIndex([0, 1, 2, 0, 2, 3]);
    const glass = { transparent: true, opacity: 0.3, depthWrite: false };
    const behind = { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 4 }; // elements may lie in the plane
    const sheet = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ color: SHEET, ...glass, ...behind }));
    const line = new THREE.BufferGeometry().setFromPoints(points);
    sheet.add(new THREE.LineLoop(line, new THREE.LineBasicMaterial({ color: SHEET })));
    return sheet;
  }

  numbersOf(values, size, normalised = false) {
    return new THREE.BufferAttribute(values, size, normalised);
  }

  palette(name) {
    const bytes = this.facts.colours[name].flatMap((hex) => [...parts(hex), 255]);
    const texture = new THREE.DataTexture(new Uint8Array(bytes), bytes.length / 4, 1);
    texture.minFilter = texture.magFilter = THREE.LinearFilter;
    texture.needsUpdate = true;
    return texture;
  }

  // The transducers as one mesh of discs, because software renderers draw instances slowly.
  discs(corners) {
    const [positions, normals] = [this.array("positions"), this.array("normals")];
    const count = positions.length / 3;
    const [vertices, triangles] = [new Float32Array(3 * corners * count), []];
    const [disc, corner] = [new THREE.Object3D(), new THREE.Vector3()];
    for (let index = 0; index < count; index++) {
      disc.position.fromArray(positions, 3 * index);
      disc.lookAt(corner.fromArray(normals, 3 * index).add(disc.position));
      disc.updateMatrix();
      const first = corners * index;
      for (let step = 0; step < corners; step++) {
        const angle = (2 * Math.PI * step) / corners;
        corner.set(Math.cos(angle), Math.sin(angle), 0).multiplyScalar(this.facts.radius);
        corner.applyMatrix4(disc.matrix).toArray(vertices, 3 * (first + step));
        if (step > 1) triangles.push(first, first + step - 1, first + step);
      }
    }
    const uniforms = { paper: { value: new THREE.Color() }, strength: { value: 1 } };
    const side = this.facts.backs ? THREE.DoubleSide : THREE.FrontSide; // the backs of a box would hide the bodies
    const material = new THREE.ShaderMaterial({ uniforms, side, ...DISCS });
    const discs = new THREE.Mesh(this.meshOf(vertices, new Uint32Array(triangles)), material);
    discs.geometry.setAttribute("shade", this.numbersOf(new Uint8Array(vertices.length), 3, true));
    return Object.assign(discs, { frustumCulled: false, corners });
  }

  // Colour the discs by shares from 0 to 1 of a colour scale; a negative share is grey.
  colourDiscs({ geometry, corners }, scale, shares) {
    const shades = this.facts.colours[scale].map(parts);
    const { shade } = geometry.attributes;
    let at = 0;
    for (const share of shares) {
      const [red, green, blue] = share < 0 ? SILENT : shades[Math.round(share * (shades.length - 1))];
      for (let corner = 0; corner < corners; corner++) {
        shade.array[at++] = red;
        shade.array[at++] = green;
        shade.array[at++] = blue;
      }
    }
    shade.needsUpdate = true;
  }

  // --- pictures ----------------------------------------------------------------------------------------------------

  look(name) {
    const { middle, reach, seen } = this.facts.views[name];
    this.turning.look(middle, reach, seen);
  }

  draw() {
    if (!this.wanted) requestAnimationFrame((now) => this.paint(now));
    this.wanted = true;
  }

  paint(now) {
    this.wanted = false;
    if (this.overlay.width < 100) return; // not laid out yet
    const { turning } = this;
    const since = now - this.last;
    this.last = now;
    if (turning.dragging && since > SLOW && since < 10 * SLOW) this.fine = Math.max(0.4, 0.8 * this.fine);
    const ratio = Math.min(devicePixelRatio, 2) * this.fine;
    if (ratio !== this.renderer.getPixelRatio()) this.renderer.setPixelRatio(ratio); // this recreates all buffers
    turning.place();
    this.elements.material.uniforms.paper.value.set(getComputedStyle(this.root).getPropertyValue("--paper").trim());
    this.prepare();
    this.renderer.render(this.scene, this.camera);
    this.annotate();
    this.canvas.dataset.frames = ++this.frames;
    clearTimeout(this.settling);
    if (this.fine < 1 && !turning.dragging) this.settling = setTimeout(() => this.sharpen(), 150);
  }

  sharpen() {
    this.fine = 1;
    this.draw();
  }

  fit() {
    const { width, height } = this.canvas.parentElement.getBoundingClientRect();
    if (!width || !height) return;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.overlay.resize(width, height);
    this.paint(performance.now());
  }
}

// Save a blob as a file.
function save(name, blob) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob) });
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
