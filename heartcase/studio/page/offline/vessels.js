/** Vessels on the heart that have a surface of their own, such as coronary arteries; they go with the tissue. */

import * as three from "../vendor/three/three.module.min.js";
import { arraysOf } from "../operating/messages.js";
import { followingOf } from "./following.js";

/** @typedef {import("../shared/connection.js").Package} Package */
/** @typedef {import("../operating/heart.js").Structure} Structure */

const VERTEX = `
precision highp float;
in vec3 position, normal;
uniform mat4 projectionMatrix, viewMatrix;
out vec3 seenNormal, toEye, here;
void main() {
  vec4 seen = viewMatrix * vec4(position, 1.0);
  here = position;
  seenNormal = mat3(viewMatrix) * normal;
  toEye = -seen.xyz;
  gl_Position = projectionMatrix * seen;
}
`;
const FRAGMENT = `
precision highp float;
in vec3 seenNormal, toEye, here;
uniform vec4 cutPlane;
uniform vec3 own;
out vec4 drawn;
void main() {
  if (dot(cutPlane.xyz, here) > cutPlane.w) discard;
  vec3 eye = normalize(toEye);
  vec3 normal = normalize(seenNormal);
  if (!gl_FrontFacing) normal = -normal;
  vec3 light = normalize(eye + vec3(0.15, 0.45, 0.0));
  float bright = 0.24 + 0.12 * normal.y + 0.72 * max(dot(normal, light), 0.0);
  drawn = vec4(own * bright * (gl_FrontFacing ? 1.0 : 0.7), 1.0);
}
`;

export class Vessels {
  /** Mesh of each structure. @type {Map<number, any>} */
  #meshes = new Map();
  #group = new three.Group();
  /** @type {{following: import("./following.js").Following, geometry: any, normals: Float32Array}[]} */
  #moving = [];

  /** @param {any} scene @param {any} cutPlane uniform that the heart has too @param {readonly Package[]} messages */
  constructor(scene, cutPlane, messages) {
    for (const message of messages) {
      const arrays = arraysOf(message);
      const geometry = new three.BufferGeometry();
      const following = followingOf(arrays);
      geometry.setAttribute("position", new three.BufferAttribute(following.places, 3));
      geometry.setAttribute("normal", new three.BufferAttribute(new Float32Array(arrays.normals), 3));
      this.#moving.push({ following, geometry, normals: arrays.normals });
      geometry.setIndex(new three.BufferAttribute(arrays.triangles, 1));
      const material = new three.RawShaderMaterial({
        glslVersion: three.GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT, side: three.DoubleSide,
        uniforms: { cutPlane, own: { value: new three.Vector3(1, 1, 1) } },
      });
      const mesh = new three.Mesh(geometry, material);
      mesh.frustumCulled = false;
      this.#meshes.set(message.header.structure, mesh);
      this.#group.add(mesh);
    }
    scene.add(this.#group);
  }

  /**
   * Bring them to where the tissue is.
   * @param {Float32Array} displacement @param {Uint32Array} corners @param {import("./following.js").Place} place
   * @param {boolean} isAtRest
   */
  follow(displacement, corners, place, isAtRest) {
    for (const { following, geometry, normals } of this.#moving) {
      following.follow(displacement, corners, place);
      const { position, normal } = geometry.attributes;
      position.needsUpdate = normal.needsUpdate = true;
      if (isAtRest) normal.array.set(normals);
      else geometry.computeVertexNormals();
    }
  }

  /** @param {readonly Structure[]} structures @param {ReadonlySet<number>} hidden @param {number | null} lit */
  paint(structures, hidden, lit) {
    for (const { value, colour } of structures) {
      const mesh = this.#meshes.get(value);
      if (mesh === undefined) continue;
      mesh.visible = !hidden.has(value);
      const rgb = Number.parseInt(colour.slice(1), 16);
      mesh.material.uniforms.own.value.set((rgb >> 16) / 255, ((rgb >> 8) & 255) / 255, (rgb & 255) / 255);
      mesh.renderOrder = value === lit ? 1 : 0;
    }
  }
}
