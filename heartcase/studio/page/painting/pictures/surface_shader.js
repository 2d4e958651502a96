/** A surface of triangles in the 3-D picture: lit from the viewer's side, cut open at the crosshair where that is asked for. */

/** @typedef {import("../../shared/geometry.js").Camera} Camera */
/** @typedef {import("../../shared/geometry.js").Lattice} Lattice */
/** @typedef {import("../../shared/geometry.js").Vector} Vector */
/** @typedef {{x: number, y: number, width: number, height: number}} Part device pixels from below */

const VERTEX = `#version 300 es
in vec3 position; in vec3 normal; in vec3 colour;
uniform vec3 centre, right, down, look;
uniform vec2 halfSize;
uniform float depth;
out vec3 vNormal, vColour, vPosition;
void main() {
  vec3 from = position - centre;
  vNormal = normal; vColour = colour; vPosition = position;
  gl_Position = vec4(dot(from, right) / halfSize.x, -dot(from, down) / halfSize.y, dot(from, look) / depth, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec3 vNormal, vColour, vPosition;
uniform vec3 light, look, through;
uniform bool cuts;
out vec4 seen;
void main() {
  if (cuts && dot(vPosition - through, look) < 0.0) discard;
  // what is cut open shows the inside of the tissue
  if (!gl_FrontFacing) { seen = vec4(0.55, 0.2, 0.2, 1.0); return; }
  float bright = 0.32 + 0.68 * max(dot(normalize(vNormal), light), 0.0);
  seen = vec4(vColour * bright, 1.0);
}`;

export class SurfaceShader {
  /** Whether there is a surface to draw. */
  isThere = false;
  #count = 0;
  #width = 0;
  #height = 0;

  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.program = linked(gl);
    this.place = (/** @type {string} */ name) => gl.getUniformLocation(this.program, name);
    this.array = gl.createVertexArray();
    this.buffers = { position: gl.createBuffer(), normal: gl.createBuffer(), colour: gl.createBuffer(), index: gl.createBuffer() };
    this.frame = gl.createFramebuffer();
    this.picture = gl.createRenderbuffer();
    this.depth = gl.createRenderbuffer();
  }

  /** @param {Float32Array<ArrayBuffer>} positions @param {Uint32Array<ArrayBuffer>} triangles @param {Uint8Array<ArrayBuffer>} colours @param {Int8Array<ArrayBuffer>} normals */
  set(positions, triangles, colours, normals) {
    const { gl, buffers } = this;
    gl.bindVertexArray(this.array);
    /** @type {[WebGLBuffer | null, ArrayBufferView<ArrayBuffer>, string, number][]} */
    const parts = [[buffers.position, positions, "position", gl.FLOAT], [buffers.normal, normals, "normal", gl.BYTE], [buffers.colour, colours, "colour", gl.UNSIGNED_BYTE]];
    for (const [buffer, data, name, type] of parts) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      const at = gl.getAttribLocation(this.program, name);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, 3, type, type !== gl.FLOAT, 0, 0);
    }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.index);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    this.#count = triangles.length;
    this.isThere = true;
  }

  /**
   * @param {Lattice} lattice
   * @param {Camera} camera
   * @param {Vector} look away from the viewer
   * @param {Vector} light
   * @param {Part} part of the canvas
   * @param {Vector | null} through where it is cut open
   */
  draw(lattice, camera, look, light, part, through) {
    const { gl, place } = this;
    const { width, height } = part;
    this.#prepare(width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.viewport(0, 0, width, height);
    gl.disable(gl.SCISSOR_TEST);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this.program);
    const extent = lattice.spacing.reduce((sum, one, a) => sum + one * lattice.size[a], 0);
    gl.uniform3fv(place("centre"), camera.centre);
    gl.uniform3fv(place("right"), camera.frame.right);
    gl.uniform3fv(place("down"), camera.frame.down);
    gl.uniform3fv(place("look"), look);
    gl.uniform3fv(place("light"), light);
    gl.uniform2f(place("halfSize"), (camera.width * camera.mmPerPixel) / 2, (camera.height * camera.mmPerPixel) / 2);
    gl.uniform1f(place("depth"), extent);
    gl.uniform1i(place("cuts"), Number(through !== null));
    gl.uniform3fv(place("through"), through ?? [0, 0, 0]);
    gl.bindVertexArray(this.array);
    gl.drawElements(gl.TRIANGLES, this.#count, gl.UNSIGNED_INT, 0);
    gl.bindVertexArray(null);
    gl.disable(gl.DEPTH_TEST);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.frame);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
    gl.blitFramebuffer(0, 0, width, height, part.x, part.y, part.x + width, part.y + height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.enable(gl.SCISSOR_TEST);
  }

  /** @param {number} width @param {number} height */
  #prepare(width, height) {
    if (width === this.#width && height === this.#height) return;
    const { gl } = this;
    [this.#width, this.#height] = [width, height];
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.bindRenderbuffer(gl.RENDERBUFFER, this.picture);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA8, width, height);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, this.picture);
    gl.bindRenderbuffer(gl.RENDERBUFFER, this.depth);
    gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, width, height);
    gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, this.depth);
  }
}

/** @param {WebGL2RenderingContext} gl */
function linked(gl) {
  const program = /** @type {WebGLProgram} */ (gl.createProgram());
  for (const [type, source] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]])) {
    const shader = /** @type {WebGLShader} */ (gl.createShader(type));
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(program) ?? "a shader");
  return program;
}
