/** Draws the structures as solids: the first voxel of one that each line of sight meets, lit from the viewer's side. */

import { linked } from "./slice_shader.js";

/** @typedef {import("../../shared/geometry.js").Camera} Camera */
/** @typedef {import("../../shared/geometry.js").Lattice} Lattice */
/** @typedef {import("../../shared/geometry.js").Vector} Vector */
/** @typedef {import("./volume.js").Volume} Volume */

const VERTEX = `#version 300 es
void main() {
  // one triangle that covers the view
  vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(corner, 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
precision highp usampler3D;
uniform usampler3D labels;
uniform usampler3D blocks;          // 1 where any of 8 x 8 x 8 voxels is of a structure that is shown
uniform sampler2D colours;          // second row: those of solids
uniform vec3 origin, across, along; // index at the upper left corner, and per pixel
uniform vec3 look;                  // index per mm away from the viewer
uniform vec3 size;
uniform float height;               // of the picture, pixels
uniform mat3 toPatient;             // turns a gradient over indices into one over mm
uniform vec3 light;                 // where it comes from, in the patient
out vec4 colour;

float least(vec3 v) { return min(v.x, min(v.y, v.z)); }
float most(vec3 v) { return max(v.x, max(v.y, v.z)); }

vec4 paintAt(ivec3 voxel) {
  if (any(lessThan(voxel, ivec3(0))) || any(greaterThanEqual(voxel, ivec3(size)))) return vec4(0.0);
  return texelFetch(colours, ivec2(int(texelFetch(labels, voxel, 0).r), 1), 0);
}

void main() {
  vec3 from = origin + gl_FragCoord.x * across + (height - gl_FragCoord.y) * along;
  vec3 slope = 1.0 / mix(look, vec3(1e-7), lessThan(abs(look), vec3(1e-7)));
  vec3 first = (-0.5 - from) * slope, last = (size - 0.5 - from) * slope;
  float far = least(max(first, last));
  float way = most(min(first, last)) + 1e-3;
  colour = vec4(0.0, 0.0, 0.0, 1.0);
  for (int n = 0; n < 4000 && way < far; n++) {
    ivec3 voxel = clamp(ivec3(floor(from + way * look + 0.5)), ivec3(0), ivec3(size) - 1);
    ivec3 block = voxel >> 3;
    bool isEmpty = texelFetch(blocks, block, 0).r == 0u;
    vec4 paint = isEmpty ? vec4(0.0) : paintAt(voxel);
    if (paint.a > 0.0) {
      vec3 slope = vec3(0.0);
      for (int k = -2; k <= 2; k++) for (int j = -2; j <= 2; j++) for (int i = -2; i <= 2; i++) {
        ivec3 step = ivec3(i, j, k);
        if (paintAt(voxel + step).a > 0.0) slope -= vec3(step) / (1.0 + float(i * i + j * j + k * k));
      }
      vec3 outward = toPatient * slope;
      float lit = length(outward) > 1e-6 ? max(dot(normalize(outward), light), 0.0) : 0.5;
      colour = vec4(paint.rgb * (0.25 + 0.75 * lit), 1.0);
      return;
    }
    vec3 low = isEmpty ? vec3(block << 3) : vec3(voxel);
    vec3 leaving = max((low - 0.5 - from) * slope, (low - 0.5 + (isEmpty ? 8.0 : 1.0) - from) * slope);
    way = max(least(leaving), way) + 1e-3;
  }
}`;

/** Time of a strip of a picture: other pictures wait for it. */
const STRIP_MS = 10;
const FEWEST_ROWS = 8;
const FIRST_ROWS = 64;
const WAIT_MS = 4;

export class SolidShader {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.program = linked(gl, VERTEX, FRAGMENT);
    this.array = gl.createVertexArray();
    this.frame = gl.createFramebuffer();
    this.picture = gl.createTexture();
    this.width = this.height = 0;
    /** A picture is not done yet: the next one waits for it. */
    this.isBusy = false;
    /** Rows of a strip that take about as long as they may. */
    this.rows = FIRST_ROWS;
  }

  /**
   * Draw into a part of the canvas, strip by strip: it is seen when all are done.
   * @param {Volume} volume
   * @param {Lattice} lattice
   * @param {Camera} camera
   * @param {Vector} look away from the viewer, unit vector
   * @param {() => {x: number, y: number, width: number, height: number}} part of the canvas, device pixels from below
   * @param {number} share of the pixels' number across and down that is worked out
   * @param {() => "now" | "later" | "never"} when the next strip may be drawn: looked at now and then
   * @param {(ms: number) => void} onDone told how long it took: that decides how finely it is drawn while it turns
   */
  draw(volume, lattice, camera, look, part, share, when, onDone) {
    const width = Math.max(Math.round(part().width * share), 1);
    const height = Math.max(Math.round(part().height * share), 1);
    const job = { volume, lattice, camera, look, width, height };
    // what it is seen from must not change under way
    const steps = camera.toIndexSteps(lattice.centre, lattice);
    const light = lightOf(camera, look);
    let [row, ms] = [0, 0];
    this.isBusy = true;
    const step = () => {
      const now = when();
      if (now === "later") setTimeout(step, WAIT_MS);
      if (now === "never") this.isBusy = false;
      if (now !== "now") return;
      const rows = Math.min(this.rows, height - row);
      const began = performance.now();
      this.#drawStrip({ ...job, steps, light }, row, rows);
      row += rows;
      if (row === height) this.#show(part(), width, height);
      this.#await(() => {
        const took = performance.now() - began;
        ms += took;
        this.rows = Math.max(Math.round(rows * Math.min(STRIP_MS / took, 4)), FEWEST_ROWS);
        if (row < height) step();
        else {
          this.isBusy = false;
          onDone(ms);
        }
      });
    };
    step();
  }

  /**
   * @param {{volume: Volume, lattice: Lattice, camera: Camera, look: Vector, width: number, height: number,
   *   steps: {origin: Vector, across: Vector, along: Vector}, light: Vector}} job
   * @param {number} row
   * @param {number} rows
   */
  #drawStrip({ volume, lattice, camera, look, width, height, steps, light }, row, rows) {
    const { gl } = this;
    this.#prepare(width, height);
    gl.viewport(0, 0, width, height);
    gl.scissor(0, row, width, rows);
    gl.useProgram(this.program);
    gl.bindVertexArray(this.array);
    const at = (/** @type {string} */ name) => gl.getUniformLocation(this.program, name);
    const { origin, across, along } = steps;
    const [pixelAcross, pixelAlong] = [camera.width / width, camera.height / height];
    gl.uniform3f(at("origin"), ...origin);
    gl.uniform3f(at("across"), across[0] * pixelAcross, across[1] * pixelAcross, across[2] * pixelAcross);
    gl.uniform3f(at("along"), along[0] * pixelAlong, along[1] * pixelAlong, along[2] * pixelAlong);
    gl.uniform3f(at("look"), ...lattice.turnedToIndex(look));
    gl.uniform3f(at("size"), ...volume.size);
    gl.uniform1f(at("height"), height);
    gl.uniformMatrix3fv(at("toPatient"), false, lattice.inverse.flat());
    gl.uniform3f(at("light"), ...light);
    const textures = /** @type {const} */ ([
      ["labels", gl.TEXTURE_3D, volume.labelTexture],
      ["blocks", gl.TEXTURE_3D, volume.blockTexture],
      ["colours", gl.TEXTURE_2D, volume.colourTexture],
    ]);
    textures.forEach(([name, target, texture], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(target, texture);
      gl.uniform1i(at(name), unit);
    });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  /** @param {{x: number, y: number, width: number, height: number}} part @param {number} width @param {number} height */
  #show({ x, y, width: toWidth, height: toHeight }, width, height) {
    const { gl } = this;
    gl.disable(gl.SCISSOR_TEST);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.frame);
    gl.blitFramebuffer(0, 0, width, height, x, y, x + toWidth, y + toHeight, gl.COLOR_BUFFER_BIT, gl.LINEAR);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
    gl.enable(gl.SCISSOR_TEST);
  }

  /** Look now and then whether the card is done. @param {() => void} onDone */
  #await(onDone) {
    const { gl } = this;
    const sync = /** @type {WebGLSync} */ (gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0));
    gl.flush();
    const look = () => {
      if (!gl.isContextLost() && gl.clientWaitSync(sync, 0, 0) === gl.TIMEOUT_EXPIRED) {
        setTimeout(look, WAIT_MS);
        return;
      }
      gl.deleteSync(sync);
      onDone();
    };
    setTimeout(look, WAIT_MS);
  }

  /** @param {number} width @param {number} height */
  #prepare(width, height) {
    const { gl } = this;
    if (width !== this.width || height !== this.height) {
      [this.width, this.height] = [width, height];
      gl.bindTexture(gl.TEXTURE_2D, this.picture);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, width, height, 0, gl.RGBA, gl.UNSIGNED_BYTE, null);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.picture, 0);
  }
}

/** The light stands above the viewer's left shoulder. @param {Camera} camera @param {Vector} look @returns {Vector} */
export function lightOf({ frame: { right, down } }, look) {
  const towards = [0, 1, 2].map((a) => -look[a] - 0.35 * right[a] - 0.45 * down[a]);
  const length = Math.hypot(...towards);
  return /** @type {Vector} */ (towards.map((value) => value / length));
}
