/**
 * The walls of a heart that a plane cuts open, filled in the plane in the colours of their structures.
 *
 * Which pixels of the plane lie in the tissue is counted in the stencil buffer: the surface beyond the plane's pixel, its back
 * less its front faces, which is exact for a closed surface however it is bent, cut or folded into itself. What is drawn there are the
 * cells of the tissue where the plane cuts them (tissue.js); each pixel has the label that the cells around its place at rest have.
 */

import * as three from "../vendor/three/three.module.min.js";
import { PATTERNED, PLACING } from "../operating/placing.js";
import { STRIDE, Tissue } from "./tissue.js";

/** @typedef {import("../operating/heart.js").Heart} Heart */
/** @typedef {import("./plane.js").CutPlane} CutPlane */

/** Drawn after the heart (0): the stencil, the cells, and what of the tissue no cell covers. */
const ORDER = { stencil: 1, cells: 2, rest: 3, frame: 4 };

const STENCIL_VERTEX = `
${PLACING}
uniform mat4 projectionMatrix, viewMatrix;
out vec3 here;

void main() {
  vec3 normal, tangentHere;
  float stretch;
  place(here, normal, tangentHere, stretch);
  gl_Position = projectionMatrix * (viewMatrix * vec4(here, 1.0));
}
`;

const STENCIL_FRAGMENT = `
precision highp float;
in vec3 here;
uniform vec4 cutPlane;
out vec4 drawn;

void main() {
  if (dot(cutPlane.xyz, here) > cutPlane.w) discard;
  drawn = vec4(0.0);
}
`;

const CELLS_VERTEX = `
precision highp float;
in vec3 position, rest;
in float stretch;
uniform mat4 projectionMatrix, viewMatrix;
out vec3 here, restHere, toEye;
out float stretchHere;

void main() {
  vec4 seen = viewMatrix * vec4(position, 1.0);
  here = position;
  restHere = rest;
  stretchHere = stretch;
  toEye = -seen.xyz;
  gl_Position = projectionMatrix * seen;
}
`;

/* What of the tissue no cell covers: all of the plane, where the stencil says so. */
const REST_VERTEX = `
precision highp float;
in vec3 position;
uniform mat4 projectionMatrix, viewMatrix, planeMatrix;
out vec3 here, restHere, toEye;
out float stretchHere;

void main() {
  here = (planeMatrix * vec4(position, 1.0)).xyz;
  vec4 seen = viewMatrix * vec4(here, 1.0);
  restHere = vec3(0.0);
  stretchHere = 0.0;
  toEye = -seen.xyz;
  gl_Position = projectionMatrix * seen;
}
`;

/* The label that most of the eight cells around a place have, by how near they are. Places between cells have their labels at theirs. */
const LABEL_AT = `
precision highp float;
precision highp sampler2D;
precision highp sampler3D;
uniform sampler3D labels;
uniform vec3 labelsLow;

int labelAt(vec3 rest) {
  vec3 at = rest - labelsLow;
  ivec3 size = textureSize(labels, 0), first = ivec3(floor(at));
  vec3 part = at - vec3(first);
  int found[8];
  float weights[8];
  int most = 0;
  bool isOne = true;
  for (int n = 0; n < 8; n++) {
    ivec3 bits = ivec3(n & 1, (n >> 1) & 1, n >> 2), cell = first + bits;
    bool isThere = all(greaterThanEqual(cell, ivec3(0))) && all(lessThan(cell, size));
    found[n] = isThere ? int(texelFetch(labels, cell, 0).r * 255.0 + 0.5) : 0;
    vec3 near = mix(1.0 - part, part, vec3(bits));
    weights[n] = near.x * near.y * near.z;
    if (found[n] != 0) {
      if (most != 0 && found[n] != most) isOne = false;
      most = found[n];
    }
  }
  if (isOne) return most;
  float largest = 0.0;
  for (int n = 0; n < 8; n++) {
    if (found[n] == 0) continue;
    float sum = 0.0;
    for (int other = 0; other < 8; other++) if (found[other] == found[n]) sum += weights[other];
    if (sum > largest) {
      largest = sum;
      most = found[n];
    }
  }
  return most;
}
`;

/* Walls in their colours, lit from the eye; a slice of the scan may be seen through them. */
const CELLS_FRAGMENT = `
${LABEL_AT}
in vec3 here, restHere, toEye;
in float stretchHere;
uniform sampler2D palette, stretchColours, slice;
uniform mat4 sliceFromMm;
uniform float sliceShare;
uniform bool showsStretch, isRest;
uniform vec3 seenNormal;
out vec4 drawn;
${PATTERNED}
void main() {
  int label = isRest ? 256 : labelAt(restHere);
  vec4 look = texelFetch(palette, ivec2(label == 0 ? 256 : label, 0), 0);
  if (look.a < 0.5 && !isRest) discard;
  vec3 own = isRest ? vec3(0.59, 0.16, 0.18) : look.rgb;
  if (showsStretch && !isRest) own = texture(stretchColours, vec2(clamp(stretchHere, 0.0, 1.0) * 0.9961 + 0.00195, 0.5)).rgb;
  if (!isRest) own = patterned(own, round((1.0 - look.a) * 255.0 / 40.0));
  vec3 lit = own * (0.62 + 0.33 * abs(dot(normalize(toEye), seenNormal)));
  if (sliceShare > 0.0) {
    vec2 at = (sliceFromMm * vec4(here, 1.0)).xy;
    if (all(greaterThanEqual(at, vec2(0.0))) && all(lessThanEqual(at, vec2(1.0)))) lit = mix(lit, vec3(texture(slice, at).r), sliceShare);
  }
  drawn = vec4(lit, 1.0);
}
`;

/* The place itself, for whoever asks what lies under the pointer. */
const CELLS_PLACE_FRAGMENT = `
${LABEL_AT}
in vec3 here, restHere;
uniform sampler2D palette;
uniform bool isRest;
out vec4 drawn;

void main() {
  int label = isRest ? 256 : labelAt(restHere);
  if (!isRest && texelFetch(palette, ivec2(label == 0 ? 256 : label, 0), 0).a < 0.5) discard;
  drawn = vec4(here, 1.0 + float(label));
}
`;

/** @param {Record<string, any>} more */
function material(more) {
  return new three.RawShaderMaterial({ glslVersion: three.GLSL3, side: three.DoubleSide, ...more });
}

/**
 * Walls that a plane cuts open. The heart's own `cutPlane` is set here too: what lies beyond the plane is not drawn.
 *
 * The renderer needs a stencil buffer (`stencil: true` where the context is made). Make one with the picture's scene, its heart and a
 * plane; call `beforeDraw()` before each picture, and `plane.listen(redraw)`. The heart's topology must have `cells`, `cell_corners` and
 * `cell_label` (`topology_message(..., cell_labels=...)`); without them the heart is cut open and the walls stay hollow.
 */
export class Caps {
  /** Cells of the topology that is shown. @type {Tissue | null} */
  tissue = null;
  #mesh = /** @type {any} */ (null);
  #drawn = "";
  #stencil;
  #cells;
  #rest;
  #frame;
  #buffer = /** @type {any} */ (null);
  #capUniforms;

  /** @param {any} scene @param {Heart} heart @param {CutPlane} plane */
  constructor(scene, heart, plane) {
    this.heart = heart;
    this.plane = plane;
    const { uniforms } = heart;
    // of the level of detail that is shown
    const ofShown = { ...uniforms, nodeNormals: { value: null } };
    const empty = new three.Data3DTexture(new Uint8Array(1), 1, 1, 1);
    this.#capUniforms = {
      labels: { value: empty },
      labelsLow: { value: new three.Vector3() },
      palette: uniforms.palette,
      stretchColours: uniforms.stretchColours,
      showsStretch: uniforms.showsStretch,
      seenNormal: { value: new three.Vector3() },
      slice: { value: uniforms.palette.value },
      sliceFromMm: { value: new three.Matrix4() },
      sliceShare: { value: 0 },
    };
    this.#stencil = new three.Mesh(new three.BufferGeometry(), material({
      vertexShader: STENCIL_VERTEX, fragmentShader: STENCIL_FRAGMENT, uniforms: ofShown,
      colorWrite: false, depthWrite: false, depthTest: false,
      stencilWrite: true, stencilFunc: three.AlwaysStencilFunc, stencilZPass: three.IncrementWrapStencilOp,
    }));
    this.#stencil.renderOrder = ORDER.stencil;
    // both sides in one pass: three.js knows one operation for both, which stays what it thinks is set
    const { KeepStencilOp: keeps, IncrementWrapStencilOp: more } = three;
    this.#stencil.onBeforeRender = (/** @type {any} */ renderer) => {
      const gl = renderer.getContext();
      renderer.state.buffers.stencil.setOp(keeps, keeps, more);
      gl.stencilOpSeparate(gl.FRONT, gl.KEEP, gl.KEEP, gl.DECR_WRAP);
    };
    this.#stencil.onAfterRender = (/** @type {any} */ renderer) => {
      const gl = renderer.getContext();
      gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR_WRAP);
    };
    this.#cells = this.#cap(new three.BufferGeometry(), false, ORDER.cells);
    this.#rest = this.#cap(new three.PlaneGeometry(2, 2), true, ORDER.rest);
    this.#rest.geometry.deleteAttribute("normal");
    const corners = new Float32Array([-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0]);
    const outline = new three.BufferGeometry();
    outline.setAttribute("position", new three.BufferAttribute(corners, 3));
    outline.setIndex([0, 1, 1, 2, 2, 3, 3, 0]);
    this.#frame = new three.LineSegments(outline, new three.LineBasicMaterial({ color: 0x4aa3ff }));
    this.#frame.renderOrder = ORDER.frame;
    this.#frame.matrixAutoUpdate = false;
    for (const one of this.all) {
      one.frustumCulled = false;
      one.visible = false;
      scene.add(one);
    }
  }

  /** What is drawn of the plane. */
  get all() {
    return [this.#stencil, this.#cells, this.#rest, this.#frame];
  }

  /** @param {any} geometry @param {boolean} isRest @param {number} order */
  #cap(geometry, isRest, order) {
    const uniforms = { ...this.#capUniforms, isRest: { value: isRest } };
    const vertexShader = isRest ? REST_VERTEX : CELLS_VERTEX;
    if (isRest) Object.assign(uniforms, { planeMatrix: { value: new three.Matrix4() } });
    const inTissue = {
      stencilWrite: true, stencilRef: 0, stencilFunc: three.NotEqualStencilFunc,
      stencilFail: three.ZeroStencilOp, stencilZFail: three.ZeroStencilOp, stencilZPass: three.ZeroStencilOp,
    };
    const mesh = new three.Mesh(geometry, material({ vertexShader, fragmentShader: CELLS_FRAGMENT, uniforms, ...inTissue }));
    mesh.userData.place = material({ vertexShader, fragmentShader: CELLS_PLACE_FRAGMENT, uniforms, ...inTissue });
    mesh.renderOrder = order;
    return mesh;
  }

  /**
   * Show the walls half through, with a slice of the scan in the plane.
   * @param {any} texture its greys; null for none
   * @param {any} fromMm matrix from LPS mm to the texture, 0 to 1
   * @param {number} share of the slice, 0 to 1
   */
  showSlice(texture, fromMm, share) {
    const uniforms = this.#capUniforms;
    uniforms.sliceShare.value = texture === null ? 0 : share;
    if (texture === null) return;
    uniforms.slice.value = texture;
    uniforms.sliceFromMm.value.copy(fromMm);
  }

  /**
   * Draw where the walls are in the plane, LPS mm as red, green and blue, one more than their label as alpha, for whoever asks what lies under the pointer: into
   * the renderer's target, which has a depth and a stencil buffer, and the heart's own places in it already. `beforeDraw()` was called.
   * @param {any} renderer @param {any} scene @param {any} eye
   */
  drawPlaces(renderer, scene, eye) {
    if (!this.#cells.visible) return;
    const mine = new Set(this.all);
    const others = scene.children.filter((/** @type {any} */ one) => one.visible && (!mine.has(one) || one === this.#frame));
    const caps = [this.#cells, this.#rest];
    const materials = caps.map((one) => one.material);
    for (const one of others) one.visible = false;
    for (const one of caps) one.material = one.userData.place;
    renderer.render(scene, eye);
    caps.forEach((one, n) => (one.material = materials[n]));
    for (const one of others) one.visible = true;
  }

  /** Bring the walls to where plane and heart are now. */
  beforeDraw() {
    const { heart, plane } = this;
    heart.uniforms.cutPlane.value.set(...plane.equation);
    const isOn = plane.isOn && heart.mesh !== null && heart.nodes !== null;
    if (isOn) this.#takeHeart();
    for (const one of this.all) one.visible = isOn && (one === this.#frame || this.tissue !== null);
    if (!isOn || heart.nodes === null) return;
    this.#placeFrame();
    if (this.tissue === null) return;
    this.#rest.visible = !this.#hidesTissue();
    const now = `${plane.equation} ${heart.uniforms.displacements.value.version} ${heart.topology}`;
    if (now === this.#drawn) return;
    this.#drawn = now;
    this.tissue.cut(heart.nodes.displacement, plane.equation);
    this.#upload(this.tissue);
  }

  /** Take the heart's surface, and its cells where they are others. */
  #takeHeart() {
    const { heart } = this;
    this.#stencil.geometry = heart.shown.geometry;
    this.#stencil.material.uniforms.nodeNormals.value = heart.shown.material.uniforms.nodeNormals.value;
    if (heart.mesh === this.#mesh) return;
    this.#mesh = heart.mesh;
    this.#drawn = "";
    const { cells, cell_corners: corners, cell_label: labels } = heart.arrays;
    this.tissue = cells === undefined || heart.place === null || heart.nodes === null ? null
      : new Tissue(cells, corners, labels, heart.nodes.count, heart.place);
    if (this.tissue === null) return;
    this.#capUniforms.labels.value.dispose();
    const texture = new three.Data3DTexture(this.tissue.labels, ...this.tissue.size);
    Object.assign(texture, { format: three.RedFormat, type: three.UnsignedByteType, unpackAlignment: 1, needsUpdate: true });
    this.#capUniforms.labels.value = texture;
    this.#capUniforms.labelsLow.value.set(...this.tissue.low);
  }

  /** Whether a structure of the tissue is hidden: then what no cell covers belongs to none, and is left out. */
  #hidesTissue() {
    const colours = this.heart.uniforms.palette.value.image.data;
    return this.tissue !== null && this.tissue.there.some((label) => colours[4 * label + 3] === 0);
  }

  /** @param {Tissue} tissue */
  #upload(tissue) {
    if (this.#buffer === null || this.#buffer.array !== tissue.corners) {
      this.#cells.geometry.dispose();
      const geometry = this.#cells.geometry = new three.BufferGeometry();
      this.#buffer = new three.InterleavedBuffer(tissue.corners, STRIDE);
      this.#buffer.setUsage(three.DynamicDrawUsage);
      for (const [name, size, at] of [["position", 3, 0], ["rest", 3, 3], ["stretch", 1, 6]]) {
        geometry.setAttribute(name, new three.InterleavedBufferAttribute(this.#buffer, size, at));
      }
    }
    this.#buffer.clearUpdateRanges();
    this.#buffer.addUpdateRange(0, STRIDE * tissue.count);
    this.#buffer.needsUpdate = true;
    this.#cells.geometry.setDrawRange(0, tissue.count);
  }

  #placeFrame() {
    const { normal, point, reach, axes: [right, up] } = this.plane;
    const matrix = this.#frame.matrix;
    const columns = [right, up, normal].map((axis) => axis.map((part) => reach * part));
    matrix.set(
      columns[0][0], columns[1][0], columns[2][0], point[0], columns[0][1], columns[1][1], columns[2][1], point[1],
      columns[0][2], columns[1][2], columns[2][2], point[2], 0, 0, 0, 1,
    );
    this.#frame.matrixWorldNeedsUpdate = true;
    this.#rest.material.uniforms.planeMatrix.value.copy(matrix);
    this.#capUniforms.seenNormal.value.set(...normal);
  }
}
