/** Slices of the scan in the picture: greys where they lie in the patient. */

import * as three from "../vendor/three/three.module.min.js";

/** @typedef {import("./caps.js").Caps} Caps */
/** @typedef {{name: string, origin_mm: number[], right: number[], down: number[], width_mm: number, height_mm: number}} SliceHeader */

/** How much of a wall's colour a slice in the cut plane leaves. */
const SHARE = 0.6;
/** What lies so far beyond the cut plane at most counts as in it, mm. */
const IN_PLANE_MM = 0.05;

const VERTEX = `
precision highp float;
in vec3 position;
uniform mat4 projectionMatrix, viewMatrix, place;
out vec2 at;
out vec3 here;

void main() {
  at = position.xy;
  here = (place * vec4(position, 1.0)).xyz;
  gl_Position = projectionMatrix * (viewMatrix * vec4(here, 1.0));
}
`;

const FRAGMENT = `
precision highp float;
precision highp sampler2D;
in vec2 at;
in vec3 here;
uniform sampler2D greys;
uniform vec4 cutPlane;
out vec4 drawn;

void main() {
  vec2 found = texture(greys, at).rg;
  if (found.g < 0.5 || dot(cutPlane.xyz, here) > cutPlane.w + ${IN_PLANE_MM}) discard;
  drawn = vec4(vec3(found.r), 1.0);
}
`;

export class Slices {
  /** @type {Map<string, any>} */
  #shown = new Map();
  #square = new three.BufferGeometry();

  /** @param {any} scene @param {Caps} caps */
  constructor(scene, caps) {
    this.scene = scene;
    this.caps = caps;
    this.#square.setAttribute("position", new three.BufferAttribute(new Float32Array([0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0]), 3));
    this.#square.setIndex([0, 1, 2, 0, 2, 3]);
  }

  /** Names of the slices that are shown. */
  get names() {
    return [...this.#shown.keys()];
  }

  /** Corners of a slice, LPS mm: of its first pixel, to the right, and down. @param {string} name @returns {number[][] | null} */
  corners(name) {
    const place = this.#shown.get(name)?.material.uniforms.place.value;
    if (place === undefined) return null;
    return [[0, 0, 0], [1, 0, 0], [0, 1, 0]].map((one) => new three.Vector3(...one).applyMatrix4(place).toArray());
  }

  /** @param {SliceHeader} header @param {Uint8Array} greys grey and opacity of each pixel @param {readonly number[]} shape rows, columns */
  show(header, greys, [rows, columns]) {
    const texture = new three.DataTexture(greys, columns, rows, three.RGFormat, three.UnsignedByteType);
    Object.assign(texture, { unpackAlignment: 1, minFilter: three.LinearFilter, magFilter: three.LinearFilter, needsUpdate: true });
    let mesh = this.#shown.get(header.name);
    if (mesh === undefined) {
      mesh = new three.Mesh(this.#square, new three.RawShaderMaterial({
        glslVersion: three.GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT, side: three.DoubleSide,
        // walls that are cut in the same plane lie before it
        polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1,
        uniforms: { greys: { value: null }, place: { value: new three.Matrix4() }, cutPlane: this.caps.heart.uniforms.cutPlane },
      }));
      mesh.frustumCulled = false;
      // after the heart, and after the stencil has said where its walls are
      mesh.renderOrder = 5;
      this.#shown.set(header.name, mesh);
      this.scene.add(mesh);
    }
    const { uniforms } = mesh.material;
    uniforms.greys.value?.dispose();
    uniforms.greys.value = texture;
    const { origin_mm: o, right, down, width_mm: width, height_mm: height } = header;
    const [r, d] = [right.map((one) => width * one), down.map((one) => height * one)];
    const n = [right[1] * down[2] - right[2] * down[1], right[2] * down[0] - right[0] * down[2], right[0] * down[1] - right[1] * down[0]];
    uniforms.place.value.set(r[0], d[0], n[0], o[0], r[1], d[1], n[1], o[1], r[2], d[2], n[2], o[2], 0, 0, 0, 1);
    if (header.name === "cut") this.caps.showSlice(texture, uniforms.place.value.clone().invert(), SHARE);
  }

  /** @param {string} name */
  hide(name) {
    const mesh = this.#shown.get(name);
    if (mesh === undefined) return;
    this.#shown.delete(name);
    if (name === "cut") this.caps.showSlice(null, null, 0);
    mesh.removeFromParent();
    mesh.material.uniforms.greys.value.dispose();
    mesh.material.dispose();
  }
}
