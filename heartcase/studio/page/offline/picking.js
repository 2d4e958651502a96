/** What lies under the pointer, found by the graphics card: the heart drawn into one pixel whose colour is the place. */

import * as three from "../vendor/three/three.module.min.js";
import { PLACE_FRAGMENT, VERTEX } from "../operating/placing.js";

/** @typedef {import("../operating/picture.js").Picture} Picture */
/** @typedef {import("../operating/camera.js").Vector} Vector */

export class Picking {
  #target = new three.WebGLRenderTarget(1, 1, { type: three.FloatType, minFilter: three.NearestFilter, magFilter: three.NearestFilter, depthBuffer: true, stencilBuffer: true });
  #found = new Float32Array(4);

  /** @param {Picture} picture */
  constructor(picture) {
    this.picture = picture;
    this.material = new three.RawShaderMaterial({
      glslVersion: three.GLSL3,
      vertexShader: VERTEX,
      fragmentShader: PLACE_FRAGMENT,
      side: three.DoubleSide,
      uniforms: picture.heart.uniforms,
    });
  }

  /**
   * @param {number} x @param {number} y pixels from the picture's upper left corner
   * @returns {Vector | null} LPS mm; null beside the heart
   */
  at(x, y) {
    return this.seen(x, y)?.place ?? null;
  }

  /**
   * @param {number} x @param {number} y pixels from the picture's upper left corner
   * @returns {{place: Vector, structure: number} | null} place, LPS mm, and number of the structure; null beside the heart
   */
  seen(x, y) {
    const { picture } = this;
    const { renderer, eye, scene, camera, heart } = picture;
    if (heart.mesh === null) return null;
    picture.draw();
    eye.setViewOffset(camera.width, camera.height, Math.floor(x), Math.floor(y), 1, 1);
    const clear = renderer.getClearAlpha();
    renderer.setRenderTarget(this.#target);
    renderer.setClearAlpha(0);
    renderer.clear();
    scene.overrideMaterial = this.material;
    // what is not the heart is not hit
    const others = scene.children.filter((/** @type {any} */ one) => one !== heart.mesh && one.visible);
    for (const one of others) one.visible = false;
    renderer.render(scene, eye);
    for (const one of others) one.visible = true;
    scene.overrideMaterial = null;
    picture.caps.drawPlaces(renderer, scene, eye);
    renderer.readRenderTargetPixels(this.#target, 0, 0, 1, 1, this.#found);
    renderer.setRenderTarget(null);
    renderer.setClearAlpha(clear);
    eye.clearViewOffset();
    const [a, b, c, isHit] = this.#found;
    return isHit > 0.5 ? { place: [a, b, c], structure: Math.round(isHit) - 1 } : null;
  }
}
