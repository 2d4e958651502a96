async ({ topology, frame }) => {
  // Where the graphics card puts every vertex of the surface: the page's own formula, its results read back.
  // With messages in base64 they are taken first; without, what the page shows now is read.
  const { open } = await import("/static/operating/main.js");
  const { arraysOf } = await import("/static/operating/messages.js");
  const { Nodes, ROW } = await import("/static/operating/nodes.js");
  const { ATTRIBUTES, PLACING } = await import("/static/operating/placing.js");
  const { unpack } = await import("/static/shared/connection.js");
  const { heart } = open.picture;
  let { arrays, nodes } = heart;
  // three.js keeps columns, as uniforms want them
  let direction = [...heart.uniforms.direction.value.elements];
  let cellMm = heart.uniforms.cellMm.value;
  if (topology) {
    const bytes = (text) => Uint8Array.from(atob(text), (one) => one.charCodeAt(0)).buffer;
    const whole = await unpack(bytes(topology));
    arrays = arraysOf(whole);
    const springs = { nodes: arrays.normal_nodes, first: arrays.spring_first, neighbours: arrays.spring_neighbours, offset: arrays.spring_offset };
    nodes = new Nodes(whole.header.node_count, springs);
    const [a, b, c] = whole.header.direction;
    direction = [0, 1, 2].flatMap((n) => [a[n], b[n], c[n]]);
    cellMm = whole.header.cell_mm;
    const moved = await unpack(bytes(frame));
    const { blocks, steps } = arraysOf(moved);
    nodes.take(blocks, steps, moved.header.scale, moved.header.block_nodes);
  }
  const gl = document.createElement("canvas").getContext("webgl2");
  const program = gl.createProgram();
  const source = `#version 300 es\n${PLACING}\nout vec3 placeMm, normalHere, tangentRead; out float stretchHere;
    void main() { place(placeMm, normalHere, tangentRead, stretchHere); }`;
  for (const [kind, text] of [[gl.VERTEX_SHADER, source], [gl.FRAGMENT_SHADER, "#version 300 es\nvoid main() {}"]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.transformFeedbackVaryings(program, ["placeMm", "normalHere", "tangentRead"], gl.SEPARATE_ATTRIBS);
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  gl.useProgram(program);
  for (const [attribute, name, size, isWhole] of ATTRIBUTES) {
    const at = gl.getAttribLocation(program, attribute);
    if (at < 0 || arrays[name] === undefined) continue;
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, isWhole ? arrays[name] : new Float32Array(arrays[name]), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(at);
    if (isWhole) gl.vertexAttribIPointer(at, size, gl.INT, 0, 0);
    else gl.vertexAttribPointer(at, size, gl.FLOAT, false, 0, 0);
  }
  [["displacements", nodes.displacement], ["nodeNormals", nodes.normals]].forEach(([name, numbers], unit) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, ROW, numbers.length / 4 / ROW, 0, gl.RGBA, gl.FLOAT, numbers);
    gl.uniform1i(gl.getUniformLocation(program, name), unit);
  });
  gl.uniformMatrix3fv(gl.getUniformLocation(program, "direction"), false, direction);
  gl.uniform1f(gl.getUniformLocation(program, "cellMm"), cellMm);
  const count = arrays.curvature.length;
  gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, gl.createTransformFeedback());
  const buffers = [0, 1, 2].map((number) => {
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.TRANSFORM_FEEDBACK_BUFFER, buffer);
    gl.bufferData(gl.TRANSFORM_FEEDBACK_BUFFER, 12 * count, gl.STATIC_READ);
    gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, number, buffer);
    return buffer;
  });
  gl.bindBuffer(gl.ARRAY_BUFFER, null);
  gl.enable(gl.RASTERIZER_DISCARD);
  gl.beginTransformFeedback(gl.POINTS);
  gl.drawArrays(gl.POINTS, 0, count);
  gl.endTransformFeedback();
  gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, null);
  const [places, normals, tangents] = buffers.map((buffer) => {
    const read = new Float32Array(3 * count);
    gl.bindBuffer(gl.TRANSFORM_FEEDBACK_BUFFER, buffer);
    gl.getBufferSubData(gl.TRANSFORM_FEEDBACK_BUFFER, 0, read);
    return [...read];
  });
  gl.getExtension("WEBGL_lose_context").loseContext();
  return { vertex: [...arrays.vertex], uv: [...(arrays.uv ?? [])], places, normals, tangents, step: open.header.step };
}
