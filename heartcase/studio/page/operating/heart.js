/** The heart as three.js draws it: constant arrays of its vertices, and the nodes that they follow, on the graphics card. */

import * as three from "../vendor/three/three.module.min.js";
import { arraysOf } from "./messages.js";
import { Nodes, ROW } from "./nodes.js";
import { ATTRIBUTES, FRAGMENT, LINE_FRAGMENT, LINE_VERTEX, VERTEX } from "./placing.js";

/** @typedef {import("../shared/connection.js").Package} Package */
/** `pattern` tells structures apart without colour: 1 is level lines, 2 slanting ones. @typedef {{value: number, colour: string, pattern?: number}} Structure */
/** A coarser level, and its materials: of a surface of which all is seen, and of others. @typedef {{level: number, mesh: any, whole: any, open: any}} Coarse */

const STRUCTURES_MOST = 257;

/** @param {Float32Array} numbers four for each texel */
function texels(numbers) {
  const texture = new three.DataTexture(numbers, ROW, numbers.length / 4 / ROW, three.RGBAFormat, three.FloatType);
  texture.needsUpdate = true;
  return texture;
}

export class Heart {
  /** @type {Nodes | null} */
  nodes = null;
  /** Number of the topology that is shown. */
  topology = 0;
  /** Arrays of that topology, by their names in messages. @type {Record<string, any>} */
  arrays = {};
  /** Where the grid lies, of that topology. @type {{origin_mm: number[], direction: number[][], cell_mm: number} | null} */
  place = null;
  /** The finest surface. @type {any} */
  mesh = null;
  /** What is shown of it and the coarser ones. @type {any} */
  shown = null;
  /** Coarser ones, from finer to coarser. @type {Coarse[]} */
  coarse = [];
  #isWhole = true;
  /** Counts cases: a map that was decoded for an earlier one is not shown. */
  #mapOf = 0;
  #colours = new Uint8Array(4 * STRUCTURES_MOST);

  /** @param {any} scene */
  constructor(scene) {
    this.scene = scene;
    const palette = new three.DataTexture(this.#colours, STRUCTURES_MOST, 1, three.RGBAFormat, three.UnsignedByteType);
    const stretch = new three.DataTexture(new Uint8Array(1024), 256, 1, three.RGBAFormat, three.UnsignedByteType);
    stretch.minFilter = stretch.magFilter = three.LinearFilter;
    this.material = new three.RawShaderMaterial({
      glslVersion: three.GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      side: three.DoubleSide,
      uniforms: {
        displacements: { value: null },
        nodeNormals: { value: null },
        direction: { value: new three.Matrix3() },
        cellMm: { value: 1 },
        palette: { value: palette },
        stretchColours: { value: stretch },
        showsStretch: { value: false },
        cutPlane: { value: new three.Vector4(0, 0, 0, 1) },
        normalMap: { value: palette },
        hasMap: { value: false },
      },
    });
  }

  /** @param {Record<string, any>} uniforms */
  #lineMaterial(uniforms) {
    return new three.RawShaderMaterial({ glslVersion: three.GLSL3, vertexShader: LINE_VERTEX, fragmentShader: LINE_FRAGMENT, uniforms });
  }

  get uniforms() {
    return this.material.uniforms;
  }

  /** @param {readonly Structure[]} structures @param {ReadonlySet<number>} hidden */
  paint(structures, hidden) {
    for (const { value, colour, pattern = 0 } of structures) {
      if (value >= STRUCTURES_MOST) continue;
      const rgb = Number.parseInt(colour.slice(1), 16);
      const isShown = hidden.has(value) ? 0 : 255 - 40 * pattern;
      this.#colours.set([rgb >> 16, (rgb >> 8) & 255, rgb & 255, isShown], 4 * value);
    }
    this.uniforms.palette.value.needsUpdate = true;
    this.#isWhole = hidden.size === 0;
  }

  /** @param {readonly (readonly number[])[]} colours red, green, blue of 256 stretches */
  paintStretch(colours) {
    const texture = this.uniforms.stretchColours.value;
    colours.forEach((colour, n) => texture.image.data.set([...colour, 255], 4 * n));
    texture.needsUpdate = true;
  }

  /**
   * Take the normal map's picture: as it is, without colours being turned into others.
   * @param {Uint8Array<ArrayBuffer>} png
   */
  async takeNormalMap(png) {
    const mapOf = this.#mapOf;
    const options = /** @type {const} */ ({ colorSpaceConversion: "none", premultiplyAlpha: "none" });
    const picture = await createImageBitmap(new Blob([png], { type: "image/png" }), options);
    if (mapOf !== this.#mapOf) {
      picture.close();
      return;
    }
    this.#disposeMap();
    const texture = new three.Texture(picture);
    texture.flipY = false;
    texture.generateMipmaps = true;
    texture.minFilter = three.LinearMipmapLinearFilter;
    texture.anisotropy = 4;
    texture.needsUpdate = true;
    this.uniforms.normalMap.value = texture;
    this.uniforms.hasMap.value = true;
  }

  /** Another case may have no map: one that has sends its own. */
  forgetNormalMap() {
    this.#mapOf += 1;
    this.#disposeMap();
  }

  #disposeMap() {
    const { normalMap, hasMap } = this.uniforms;
    if (!hasMap.value) return;
    normalMap.value.dispose();
    normalMap.value.image.close();
    normalMap.value = this.uniforms.palette.value;
    hasMap.value = false;
  }

  /** @param {Package} message */
  takeTopology(message) {
    const arrays = arraysOf(message);
    const { header } = message;
    this.nodes = new Nodes(header.node_count, springsOf(arrays), this.nodes);
    this.topology = header.topology;
    this.arrays = arrays;
    this.place = { origin_mm: header.origin_mm, direction: header.direction, cell_mm: header.cell_mm };
    for (const name of ["displacements", "nodeNormals"]) this.uniforms[name].value?.dispose();
    this.uniforms.displacements.value = texels(this.nodes.displacement);
    this.uniforms.nodeNormals.value = texels(this.nodes.normals);
    this.uniforms.direction.value.set(...header.direction.flat());
    this.uniforms.cellMm.value = header.cell_mm;
    this.#remove();
    this.mesh = this.shown = this.#meshOf(arrays, this.material, header.cut_faces);
  }

  /** A coarser level of detail of the topology that is shown. @param {Package} message */
  takeCoarse(message) {
    const { header } = message;
    if (header.topology !== this.topology || this.nodes === null) return;
    const arrays = arraysOf(message);
    const nodeNormals = { value: texels(this.nodes.follow(springsOf(arrays)).normals) };
    const [whole, open] = [{ PLAIN: "", WHOLE: "" }, { PLAIN: "" }].map((defines) => {
      const material = this.material.clone();
      // what is common stays common
      Object.assign(material.uniforms, this.uniforms, { nodeNormals });
      material.defines = defines;
      return material;
    });
    // the inner sides of a closed surface are not seen
    whole.side = three.FrontSide;
    const mesh = this.#meshOf(arrays, open, header.cut_faces);
    mesh.visible = false;
    this.coarse.push({ level: header.level, mesh, whole, open });
  }

  /**
   * Show the surface at a level of detail, or at the nearest finer one that is there.
   * @param {number} level 0 is the finest
   * @param {boolean} isCutOpen whether a plane shows the inner sides of walls
   * @returns {number} the level that is shown
   */
  showLevel(level, isCutOpen) {
    const found = this.coarse.filter((one) => one.level <= level).at(-1);
    const shown = (this.shown = found?.mesh ?? this.mesh);
    for (const mesh of [this.mesh, ...this.coarse.map((one) => one.mesh)]) {
      if (mesh !== null) mesh.visible = mesh === shown;
    }
    const isWhole = this.#isWhole && !isCutOpen;
    for (const one of this.coarse) one.mesh.material = isWhole ? one.whole : one.open;
    return found?.level ?? 0;
  }

  /** @param {Record<string, any>} arrays @param {any} material @param {number} cutFaces */
  #meshOf(arrays, material, cutFaces) {
    const geometry = new three.BufferGeometry();
    for (const [attribute, name, size, isWhole] of ATTRIBUTES) {
      if (arrays[name] === undefined) continue;
      const numbers = isWhole ? arrays[name] : new Float32Array(arrays[name]);
      geometry.setAttribute(attribute, new three.BufferAttribute(numbers, size));
    }
    geometry.setIndex(new three.BufferAttribute(arrays.triangles, 1));
    const mesh = new three.Mesh(geometry, material);
    mesh.frustumCulled = false;
    this.scene.add(mesh);
    this.#addLips(mesh, arrays, cutFaces);
    return mesh;
  }

  /**
   * Where the skin is cut, as a line: an incision that lies closed is seen by it.
   * @param {any} mesh @param {Record<string, any>} arrays @param {number} cutFaces
   */
  #addLips(mesh, arrays, cutFaces) {
    const edges = lipEdges(arrays, cutFaces);
    if (edges.length === 0) return;
    const lines = new three.BufferGeometry();
    for (const [name, attribute] of Object.entries(mesh.geometry.attributes)) lines.setAttribute(name, attribute);
    lines.setIndex(new three.BufferAttribute(Uint32Array.from(edges), 1));
    const lips = new three.LineSegments(lines, this.#lineMaterial(mesh.material.uniforms));
    lips.frustumCulled = false;
    mesh.add(lips);
  }

  /**
   * @param {Package} message
   * @param {Record<string, any>} arrays
   * @returns {boolean} whether anything of the heart is new
   */
  takeFrame({ header }, arrays) {
    if (this.nodes === null || header.topology !== this.topology) throw new Error("a frame of another heart");
    this.nodes.take(arrays.blocks, arrays.steps, header.scale, header.block_nodes);
    if (arrays.stretch) this.nodes.takeStretch(arrays.stretch);
    if (arrays.blocks.length === 0 && !arrays.stretch) return false;
    this.uniforms.displacements.value.needsUpdate = true;
    this.uniforms.nodeNormals.value.needsUpdate = true;
    for (const one of this.coarse) one.open.uniforms.nodeNormals.value.needsUpdate = true;
    return true;
  }

  #remove() {
    for (const mesh of [this.mesh, ...this.coarse.map((one) => one.mesh)]) {
      if (mesh === null) continue;
      this.scene.remove(mesh);
      mesh.geometry.dispose();
      for (const lips of mesh.children) {
        lips.geometry.dispose();
        lips.material.dispose();
      }
    }
    for (const { whole, open } of this.coarse) {
      open.uniforms.nodeNormals.value.dispose();
      whole.dispose();
      open.dispose();
    }
    this.coarse = [];
  }
}

/** @param {Record<string, any>} arrays of a surface */
function springsOf({ normal_nodes: nodes, spring_first: first, spring_neighbours: neighbours, spring_offset: offset }) {
  return { nodes, first, neighbours, offset };
}


/**
 * Edges of the skin at which cut faces begin, two vertices each. Cut faces have vertices of their own there, at the same places.
 * @param {Record<string, any>} arrays of a topology
 * @param {number} cutFaces number of that structure
 * @returns {number[]}
 */
export function lipEdges({ triangles, structure, rest_mm: rest }, cutFaces) {
  /** Number of each place at which a cut face has a corner. @type {Map<string, number>} */
  const places = new Map();
  /** @param {number} vertex */
  const name = (vertex) => `${rest[3 * vertex]},${rest[3 * vertex + 1]},${rest[3 * vertex + 2]}`;
  const numbers = new Int32Array(structure.length).fill(-1);
  for (let vertex = 0; vertex < structure.length; vertex++) {
    if (structure[vertex] !== cutFaces) continue;
    const place = name(vertex);
    const number = places.get(place) ?? places.size;
    places.set(place, number);
    numbers[vertex] = number;
  }
  /** @type {number[]} */
  const found = [];
  if (places.size === 0) return found;
  for (let vertex = 0; vertex < structure.length; vertex++) {
    if (structure[vertex] !== cutFaces) numbers[vertex] = places.get(name(vertex)) ?? -1;
  }
  /** @param {number} a @param {number} b */
  const key = (a, b) => Math.min(numbers[a], numbers[b]) * places.size + Math.max(numbers[a], numbers[b]);
  const ofFaces = new Set();
  for (const isFace of [true, false]) {
    for (let at = 0; at < triangles.length; at += 3) {
      if ((structure[triangles[at]] === cutFaces) !== isFace) continue;
      for (let n = 0; n < 3; n++) {
        const [a, b] = [triangles[at + n], triangles[at + ((n + 1) % 3)]];
        if (numbers[a] < 0 || numbers[b] < 0) continue;
        if (isFace) ofFaces.add(key(a, b));
        else if (ofFaces.has(key(a, b))) found.push(a, b);
      }
    }
  }
  return found;
}
