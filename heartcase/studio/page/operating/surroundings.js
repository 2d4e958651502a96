/**
 * What is around the heart on the table, as simple shapes: skin and drape with an opening over it, a sternal retractor, cannulae.
 *
 * The opening lies in front of the heart, as large as it is; cannulae are where the case says. Nothing of it takes part in anything:
 * it is not pointed at, and pushes nothing.
 */

import * as three from "../vendor/three/three.module.min.js";

/** @typedef {import("./camera.js").Vector} Vector */
/** @typedef {{vessel: string, tip_mm: Vector, wall_mm: Vector, out: Vector, radius_mm: number}} Cannula */

const COLOURS = { drape: 0x3d7f86, skin: 0xd9a98c, steel: 0xc4ccd4, aorta: 0xb3362f, superior: 0x4a63b0, inferior: 0x4a63b0 };
/** How far in front of the heart the skin is, mm; and how far around it the drape goes, over the opening's half size. */
const FRONT_MM = 4;
const AROUND = 2.1;
const SKIN = 1.16;
/** How deep the body curves away towards the sides, over the drape's half width. */
const CURVE = 0.28;
const SEGMENTS = 96;
/** How far cannulae stand out before they turn to the front, over their radius; and how far in front of the skin they end, mm. */
const STRAIGHT = 3;
const END_MM = 40;

export class Surroundings {
  group = new three.Group();

  /** @param {any} scene */
  constructor(scene) {
    this.group.visible = false;
    scene.add(this.group);
  }

  /** @param {[Vector, Vector]} box around the heart, LPS mm @param {readonly Cannula[]} cannulae */
  setCase([low, high], cannulae) {
    for (const one of this.group.children) {
      one.geometry.dispose();
      one.material.dispose();
    }
    this.group.clear();
    const middle = [(low[0] + high[0]) / 2, (low[2] + high[2]) / 2];
    const half = [0.62 * (high[0] - low[0]), 0.62 * (high[2] - low[2])];
    const front = low[1] - FRONT_MM;
    this.#sheet(middle, half, front, 1, SKIN, COLOURS.skin);
    this.#sheet(middle, half, front, SKIN, AROUND, COLOURS.drape);
    this.#retractor(middle, half, front);
    for (const cannula of cannulae) this.#cannula(cannula, front);
  }

  /** @param {any} geometry @param {number} colour */
  #add(geometry, colour) {
    const mesh = new three.Mesh(geometry, new three.MeshLambertMaterial({ color: colour, side: three.DoubleSide }));
    mesh.frustumCulled = false;
    this.group.add(mesh);
  }

  /**
   * A sheet in front of the heart between two outlines, the inner an ellipse, the outer, where it is large, a rectangle with round corners.
   * @param {number[]} middle x, z @param {number[]} half of the opening @param {number} front @param {number} from @param {number} to over the half size @param {number} colour
   */
  #sheet(middle, half, front, from, to, colour) {
    const places = [];
    const numbers = [];
    for (let n = 0; n <= SEGMENTS; n++) {
      const angle = (2 * Math.PI * n) / SEGMENTS;
      for (const [size, power] of [[from, 2], [to, to > 1.5 ? 6 : 2]]) {
        const round = (Math.abs(Math.cos(angle)) ** power + Math.abs(Math.sin(angle)) ** power) ** (-1 / power);
        const [x, z] = [half[0] * size * round * Math.cos(angle), half[1] * size * round * Math.sin(angle)];
        const aside = x / (half[0] * AROUND);
        places.push(middle[0] + x, front + CURVE * half[0] * AROUND * aside * aside, middle[1] + z);
      }
      if (n > 0) numbers.push(2 * n - 2, 2 * n - 1, 2 * n, 2 * n, 2 * n - 1, 2 * n + 1);
    }
    const geometry = new three.BufferGeometry();
    geometry.setAttribute("position", new three.BufferAttribute(new Float32Array(places), 3));
    geometry.setIndex(numbers);
    geometry.computeVertexNormals();
    this.#add(geometry, colour);
  }

  /** Two blades along the opening's sides, with arms that end on a rack at the feet. @param {number[]} middle @param {number[]} half @param {number} front */
  #retractor(middle, half, front) {
    const [x, z] = middle;
    const at = 0.97 * half[0];
    const rack = z - 1.12 * half[1];
    for (const side of [-1, 1]) {
      this.#bar([x + side * at, front + 4, z], [3, 16, 0.7 * half[1]]);
      this.#bar([x + side * (at + 4), front - 8, z], [11, 3, 0.7 * half[1]]);
      this.#bar([x + side * (at + 6), front - 8, (z - 0.3 * half[1] + rack) / 2], [7, 5, z - 0.3 * half[1] - rack]);
    }
    this.#bar([x, front - 8, rack], [2 * at + 34, 6, 9]);
    this.#bar([x + at - 14, front - 13, rack], [14, 8, 14]);
  }

  /** @param {number[]} middle @param {number[]} size */
  #bar(middle, size) {
    const geometry = new three.BoxGeometry(...size);
    geometry.translate(...middle);
    this.#add(geometry, COLOURS.steel);
  }

  /** A tube from within the vessel straight out of it, and then to the front. @param {Cannula} cannula @param {number} front */
  #cannula({ vessel, tip_mm: tip, wall_mm: wall, out, radius_mm: radius }, front) {
    const start = new three.Vector3(...tip);
    const passes = new three.Vector3(...wall);
    const straight = passes.clone().addScaledVector(new three.Vector3(...out), STRAIGHT * radius);
    const end = straight.clone().addScaledVector(new three.Vector3(...out), 4 * radius);
    end.y = front - END_MM;
    const bend = straight.clone().lerp(end, 0.5).addScaledVector(new three.Vector3(...out), 2 * radius);
    const curve = new three.CatmullRomCurve3([start, passes, straight, bend, end]);
    this.#add(new three.TubeGeometry(curve, 48, radius, 20, false), COLOURS[/** @type {"aorta"} */ (vessel)]);
  }
}
