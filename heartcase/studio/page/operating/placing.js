/**
 * How a vertex of the surface follows its three nodes, as the server's `heartcase.simulator.surface` has it (eq. 9.6 to 9.9):
 * a reference point on the triangle of nodes, and an offset along the triangle's own basis T, N, B, or along one whose normal
 * lies between the normals of the nodes. Along a cut a vertex follows the eight corners of a cell instead.
 */

import { ROW } from "./nodes.js";

/** What is constant of each vertex: attribute, its name in messages, numbers of each, and whether they are whole. */
export const ATTRIBUTES = /** @type {const} */ ([
  ["position", "rest_mm", 3, false],
  ["nodes", "nodes", 3, true],
  ["normalNumber", "normal_number", 3, true],
  ["weights", "weights", 3, false],
  ["edgeOne", "edge_one", 3, false],
  ["edgeTwo", "edge_two", 3, false],
  ["curvature", "curvature", 1, false],
  ["offset", "offset", 3, false],
  ["along", "normal", 3, false],
  ["restTurn", "rest_turn", 3, false],
  ["structure", "structure", 1, false],
  // of a case with a normal map
  ["uv", "uv", 2, false],
  ["tangent", "tangent", 4, false],
]);

export const PLACING = `
precision highp float;
precision highp int;
precision highp sampler2D;
in vec3 position, weights, edgeOne, edgeTwo, offset, along, restTurn;
in ivec3 nodes, normalNumber;
in float curvature, structure;
in vec2 uv;
in vec4 tangent;
uniform sampler2D displacements, nodeNormals;
uniform mat3 direction;
uniform float cellMm;

vec4 ofNode(sampler2D texels, int number) {
  return texelFetch(texels, ivec2(number % ${ROW}, number / ${ROW}), 0);
}

vec3 unit(vec3 a) {
  float squared = dot(a, a);
  return squared > 0.0 ? a * inversesqrt(squared) : vec3(0.0);
}

vec3 unitOr(vec3 a, vec3 otherwise) {
  float squared = dot(a, a);
  return squared < 1e-12 ? otherwise : a * inversesqrt(squared);
}

/* The same of a vertex in a cell: trilinear between its corners, and along the deformation gradient beyond. Messages have the
   corners in nodes, normalNumber and the first two of offset, the place in the cell in edgeOne, what is beyond in edgeTwo. */
void placeInCell(out vec3 placeMm, out vec3 normal, out vec3 tangentHere, out float stretch) {
  int corners[8] = int[8](nodes.x, nodes.y, nodes.z, normalNumber.x, normalNumber.y, normalNumber.z, int(offset.x), int(offset.y));
  vec4 moved = vec4(0.0);
  mat3 F = mat3(1.0);
  for (int corner = 0; corner < 8; corner++) {
    vec3 upper = vec3(corner & 1, (corner >> 1) & 1, (corner >> 2) & 1);
    vec3 w = mix(1.0 - edgeOne, edgeOne, upper), s = 2.0 * upper - 1.0;
    vec4 u = ofNode(displacements, corners[corner]);
    moved += w.x * w.y * w.z * u;
    F += outerProduct(u.xyz, vec3(s.x * w.y * w.z, w.x * s.y * w.z, w.x * w.y * s.z));
  }
  placeMm = position + cellMm * (direction * (moved.xyz + F * edgeTwo - edgeTwo));
  normal = direction * unitOr(mat3(cross(F[1], F[2]), cross(F[2], F[0]), cross(F[0], F[1])) * along, along);
  tangentHere = vec3(0.0);
  stretch = moved.w;
}

/* Where the vertex is, LPS mm, its unit normal and tangent, LPS, and the stretch there, 0 to 1. */
void place(out vec3 placeMm, out vec3 normal, out vec3 tangentHere, out float stretch) {
  if (curvature > 1.5) {
    placeInCell(placeMm, normal, tangentHere, stretch);
    return;
  }
  vec4 u1 = ofNode(displacements, nodes.x), u2 = ofNode(displacements, nodes.y), u3 = ofNode(displacements, nodes.z);
  vec3 T = unit(edgeOne + (u2.xyz - u1.xyz));
  vec3 N = unit(cross(T, edgeTwo + (u3.xyz - u1.xyz)));
  vec3 B = cross(N, T);
  if (curvature > 0.5) {
    N = unit(weights.x * ofNode(nodeNormals, normalNumber.x).xyz + weights.y * ofNode(nodeNormals, normalNumber.y).xyz
      + weights.z * ofNode(nodeNormals, normalNumber.z).xyz);
    B = unit(cross(N, T));
    T = cross(B, N);
  }
  vec4 between = weights.x * u1 + weights.y * u2 + weights.z * u3;
  vec3 moved = between.xyz + offset.x * T + offset.y * N + offset.z * B;
  placeMm = position + cellMm * (direction * (moved - restTurn));
  normal = direction * (along.x * T + along.y * N + along.z * B);
  tangentHere = direction * (tangent.x * T + tangent.y * N + tangent.z * B);
  stretch = between.w;
}
`;

export const VERTEX = `
${PLACING}
uniform mat4 projectionMatrix, viewMatrix;
uniform sampler2D palette;
out vec3 seenNormal, toEye;
out vec4 seenTangent;
out vec2 mapAt;
out float stretchHere;
flat out vec3 colour;
/* Pattern, and number of the structure. */
flat out vec2 kind;
out vec3 here;

void main() {
  vec3 placeMm, normal, tangentHere;
  place(placeMm, normal, tangentHere, stretchHere);
  vec4 look = texelFetch(palette, ivec2(int(structure + 0.5), 0), 0);
  vec4 seen = viewMatrix * vec4(placeMm, 1.0);
  colour = look.rgb;
  kind = vec2(round((1.0 - look.a) * 255.0 / 40.0), structure);
  here = placeMm;
  seenNormal = mat3(viewMatrix) * normal;
  seenTangent = vec4(mat3(viewMatrix) * tangentHere, tangent.w);
  mapAt = uv;
  toEye = -seen.xyz;
  // a structure that is hidden lies outside of what is seen, with all corners at one place
  gl_Position = look.a > 0.5 ? projectionMatrix * seen : vec4(2.0, 2.0, 2.0, 1.0);
}
`;

/* Patterns tell structures apart without colour: 1 is level lines, 2 slanting ones. */
export const PATTERNED = `
vec3 patterned(vec3 own, float pattern) {
  if (pattern > 1.5 && mod(gl_FragCoord.x + gl_FragCoord.y, 11.0) < 3.0) return mix(own, vec3(1.0), 0.42);
  return pattern > 0.5 && pattern < 1.5 && mod(gl_FragCoord.y, 9.0) < 1.5 ? own * 0.72 : own;
}
`;

/* Light from the eye, a little from above, and some all around; the inner side of a wall is darker. PLAIN: without a
   normal map. WHOLE: without a cut plane, so that what lies behind is left out before it is lit. */
export const FRAGMENT = `
precision highp float;
precision highp sampler2D;
in vec3 seenNormal, toEye;
in vec4 seenTangent;
in vec2 mapAt;
in float stretchHere;
flat in vec3 colour;
flat in vec2 kind;
in vec3 here;
/* What lies beyond this plane is not drawn: normal, and how far it is from the origin, LPS mm. */
uniform vec4 cutPlane;
uniform sampler2D stretchColours, normalMap;
uniform bool showsStretch, hasMap;
out vec4 drawn;
${PATTERNED}
void main() {
#ifndef WHOLE
  if (dot(cutPlane.xyz, here) > cutPlane.w) discard;
#endif
  vec3 eye = normalize(toEye);
  vec3 normal = normalize(seenNormal);
#ifndef PLAIN
  vec3 bent = texture(normalMap, mapAt).rgb * 2.0 - 1.0;
  if (hasMap && mapAt.x >= 0.0) {
    vec3 across = cross(seenNormal, seenTangent.xyz) * seenTangent.w;
    normal = normalize(bent.x * seenTangent.xyz + bent.y * across + bent.z * seenNormal);
  }
#endif
  if (!gl_FrontFacing) normal = -normal;
  vec3 own = showsStretch ? texture(stretchColours, vec2(clamp(stretchHere, 0.0, 1.0) * 0.9961 + 0.00195, 0.5)).rgb : colour;
  own = patterned(own, kind.x);
  vec3 light = normalize(eye + vec3(0.15, 0.45, 0.0));
  float bright = 0.24 + 0.12 * normal.y + 0.72 * max(dot(normal, light), 0.0);
  float shine = 0.16 * pow(max(dot(normal, normalize(light + eye)), 0.0), 24.0);
  drawn = vec4(own * bright * (gl_FrontFacing ? 1.0 : 0.7) + shine, 1.0);
}
`;

/* The place itself and one more than the structure's number, for whoever asks what lies under the pointer. */
export const PLACE_FRAGMENT = `
precision highp float;
precision highp sampler2D;
in vec3 seenNormal, toEye;
in float stretchHere;
flat in vec3 colour;
flat in vec2 kind;
in vec3 here;
uniform vec4 cutPlane;
out vec4 drawn;

void main() {
  if (dot(cutPlane.xyz, here) > cutPlane.w) discard;
  drawn = vec4(here, 1.0 + kind.y);
}
`;

/* Lines on the surface, a little before it. */
export const LINE_VERTEX = VERTEX.replace("projectionMatrix * seen", "projectionMatrix * vec4(seen.xyz * 0.997, 1.0)");
export const LINE_FRAGMENT = PLACE_FRAGMENT.replace("vec4(here, 1.0 + kind.y)", "vec4(0.16, 0.02, 0.02, 1.0)");
