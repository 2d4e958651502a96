/** Colours of structures: their own, by the blood that they hold, or safe for any colour vision; one of them alone where it is pointed at. */

import * as three from "../vendor/three/three.module.min.js";
import { FRAGMENT, VERTEX } from "../operating/placing.js";
import { element } from "../shared/elements.js";
import { isWord, say } from "../shared/words.js";

/** @typedef {import("../operating/heart.js").Heart} Heart */
/** @typedef {"colour" | "oxygen" | "safe"} Mode */
/** @typedef {{value: number, name: string, part: string, colour: string, oxygen: string, safe: string, blood: string}} Look */
/** @typedef {import("../operating/panel.js").Structure} Structure */

const MODES = /** @type {const} */ (["colour", "oxygen", "safe"]);
/** Patterns that tell blood without colour: level lines, slanting lines. @type {Record<string, number>} */
const PATTERNS = { poor: 1, mixed: 2 };
/** What the others keep of their colour beside the one that is pointed at. */
const KEPT = 0.2;
const GREY = 0.8 * 210;
const NUMBERS = 257;

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

/** @param {string} colour #rrggbb */
function greyed(colour) {
  const parts = [1, 3, 5].map((at) => Math.round(GREY + KEPT * Number.parseInt(colour.slice(at, at + 2), 16)));
  return `#${parts.map((part) => part.toString(16).padStart(2, "0")).join("")}`;
}

export class Colouring {
  /** @type {Mode} */
  mode = "colour";
  /** The structure that is pointed at in the list. @type {number | null} */
  lit = null;

  /**
   * @param {readonly Look[]} looks @param {readonly Look[]} inside of tissue that a cut alone shows
   * @param {Record<string, any>} oxygen @param {() => void} changed
   */
  constructor(looks, inside, oxygen, changed) {
    this.looks = looks;
    this.inside = inside;
    this.oxygen = oxygen;
    for (const mode of MODES) {
      const box = /** @type {HTMLInputElement} */ (find(`colours-${mode}`));
      box.addEventListener("change", () => {
        this.mode = mode;
        this.build();
        changed();
      });
    }
  }

  /** What the list shows. @returns {Structure[]} */
  listed() {
    return this.looks.map((one) => this.#shown(one));
  }

  /** What the heart is painted with. @returns {Structure[]} */
  painted() {
    return [...this.looks, ...this.inside].map((one) => {
      const shown = this.#shown(one);
      return this.lit === null ? shown : { ...shown, colour: greyed(shown.colour), pattern: 0 };
    });
  }

  /** @param {number} value @returns {Structure | undefined} */
  of(value) {
    const found = [...this.looks, ...this.inside].find((one) => one.value === value);
    return found && this.#shown(found);
  }

  /** @param {Look} one @returns {Structure} */
  #shown(one) {
    const word = `offline_part_${one.part}`;
    return {
      value: one.value, name: one.name, colour: one[this.mode], pattern: this.mode === "oxygen" ? (PATTERNS[one.blood] ?? 0) : 0,
      ...(one.name === "" && isWord(word) ? { word } : {}),
    };
  }

  /** Words of what the colours mean. */
  build() {
    find("colours-note").textContent = say(/** @type {const} */ (`offline_${this.mode}_note`));
    const isOxygen = this.mode === "oxygen";
    for (const id of ["blood-kinds", "blood-from"]) find(id).hidden = !isOxygen;
    if (!isOxygen) return;
    const there = new Set(this.looks.map(({ blood }) => blood));
    find("blood-kinds").replaceChildren(
      ...Object.entries(this.oxygen.colours)
        .filter(([kind]) => there.has(kind))
        .map(([kind, colour]) => {
          const row = element("li");
          const chip = element("span", "chip");
          chip.style.background = /** @type {string} */ (colour);
          row.append(chip, element("span", "", say(/** @type {any} */ (`offline_blood_${kind}`))));
          return row;
        }),
    );
    const joined = this.oxygen.joined.map((/** @type {string[]} */ pair) => pair.join(" – ")).join("; ");
    const from = say(this.oxygen.is_from_openings ? "offline_from_openings" : "offline_by_kind");
    find("blood-from").textContent = joined ? `${from} ${say("offline_joined")} ${joined}` : from;
  }
}

/** One structure alone, drawn over all else: it is seen whole, also where something lies before it. */
export class Lit {
  #colours = new Uint8Array(4 * NUMBERS);
  /** @type {any} */
  #mesh = null;

  /** @param {any} over scene that is drawn over all else @param {Heart} heart */
  constructor(over, heart) {
    this.over = over;
    this.heart = heart;
    const palette = new three.DataTexture(this.#colours, NUMBERS, 1, three.RGBAFormat, three.UnsignedByteType);
    this.palette = palette;
    this.material = new three.RawShaderMaterial({
      glslVersion: three.GLSL3, vertexShader: VERTEX, fragmentShader: FRAGMENT, side: three.DoubleSide,
      uniforms: { ...heart.uniforms, palette: { value: palette } },
    });
  }

  /** @param {Structure | undefined} structure */
  show(structure) {
    if (this.#mesh) this.over.remove(this.#mesh);
    this.#mesh = null;
    if (structure === undefined || structure.value >= NUMBERS || this.heart.mesh === null) return;
    const rgb = Number.parseInt(structure.colour.slice(1), 16);
    this.#colours.fill(0);
    this.#colours.set([rgb >> 16, (rgb >> 8) & 255, rgb & 255, 255 - 40 * (structure.pattern ?? 0)], 4 * structure.value);
    this.palette.needsUpdate = true;
    this.#mesh = new three.Mesh(this.heart.mesh.geometry, this.material);
    this.#mesh.frustumCulled = false;
    this.over.add(this.#mesh);
  }
}
