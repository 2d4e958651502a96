/** What is seen besides the heart: instruments, stitches, patches, and the line that is being drawn. */

import * as three from "../vendor/three/three.module.min.js";

const COLOURS = /** @type {Record<string, number>} */ ({
  device: 0xff8c42, grab: 0xffd23f, forceps: 0xd6dde4, retractor: 0x35b7ff, scissors: 0xd6dde4, probe: 0x3fa66b,
});
const HANDLE_MM = 1.5;
/** Length of the line that shows a force, mm for each newton. */
const FORCE_MM_N = 20;
const LINE_COLOUR = 0xff2d55;
const KNOT_COLOUR = 0xf2f5f8;

export class ToolsInScene {
  /** @type {Map<string, any>} */
  #balls = new Map();
  #ball = new three.SphereGeometry(1, 24, 16);

  /** @param {any} scene @param {any} over scene that is drawn over all else: handles, which may lie in the tissue */
  constructor(scene, over) {
    this.scene = scene;
    this.over = over;
    this.stitches = new three.LineSegments(new three.BufferGeometry(), new three.LineBasicMaterial({ color: 0x101418 }));
    this.drawn = new three.Line(new three.BufferGeometry(), new three.LineBasicMaterial({ color: LINE_COLOUR }));
    this.points = new three.Points(new three.BufferGeometry(), new three.PointsMaterial({ color: LINE_COLOUR, size: 7, sizeAttenuation: false }));
    // where lips lie together a thread has no length: its places are seen all the same
    this.knots = new three.Points(new three.BufferGeometry(), new three.PointsMaterial({ color: KNOT_COLOUR, size: 4, sizeAttenuation: false }));
    this.stitches.material.clippingPlanes = this.knots.material.clippingPlanes = [this.#clipping];
    this.patches = new three.Group();
    scene.add(this.patches);
    this.force = new three.LineSegments(new three.BufferGeometry(), new three.LineBasicMaterial({ color: COLOURS.device }));
    for (const one of [this.force, this.stitches, this.knots, this.drawn, this.points]) {
      one.frustumCulled = false;
      over.add(one);
    }
    for (const one of [scene, over]) {
      one.add(new three.AmbientLight(0xffffff, 1.6));
      const light = new three.DirectionalLight(0xffffff, 1.6);
      light.position.set(0.4, -1, 0.7);
      one.add(light);
    }
  }

  /** What is shown now, to know whether it is something else. */
  #shown = "";

  /**
   * @param {Record<string, any>} header of a frame
   * @param {Record<string, any>} arrays
   * @returns {boolean} whether anything is new
   */
  show(header, arrays) {
    const shown = JSON.stringify([header.device, header.instruments, header.stitches]);
    if (shown === this.#shown && header.patches.length === 0 && this.patches.children.length === 0) return false;
    this.#shown = shown;
    const there = new Set();
    for (const { name, kind, center_mm: centre, axes_mm: axes } of header.instruments) {
      if (axes === null) {
        there.add(this.#place(name, this.over, COLOURS[kind] ?? COLOURS.forceps, centre, null));
        continue;
      }
      // a ball, or one at each end of the line that it is swept along
      const [half] = axes.slice(3);
      const isSwept = half.some((/** @type {number} */ one) => one !== 0);
      for (const end of isSwept ? [-1, 1] : [0]) {
        const at = centre.map((/** @type {number} */ one, /** @type {number} */ axis) => one + end * half[axis]);
        there.add(this.#place(`${name} ${end}`, this.scene, COLOURS.probe, at, axes));
      }
    }
    if (header.device) {
      const { position_mm: tip, force_n: force } = header.device;
      // the name of no instrument begins so
      there.add(this.#place(" device", this.over, COLOURS.device, tip, null));
      this.#setPoints(this.force, [tip, tip.map((/** @type {number} */ one, /** @type {number} */ axis) => one + FORCE_MM_N * force[axis])].flat());
    } else this.#setPoints(this.force, []);
    for (const [name, ball] of this.#balls) {
      if (there.has(name)) continue;
      ball.removeFromParent();
      ball.material.dispose();
      this.#balls.delete(name);
    }
    const places = header.stitches.flatMap((/** @type {any} */ one) => one.places_mm).flat();
    this.#setPoints(this.stitches, places);
    this.#setPoints(this.knots, places);
    this.#showPatches(header.patches.length, arrays);
    return true;
  }

  /** What lies beyond a plane is not seen: patches and stitches. @param {readonly [number, number, number, number]} equation */
  clip([x, y, z, at]) {
    this.#clipping.normal.set(-x, -y, -z);
    this.#clipping.constant = at;
  }

  /** @param {readonly number[][]} line LPS mm */
  showLine(line) {
    this.#setPoints(this.drawn, line.flat());
    this.#setPoints(this.points, line.flat());
  }

  /** @param {string} name @param {any} scene @param {number} colour @param {number[]} centre @param {number[][] | null} axes */
  #place(name, scene, colour, centre, axes) {
    let ball = this.#balls.get(name);
    if (ball === undefined) {
      ball = new three.Mesh(this.#ball, new three.MeshLambertMaterial({ color: colour, transparent: axes === null, opacity: axes === null ? 0.85 : 1 }));
      ball.matrixAutoUpdate = false;
      ball.frustumCulled = false;
      scene.add(ball);
      this.#balls.set(name, ball);
    }
    const [a, b, c] = axes ?? [[HANDLE_MM, 0, 0], [0, HANDLE_MM, 0], [0, 0, HANDLE_MM]];
    const [x, y, z] = centre;
    ball.matrix.set(a[0], b[0], c[0], x, a[1], b[1], c[1], y, a[2], b[2], c[2], z, 0, 0, 0, 1);
    return name;
  }

  /** @param {any} shape @param {readonly number[]} numbers */
  #setPoints(shape, numbers) {
    shape.visible = numbers.length > 0;
    if (!shape.visible) return;
    shape.geometry.dispose();
    shape.geometry = new three.BufferGeometry();
    shape.geometry.setAttribute("position", new three.BufferAttribute(new Float32Array(numbers), 3));
  }

  /** @param {number} count @param {Record<string, any>} arrays */
  #showPatches(count, arrays) {
    for (const old of this.patches.children) old.geometry.dispose();
    this.patches.clear();
    for (let n = 0; n < count; n++) {
      const geometry = new three.BufferGeometry();
      geometry.setAttribute("position", new three.BufferAttribute(arrays[`patch ${n} vertices`], 3));
      geometry.setAttribute("normal", new three.BufferAttribute(arrays[`patch ${n} normals`], 3));
      geometry.setIndex(new three.BufferAttribute(arrays[`patch ${n} triangles`], 1));
      const patch = new three.Mesh(geometry, this.#patchMaterial);
      patch.frustumCulled = false;
      this.patches.add(patch);
    }
  }

  #clipping = new three.Plane(new three.Vector3(), 1);
  #patchMaterial = new three.MeshLambertMaterial({ color: 0xf5deb3, side: three.DoubleSide, clippingPlanes: [this.#clipping] });
}
