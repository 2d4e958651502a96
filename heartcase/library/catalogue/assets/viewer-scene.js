/* Drawing a packed surface with WebGL 2: structures, a cut with its walls filled, and which structure is at a point. */
"use strict";
(function () {
  const math = window.HeartcaseMath;
  const PATTERNS = { rich: 0, poor: 1, mixed: 2, unknown: 0 };
  const CUT_COLOUR = [0.93, 0.8, 0.76];
  const PAPER = [0.969, 0.976, 0.984];

  const COMMON = `#version 300 es
precision highp float;
uniform vec3 uRight, uUp, uTowards, uCentre;
uniform vec2 uScale, uShift;
uniform float uDepth;
vec4 onScreen(vec3 place) {
  vec3 away = place - uCentre;
  vec2 flat_ = vec2(dot(away, uRight), dot(away, uUp)) + uShift;
  return vec4(flat_ * uScale, -dot(away, uTowards) / uDepth, 1.0);
}`;
  const SURFACE_VERTEX = COMMON + `
layout(location = 0) in vec3 aSteps;
layout(location = 1) in vec2 aFolded;
uniform vec3 uLow, uStep;
centroid out vec3 vPlace;
centroid out vec3 vNormal;
void main() {
  vPlace = uLow + uStep * aSteps;
  vec3 n = vec3(aFolded, 1.0 - abs(aFolded.x) - abs(aFolded.y));
  float back = max(-n.z, 0.0);
  n.xy += vec2(n.x >= 0.0 ? -back : back, n.y >= 0.0 ? -back : back);
  n = normalize(n);
  vNormal = vec3(dot(n, uRight), dot(n, uUp), dot(n, uTowards));
  gl_Position = onScreen(vPlace);
}`;
  const SURFACE_FRAGMENT = `#version 300 es
precision highp float;
// Taken within the triangle, never beside it: else a pixel that a triangle only touches is cut at a wrong height.
centroid in vec3 vPlace;
centroid in vec3 vNormal;
uniform vec4 uCut;
uniform bool uIsCut, uIsFlat;
uniform vec3 uColour;
uniform int uPattern;
uniform float uPixel;
out vec4 colour;
void main() {
  if (uIsCut && dot(vPlace, uCut.xyz) > uCut.w) discard;
  if (uIsFlat) { colour = vec4(uColour, 1.0); return; }
  vec3 n = normalize(vNormal);
  if (!gl_FrontFacing) n = -n;
  if (n.z < 0.0) n = n - 2.0 * n.z * vec3(0.0, 0.0, 1.0);
  float key = max(0.0, dot(n, vec3(-0.452, 0.552, 0.703)));
  float light = 0.28 + 0.46 * key + 0.34 * n.z;
  float shine = 0.10 * pow(max(0.0, 2.0 * key * n.z - 0.703), 24.0);
  vec3 base = uColour;
  vec2 at = gl_FragCoord.xy / uPixel;
  if (uPattern == 1 && mod(at.y, 9.0) < 1.5) base *= 0.72;
  if (uPattern == 2 && mod(at.x + at.y, 11.0) < 3.0) base = mix(base, vec3(1.0), 0.42);
  if (!gl_FrontFacing) light *= 0.86;
  colour = vec4(base * light + shine, 1.0);
}`;
  const CAP_VERTEX = COMMON + `
layout(location = 0) in vec2 aCorner;
uniform vec3 uMiddle, uAcross, uAlong;
void main() { gl_Position = onScreen(uMiddle + aCorner.x * uAcross + aCorner.y * uAlong); }`;
  const CAP_FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 uColour;
uniform float uPixel;
out vec4 colour;
void main() {
  vec2 at = gl_FragCoord.xy / uPixel;
  colour = vec4(mod(at.x - at.y, 8.0) < 1.2 ? uColour * 0.78 : uColour, 1.0);
}`;

  function program(gl, vertex, fragment) {
    const made = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made) || "no program");
    const uniforms = {};
    for (let n = gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS) - 1; n >= 0; n -= 1) {
      const name = gl.getActiveUniform(made, n).name;
      uniforms[name] = gl.getUniformLocation(made, name);
    }
    return { made: made, at: uniforms };
  }

  function rgb(text) {
    return [1, 3, 5].map((n) => parseInt(text.slice(n, n + 2), 16) / 255);
  }

  /** What is drawn of a case; `state` is what the page holds: view, zoom, shift, mode, shown, lit, cut, fill. */
  class Scene {
    constructor(canvas, data) {
      const gl = canvas.getContext("webgl2", { antialias: true, stencil: true, alpha: false });
      if (!gl) throw new Error("no WebGL 2");
      this.gl = gl;
      this.canvas = canvas;
      this.groups = data.groups;
      this.low = data.low;
      this.step = data.step;
      const extent = data.step.map((step) => step * 65535);
      this.centre = math.added(data.low, math.scaled(extent, 0.5));
      this.radius = math.farthest(math.bytes(data.positions), data.step);
      this.surface = program(gl, SURFACE_VERTEX, SURFACE_FRAGMENT);
      this.cap = program(gl, CAP_VERTEX, CAP_FRAGMENT);
      this.indexKind = data.indexBytes === 2 ? gl.UNSIGNED_SHORT : gl.UNSIGNED_INT;
      this.indexBytes = data.indexBytes;
      this.mesh = gl.createVertexArray();
      gl.bindVertexArray(this.mesh);
      this.fill(gl.ARRAY_BUFFER, math.bytes(data.positions));
      gl.enableVertexAttribArray(0);
      gl.vertexAttribPointer(0, 3, gl.UNSIGNED_SHORT, false, 6, 0);
      this.fill(gl.ARRAY_BUFFER, math.bytes(data.normals));
      gl.enableVertexAttribArray(1);
      gl.vertexAttribPointer(1, 2, gl.BYTE, true, 2, 0);
      this.fill(gl.ELEMENT_ARRAY_BUFFER, math.bytes(data.indices));
      this.square = gl.createVertexArray();
      gl.bindVertexArray(this.square);
      this.fill(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]));
      gl.enableVertexAttribArray(0);
      gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
      gl.bindVertexArray(null);
    }

    fill(target, values) {
      const buffer = this.gl.createBuffer();
      this.gl.bindBuffer(target, buffer);
      this.gl.bufferData(target, values, this.gl.STATIC_DRAW);
    }

    /** Pixels of the picture for one mm. */
    pixelsPerMm(state) {
      const room = Math.min(this.canvas.width, this.canvas.height);
      return (state.zoom * room * 0.47) / this.radius;
    }

    /** Column and row of points, in pixels of the canvas, and their height towards the viewer in mm. */
    project(state, point) {
      const away = math.less(point, this.centre), size = this.pixelsPerMm(state);
      return [
        this.canvas.width / 2 + (math.dot(away, state.view[0]) + state.shift[0]) * size,
        this.canvas.height / 2 - (math.dot(away, state.view[1]) + state.shift[1]) * size,
        math.dot(away, state.view[2]),
      ];
    }

    place(which, state) {
      const gl = this.gl, size = this.pixelsPerMm(state);
      gl.useProgram(which.made);
      gl.uniform3fv(which.at.uRight, state.view[0]);
      gl.uniform3fv(which.at.uUp, state.view[1]);
      gl.uniform3fv(which.at.uTowards, state.view[2]);
      gl.uniform3fv(which.at.uCentre, this.centre);
      gl.uniform2f(which.at.uScale, (2 * size) / this.canvas.width, (2 * size) / this.canvas.height);
      gl.uniform2f(which.at.uShift, state.shift[0], state.shift[1]);
      gl.uniform1f(which.at.uDepth, this.radius * 2.2);
      if (which.at.uPixel) gl.uniform1f(which.at.uPixel, window.devicePixelRatio || 1);
    }

    startSurface(state, isFlat) {
      const gl = this.gl, at = this.surface.at;
      this.place(this.surface, state);
      gl.bindVertexArray(this.mesh);
      gl.uniform3fv(at.uLow, this.low);
      gl.uniform3fv(at.uStep, this.step);
      gl.uniform1i(at.uIsFlat, isFlat ? 1 : 0);
      gl.uniform1i(at.uIsCut, state.cut ? 1 : 0);
      if (state.cut) gl.uniform4f(at.uCut, ...state.cut.normal, math.dot(state.cut.normal, state.cut.point));
    }

    drawGroup(group) {
      this.gl.drawElements(this.gl.TRIANGLES, group.count, this.indexKind, group.first * this.indexBytes);
    }

    draw(state) {
      const gl = this.gl, at = this.surface.at;
      gl.viewport(0, 0, this.canvas.width, this.canvas.height);
      gl.clearColor(...PAPER, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST);
      const lit = state.lit !== null && state.shown[state.lit] ? state.lit : null;
      this.startSurface(state, false);
      this.groups.forEach((group, n) => {
        if (!state.shown[n] || n === lit) return;
        const colour = rgb(group[state.mode]);
        gl.uniform3fv(at.uColour, lit === null ? colour : colour.map((value) => 0.8 * 0.82 + 0.2 * value));
        gl.uniform1i(at.uPattern, state.mode === "oxygen" && lit === null ? PATTERNS[group.blood] : 0);
        this.drawGroup(group);
      });
      if (state.cut && state.fill) this.drawCap(state);
      if (lit === null) return;
      // What is pointed at in the list is seen whole, also where something lies before it.
      gl.clear(gl.DEPTH_BUFFER_BIT);
      this.startSurface(state, false);
      gl.uniform3fv(at.uColour, rgb(this.groups[lit][state.mode]));
      gl.uniform1i(at.uPattern, state.mode === "oxygen" ? PATTERNS[this.groups[lit].blood] : 0);
      this.drawGroup(this.groups[lit]);
    }

    /** Fill what the plane cuts of the tissue: there a line of sight has entered it more often than it has left it. */
    drawCap(state) {
      const gl = this.gl;
      gl.disable(gl.DEPTH_TEST);
      gl.colorMask(false, false, false, false);
      gl.depthMask(false);
      gl.enable(gl.STENCIL_TEST);
      gl.stencilFunc(gl.ALWAYS, 0, 255);
      gl.stencilOpSeparate(gl.FRONT, gl.KEEP, gl.KEEP, gl.DECR_WRAP);
      gl.stencilOpSeparate(gl.BACK, gl.KEEP, gl.KEEP, gl.INCR_WRAP);
      this.startSurface(state, true);
      this.groups.forEach((group) => this.drawGroup(group));
      gl.colorMask(true, true, true, true);
      gl.depthMask(true);
      gl.enable(gl.DEPTH_TEST);
      gl.stencilFunc(gl.NOTEQUAL, 0, 255);
      gl.stencilOp(gl.KEEP, gl.KEEP, gl.KEEP);
      this.place(this.cap, state);
      const normal = state.cut.normal;
      const across = math.unit(math.cross(normal, Math.abs(normal[0]) < 0.7 ? [1, 0, 0] : [0, 1, 0]));
      const reach = this.radius * 1.5;
      const away = math.dot(math.less(state.cut.point, this.centre), normal);
      gl.uniform3fv(this.cap.at.uMiddle, math.added(this.centre, math.scaled(normal, away)));
      gl.uniform3fv(this.cap.at.uAcross, math.scaled(across, reach));
      gl.uniform3fv(this.cap.at.uAlong, math.scaled(math.cross(normal, across), reach));
      gl.uniform3fv(this.cap.at.uColour, CUT_COLOUR);
      gl.bindVertexArray(this.square);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
      gl.disable(gl.STENCIL_TEST);
    }

    /** Number of the structure at a pixel of the canvas; null where there is none. */
    structureAt(state, column, row) {
      const gl = this.gl, size = [this.canvas.width, this.canvas.height];
      const frame = gl.createFramebuffer(), colour = gl.createRenderbuffer(), depth = gl.createRenderbuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      for (const [buffer, format, point] of [[colour, gl.RGBA8, gl.COLOR_ATTACHMENT0], [depth, gl.DEPTH_COMPONENT16, gl.DEPTH_ATTACHMENT]]) {
        gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
        gl.renderbufferStorage(gl.RENDERBUFFER, format, size[0], size[1]);
        gl.framebufferRenderbuffer(gl.FRAMEBUFFER, point, gl.RENDERBUFFER, buffer);
      }
      gl.viewport(0, 0, size[0], size[1]);
      gl.clearColor(0, 0, 0, 0);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST);
      this.startSurface(state, true);
      this.groups.forEach((group, n) => {
        if (!state.shown[n]) return;
        gl.uniform3f(this.surface.at.uColour, (n + 1) / 255, 0, 0);
        this.drawGroup(group);
      });
      const pixel = new Uint8Array(4);
      gl.readPixels(Math.round(column), size[1] - 1 - Math.round(row), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
      gl.deleteFramebuffer(frame);
      gl.deleteRenderbuffer(colour);
      gl.deleteRenderbuffer(depth);
      return pixel[0] === 0 ? null : pixel[0] - 1;
    }
  }

  window.HeartcaseScene = Scene;
})();
