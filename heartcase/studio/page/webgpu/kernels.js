/**
 * The lattice's springs, corner guard and probe as WGSL kernels: the formulas of the Python reference, in float32.
 *
 * A step is three dispatches: corners that are about to turn push back, every node gets its velocity, every node moves.
 * Each node gathers what its neighbours do to it, so no two threads write to one place and a run repeats itself.
 */

export const GROUP = 64;
/** Floats of the settings: see `Settings` below. */
export const SETTING_COUNT = 16;

export const CODE = /* wgsl */ `
struct Settings {
  step: f32, keep: f32, kick: f32, speed_limit: f32,
  // the probe: centre after this step and radius, all in cells; its movement in a step
  probe: vec4f,
  probe_movement: vec4f,
  shear: f32, corner_floor: f32, node_count: u32, cell_count: u32,
}
struct Led { node: u32, inverse_mass: f32, pad0: f32, pad1: f32, velocity: vec4f }

@group(0) @binding(0) var<uniform> settings: Settings;
// xyz [cells]; w of the rest places is the inverse mass, zero where a node is fixed or led
@group(0) @binding(1) var<storage, read_write> displacement: array<vec4f>;
@group(0) @binding(2) var<storage, read_write> velocity: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> rest: array<vec4f>;
// 18 rows of node_count: node at the other end (none: all ones), stiffness
@group(0) @binding(4) var<storage, read> springs: array<vec2u>;
// 8 a cell: its corners' nodes; 8 a node: cell * 8 + corner (none: all ones)
@group(0) @binding(5) var<storage, read> corners: array<u32>;
@group(0) @binding(6) var<storage, read> guard: array<f32>;
// 8 a cell: force on each corner; w of the first says whether there is any
@group(0) @binding(7) var<storage, read_write> pushes: array<vec4f>;
@group(0) @binding(8) var<storage, read> led: array<Led>;

const NONE = 0xffffffffu;
const OFFSETS = array<vec3f, 9>(OFFSETS_HERE);

fn spring(d0: vec3f, rest_square: f32, rest_length: f32, du: vec3f, stiffness: f32) -> vec3f {
  let d = d0 + du;
  let square = dot(d, d);
  if (square == 0.0) { return vec3f(); }
  let length = sqrt(square);
  // The difference of the squares keeps its digits where a spring is hardly stretched.
  let stretch = dot(du, 2.0 * d0 + du) / (length + rest_length);
  return stiffness * stretch / length * d;
}

@compute @workgroup_size(${GROUP}) fn push_corners(@builtin(global_invocation_id) id: vec3u) {
  let cell = id.x;
  if (cell >= settings.cell_count) { return; }
  let first = 8u * cell;
  var u: array<vec3f, 8>;
  for (var c = 0u; c < 8u; c++) { u[c] = displacement[corners[first + c]].xyz; }
  var force: array<vec3f, 8>;
  var is_pushed = false;
  for (var c = 0u; c < 8u; c++) {
    let at = u[c];
    var edge: array<vec3f, 3>;
    var sign: array<f32, 3>;
    for (var axis = 0u; axis < 3u; axis++) {
      sign[axis] = select(1.0, -1.0, (c & (1u << axis)) != 0u);
      var along = vec3f();
      along[axis] = 1.0;
      edge[axis] = along + sign[axis] * (u[c ^ (1u << axis)] - at);
    }
    let slope = array<vec3f, 3>(cross(edge[1], edge[2]), cross(edge[2], edge[0]), cross(edge[0], edge[1]));
    let lack = settings.corner_floor - dot(edge[0], slope[0]);
    if (lack <= 0.0) { continue; }
    is_pushed = true;
    let normal = slope[0] + slope[1] + slope[2];
    let d = 0.5 + 0.25 * (dot(slope[0], slope[0]) + dot(slope[1], slope[1]) + dot(slope[2], slope[2]) + dot(normal, normal));
    let push = 0.125 * lack / d;
    for (var axis = 0u; axis < 3u; axis++) {
      let left = (axis + 1u) % 3u;
      let right = (axis + 2u) % 3u;
      let steeper = cross(slope[left] + normal, edge[right]) + cross(edge[left], slope[right] + normal);
      let pull = sign[axis] * (push * slope[axis] + push * lack / d / 4.0 * steeper);
      force[c ^ (1u << axis)] += pull;
      force[c] -= pull;
    }
  }
  if (!is_pushed) {
    pushes[first].w = 0.0;
    return;
  }
  for (var c = 0u; c < 8u; c++) { pushes[first + c] = vec4f(guard[cell] * force[c], 1.0); }
}

@compute @workgroup_size(${GROUP}) fn accelerate(@builtin(global_invocation_id) id: vec3u) {
  let node = id.x;
  let count = settings.node_count;
  if (node >= count) { return; }
  let inverse_mass = rest[node].w;
  if (inverse_mass == 0.0) { return; }
  let u = displacement[node].xyz;
  var force = vec3f();
  for (var row = 0u; row < 9u; row++) {
    let offset = OFFSETS[row];
    let rest_square = dot(offset, offset);
    let rest_length = select(1.4142135, 1.0, rest_square < 1.5);
    let higher = springs[row * count + node];
    if (higher.x != NONE) {
      force += spring(offset, rest_square, rest_length, displacement[higher.x].xyz - u, bitcast<f32>(higher.y));
    }
    let lower = springs[(9u + row) * count + node];
    if (lower.x != NONE) {
      force += spring(-offset, rest_square, rest_length, displacement[lower.x].xyz - u, bitcast<f32>(lower.y));
    }
  }
  force *= settings.shear;
  let own = 8u * (settings.cell_count + node);
  for (var c = 0u; c < 8u; c++) {
    let corner = corners[own + c];
    if (corner != NONE && pushes[corner & ~7u].w != 0.0) { force += pushes[corner].xyz; }
  }
  let speed = settings.keep * velocity[node].xyz + settings.kick * inverse_mass * force;
  velocity[node] = vec4f(clamp(speed, vec3f(-settings.speed_limit), vec3f(settings.speed_limit)), 0.0);
}

// Where a node goes that a ball meets: the same cases as in the Python reference (slid, held inside, run over).
fn outside(before: vec3f, after: vec3f, radius: f32) -> vec3f {
  let r0 = length(before) / radius;
  let r1 = length(after) / radius;
  if (dot(before, after) > 0.5 * r0 * r1 * radius * radius || r0 == 0.0) {
    if (r1 < 1.0 && r1 > 0.0) { return after / r1; }
    return after;
  }
  if (r0 < 1.0) { return before / r0; }
  let way = after - before;
  // Nearest place of the way to the centre: where the ball is met first, if at all.
  let a = dot(way, way);
  let b = dot(before, way);
  let c = dot(before, before) - radius * radius;
  let root = b * b - a * c;
  if (a == 0.0 || root <= 0.0) { return after; }
  let part = (-b - sqrt(root)) / a;
  if (part < 0.0 || part >= 1.0) { return after; }
  return before + part * way;
}

@compute @workgroup_size(${GROUP}) fn move_on(@builtin(global_invocation_id) id: vec3u) {
  let node = id.x;
  if (node >= settings.node_count) { return; }
  let u = displacement[node].xyz;
  var v = velocity[node].xyz;
  var later = u + settings.step * v;
  let radius = settings.probe.w;
  if (radius > 0.0 && rest[node].w > 0.0) {
    let at = rest[node].xyz;
    let centre = settings.probe.xyz;
    let after = at + later - centre;
    let target_place = outside(at + u - (centre - settings.probe_movement.xyz), after, radius);
    if (any(target_place != after)) {
      later += target_place - after;
      v = (later - u) / settings.step;
      velocity[node] = vec4f(v, 0.0);
    }
  }
  displacement[node] = vec4f(later, 0.0);
}

@compute @workgroup_size(${GROUP}) fn lead(@builtin(global_invocation_id) id: vec3u) {
  if (id.x >= arrayLength(&led)) { return; }
  let one = led[id.x];
  if (one.node == NONE) { return; }
  rest[one.node].w = one.inverse_mass;
  velocity[one.node] = vec4f(one.velocity.xyz, 0.0);
}
`;
