/** Draws a plane through the scan with its labels: intensities interpolated, labels as they are. */

/** @typedef {import("../../shared/geometry.js").Camera} Camera */
/** @typedef {import("../../shared/geometry.js").Lattice} Lattice */
/** @typedef {import("../../shared/geometry.js").Vector} Vector */
/** @typedef {import("./slice_view.js").Part} Part */
/** @typedef {import("./volume.js").Volume} Volume */
/** @typedef {{low: number, high: number, opacity: number, outline: boolean}} Look */

const VERTEX = `#version 300 es
void main() {
  // one triangle that covers the view
  vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(corner, 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler3D;
precision highp usampler3D;
uniform sampler3D scan;
uniform usampler3D labels;
uniform sampler2D colours;
uniform vec3 origin, across, along; // index at the upper left corner, and per pixel of the screen
uniform vec2 corner;                // lower left corner of the view, pixels
uniform float height;               // of the view, pixels
uniform vec3 size;
uniform vec2 range;                 // window, as the texture holds intensities
uniform float opacity, outline;     // of a label's area; and pixels of its rim, 0 for none
out vec4 colour;

uint labelAt(vec3 index) {
  ivec3 voxel = ivec3(floor(index + 0.5));
  if (any(lessThan(voxel, ivec3(0))) || any(greaterThanEqual(voxel, ivec3(size)))) return 255u;
  return texelFetch(labels, voxel, 0).r;
}

void main() {
  vec2 pixel = gl_FragCoord.xy - corner;
  vec3 index = origin + pixel.x * across + (height - pixel.y) * along;
  if (any(lessThan(index, vec3(-0.5))) || any(greaterThan(index, size - 0.5))) {
    colour = vec4(0.0, 0.0, 0.0, 1.0);
    return;
  }
  float value = texture(scan, (index + 0.5) / size).r;
  vec3 grey = vec3(clamp((value - range.x) / (range.y - range.x), 0.0, 1.0));
  uint label = labelAt(index);
  vec4 paint = texelFetch(colours, ivec2(int(label), 0), 0);
  float cover = paint.a * opacity;
  if (outline > 0.0 && paint.a > 0.0) {
    vec3 dx = outline * across, dy = outline * along;
    if (labelAt(index + dx) != label || labelAt(index - dx) != label
        || labelAt(index + dy) != label || labelAt(index - dy) != label) cover = 1.0;
  }
  colour = vec4(mix(grey, paint.rgb, cover), 1.0);
}`;

export class SliceShader {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.program = linked(gl, VERTEX, FRAGMENT);
    this.array = gl.createVertexArray();
    /** @type {Record<string, WebGLUniformLocation | null>} */
    this.at = {};
    const count = gl.getProgramParameter(this.program, gl.ACTIVE_UNIFORMS);
    for (let n = 0; n < count; n++) {
      const name = /** @type {WebGLActiveInfo} */ (gl.getActiveUniform(this.program, n)).name;
      this.at[name] = gl.getUniformLocation(this.program, name);
    }
  }

  /**
   * Draw one view into its part of the canvas.
   * @param {Volume} volume
   * @param {Lattice} lattice
   * @param {Camera} camera
   * @param {Vector} through
   * @param {Look} look
   * @param {Part} part of the canvas
   * @param {Part} stale what of it is drawn
   */
  draw(volume, lattice, camera, through, look, part, stale) {
    const { gl, at } = this;
    gl.viewport(part.x, part.y, part.width, part.height);
    gl.scissor(stale.x, stale.y, stale.width, stale.height);
    gl.useProgram(this.program);
    gl.bindVertexArray(this.array);
    const scale = camera.height / part.height;
    const { origin, across, along } = camera.toIndexSteps(through, lattice);
    gl.uniform3f(at.origin, ...origin);
    gl.uniform3f(at.across, across[0] * scale, across[1] * scale, across[2] * scale);
    gl.uniform3f(at.along, along[0] * scale, along[1] * scale, along[2] * scale);
    gl.uniform2f(at.corner, part.x, part.y);
    gl.uniform1f(at.height, part.height);
    gl.uniform3f(at.size, ...volume.size);
    gl.uniform2f(at.range, volume.asStored(look.low), volume.asStored(look.high));
    gl.uniform1f(at.opacity, look.opacity);
    gl.uniform1f(at.outline, look.outline ? Math.max(1, Math.round(1 / scale)) : 0);
    const textures = /** @type {const} */ ([
      ["scan", gl.TEXTURE_3D, volume.scanTexture],
      ["labels", gl.TEXTURE_3D, volume.labelTexture],
      ["colours", gl.TEXTURE_2D, volume.colourTexture],
    ]);
    textures.forEach(([name, target, texture], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(target, texture);
      gl.uniform1i(at[name], unit);
    });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.activeTexture(gl.TEXTURE0);
  }
}

/**
 * A program of two shaders.
 * @param {WebGL2RenderingContext} gl
 * @param {string} vertex
 * @param {string} fragment
 */
export function linked(gl, vertex, fragment) {
  const program = /** @type {WebGLProgram} */ (gl.createProgram());
  for (const [kind, source] of /** @type {const} */ ([[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]])) {
    const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
      throw new Error(`shader: ${gl.getShaderInfoLog(shader)}`);
    }
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(`shader: ${gl.getProgramInfoLog(program)}`);
  }
  return program;
}
