/* The viewer's arithmetic: no page, no WebGL, so that it can be tested by itself. Vectors are arrays, matrices are
   three rows: the picture's right, its top, and the way to the viewer, each in patient LPS. */
"use strict";
(function () {
  const SIDES = {
    anterior: [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    posterior: [[-1, 0, 0], [0, 0, 1], [0, 1, 0]],
    left: [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    right: [[0, -1, 0], [0, 0, 1], [-1, 0, 0]],
    superior: [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
    inferior: [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
  };
  const WAYS = [["left", "right"], ["posterior", "anterior"], ["superior", "inferior"]];
  const LETTERS = { left: "L", right: "R", posterior: "P", anterior: "A", superior: "S", inferior: "I" };

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
  const added = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
  const less = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];

  function unit(a) {
    const length = Math.sqrt(dot(a, a));
    return length > 0 ? scaled(a, 1 / length) : [0, 0, 0];
  }

  /** Bytes of a base64 text. */
  function bytes(text) {
    const raw = atob(text);
    const found = new Uint8Array(raw.length);
    for (let n = 0; n < raw.length; n += 1) found[n] = raw.charCodeAt(n);
    return found;
  }

  /** Distance of the farthest vertex from the middle of the bounding box, mm; positions are uint16 (x, y, z). */
  function farthest(positions, step) {
    const steps = new Uint16Array(positions.buffer);
    let most = 0;
    for (let n = 0; n < steps.length; n += 3) {
      const x = (steps[n] - 32767.5) * step[0], y = (steps[n + 1] - 32767.5) * step[1], z = (steps[n + 2] - 32767.5) * step[2];
      most = Math.max(most, x * x + y * y + z * z);
    }
    return Math.sqrt(most) || 1;
  }

  /** The unit vector that was folded into two signed bytes. */
  function unfolded(u, v) {
    const a = Math.max(u / 127, -1), b = Math.max(v / 127, -1);
    const z = 1 - Math.abs(a) - Math.abs(b);
    const back = Math.max(-z, 0);
    return unit([a + (a >= 0 ? -back : back), b + (b >= 0 ? -back : back), z]);
  }

  /** The view that looks against a direction, with something near `up` on top. */
  function lookingAt(towards, up) {
    const view = unit(towards);
    let top = less(up, scaled(view, dot(up, view)));
    if (dot(top, top) < 1e-6) top = less([0, -1, 0], scaled(view, -view[1]));
    top = unit(top);
    return [cross(top, view), top, view];
  }

  /** A view turned about the picture's own axes, radians: the near side of the heart moves right and down. */
  function turned(view, right, down) {
    const away = added(scaled(view[2], Math.cos(right)), scaled(view[0], -Math.sin(right)));
    const up = added(scaled(view[1], Math.cos(down)), scaled(away, -Math.sin(down)));
    return lookingAt(added(scaled(away, Math.cos(down)), scaled(view[1], Math.sin(down))), up);
  }

  /** The quaternion (w, x, y, z) of a view. */
  function quaternion(m) {
    const squares = [
      1 + m[0][0] + m[1][1] + m[2][2],
      1 + m[0][0] - m[1][1] - m[2][2],
      1 - m[0][0] + m[1][1] - m[2][2],
      1 - m[0][0] - m[1][1] + m[2][2],
    ];
    const [a, b, c] = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]];
    const [d, e, f] = [m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]];
    const rows = [[squares[0], a, b, c], [a, squares[1], d, e], [b, d, squares[2], f], [c, e, f, squares[3]]];
    const most = squares.indexOf(Math.max(...squares));
    const length = Math.hypot(...rows[most]);
    return rows[most].map((value) => value / length);
  }

  /** The view of a quaternion. */
  function viewOf([w, x, y, z]) {
    return [
      [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
      [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
      [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ];
  }

  /** A view between two, part 0 to 1 of the way, by the shorter turn. */
  function between(from, to, part) {
    const p = quaternion(from), q = quaternion(to);
    const sign = p.reduce((sum, value, n) => sum + value * q[n], 0) < 0 ? -1 : 1;
    const mean = p.map((value, n) => value * (1 - part) + sign * q[n] * part);
    const length = Math.hypot(...mean);
    return viewOf(length > 1e-6 ? mean.map((value) => value / length) : q);
  }

  /** Sides of the patient that a direction points to, the strongest first; weak ones are left out. */
  function sidesOf(direction) {
    const u = unit(direction);
    return [0, 1, 2]
      .filter((n) => Math.abs(u[n]) >= 0.35)
      .sort((a, b) => Math.abs(u[b]) - Math.abs(u[a]))
      .map((n) => WAYS[n][u[n] > 0 ? 0 : 1]);
  }

  const lettersOf = (direction) => sidesOf(direction).map((side) => LETTERS[side]).join("");

  const pure = {
    SIDES: SIDES, dot: dot, cross: cross, scaled: scaled, added: added, less: less, unit: unit, bytes: bytes, farthest: farthest,
       unfolded: unfolded, lookingAt: lookingAt, turned: turned, between: between, sidesOf: sidesOf, lettersOf: lettersOf,
  };
  if (typeof window === "undefined") module.exports = pure;
  else window.HeartcaseMath = pure;
})();
