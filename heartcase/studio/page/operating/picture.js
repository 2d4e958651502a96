/** The picture: heart, instruments and surroundings, seen by one camera or two, drawn when something is new. */

import { Caps } from "../section/caps.js";
import { CutPlane } from "../section/plane.js";
import { Slices } from "../section/slices.js";
import * as three from "../vendor/three/three.module.min.js";
import { Camera, VIEW_ANGLE_DEG } from "./camera.js";
import { Detail } from "./detail.js";
import { Heart } from "./heart.js";
import { ToolsInScene } from "./tools_in_scene.js";

/** A camera, and the element over the part of the canvas that it fills; null for all of it. */
/** @typedef {{camera: Camera, surface: HTMLElement | null}} View */

/** There is no WebGL 2 here. */
export class NoGraphics extends Error {}

const FINEST = 2;
const LOOK_MS = 2;
/** What renderers without a graphics card call themselves. */
const SOFTWARE = /llvmpipe|softpipe|swiftshader|microsoft basic render/i;

/** What draws here, by its own words. */
function rendererName() {
  const context = document.createElement("canvas").getContext("webgl2");
  if (context === null) throw new NoGraphics();
  const told = context.getExtension("WEBGL_debug_renderer_info");
  const name = String(context.getParameter(told ? told.UNMASKED_RENDERER_WEBGL : context.RENDERER));
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return name;
}

export class Picture {
  camera = new Camera();
  /** Pictures that were drawn so far. */
  count = 0;
  /** Called after each picture. @type {(() => void)[]} */
  drawn = [];
  /** All draw the same scene: what is on the graphics card is there once. @type {View[]} */
  views;
  #isStale = true;
  #isWaiting = false;
  #resizing = new ResizeObserver(() => this.resize());
  /** Part of the full width that is drawn, in pixels. */
  #part = 1;
  /** What tells that a picture is done. @type {WebGLSync | null} */
  #fence = null;

  /** @param {HTMLCanvasElement} canvas @param {HTMLElement | null} [surface] the element that the first camera fills; all of the canvas where left out */
  constructor(canvas, surface = null) {
    this.canvas = canvas;
    this.views = [{ camera: this.camera, surface }];
    this.isDrawnInSoftware = SOFTWARE.test(rendererName());
    const options = { antialias: !this.isDrawnInSoftware, alpha: true, stencil: true };
    const context = canvas.getContext("webgl2", options);
    if (context === null) throw new NoGraphics();
    this.renderer = new three.WebGLRenderer({ canvas, context, ...options });
    this.renderer.autoClear = false;
    this.renderer.localClippingEnabled = true;
    this.scene = new three.Scene();
    this.over = new three.Scene();
    this.eye = new three.PerspectiveCamera(VIEW_ANGLE_DEG, 1, 1, 1000);
    this.heart = new Heart(this.scene);
    this.plane = new CutPlane();
    this.plane.listen(() => this.redraw());
    this.caps = new Caps(this.scene, this.heart, this.plane);
    this.slices = new Slices(this.scene, this.caps);
    this.tools = new ToolsInScene(this.scene, this.over);
    this.detail = new Detail(() => this.redraw(), this.isDrawnInSoftware);
    for (const one of [canvas.parentElement, surface]) if (one !== null) this.#resizing.observe(one);
    this.resize();
  }

  /** Look from another place too. @param {HTMLElement} surface that it fills @returns {Camera} */
  addView(surface) {
    const camera = new Camera();
    this.views.push({ camera, surface });
    this.#resizing.observe(surface);
    this.resize();
    return camera;
  }

  /** No more is drawn: give the graphics card back what it holds. */
  end() {
    this.#resizing.disconnect();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }

  /** Draw before the next picture of the screen. */
  redraw() {
    this.#isStale = true;
    if (this.#isWaiting) return;
    this.#isWaiting = true;
    requestAnimationFrame(() => {
      this.#isWaiting = false;
      if (this.#isStale) this.draw();
    });
  }

  /** Draw before the next picture of the screen what moves: the heart, or the eye. */
  move() {
    this.detail.moved();
    this.redraw();
  }

  draw() {
    this.#isStale = false;
    const began = performance.now();
    const { level: wanted, part } = this.detail.step;
    const level = this.heart.showLevel(wanted, this.plane.isOn);
    if (part !== this.#part) this.#size(part);
    this.caps.beforeDraw();
    this.tools.clip(this.plane.equation);
    const shown = this.views.filter(({ surface }) => surface === null || !surface.hidden);
    this.renderer.setScissorTest(shown.length > 1);
    for (const view of shown) this.#drawView(view);
    // who looks for what lies under the pointer goes on from the first
    if (shown.length > 1) this.#aim(shown[0]);
    this.count += 1;
    for (const told of this.drawn) told();
    if (this.detail.isMoving) this.#timeWork(began, level);
  }

  /** Tell when the graphics card, or what stands for it, is done with what it was given. @param {number} began @param {number} level */
  #timeWork(began, level) {
    if (this.#fence !== null) return;
    const gl = this.renderer.getContext();
    const fence = (this.#fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0));
    if (fence === null) return;
    gl.flush();
    const look = () => {
      const state = gl.clientWaitSync(fence, 0, 0);
      if (state === gl.TIMEOUT_EXPIRED) {
        setTimeout(look, LOOK_MS);
        return;
      }
      this.#fence = null;
      gl.deleteSync(fence);
      if (state !== gl.WAIT_FAILED) this.detail.drew(performance.now() - began, level);
    };
    setTimeout(look, LOOK_MS);
  }

  /** @param {View} view */
  #drawView(view) {
    this.#aim(view);
    this.renderer.clear();
    this.renderer.render(this.scene, this.eye);
    this.renderer.clearDepth();
    this.renderer.render(this.over, this.eye);
  }

  /** @param {View} view */
  #aim({ camera, surface }) {
    const { eye, renderer } = this;
    eye.position.set(...camera.position);
    eye.up.set(...camera.up);
    eye.lookAt(...camera.target);
    eye.aspect = camera.width / camera.height;
    eye.near = Math.max(0.05 * camera.distance, 0.5);
    eye.far = camera.distance + 4 * camera.size;
    eye.updateProjectionMatrix();
    const { offsetLeft, offsetTop } = surface ?? { offsetLeft: 0, offsetTop: 0 };
    const below = /** @type {Element} */ (this.canvas.parentElement).clientHeight - offsetTop - camera.height;
    renderer.setViewport(offsetLeft, below, camera.width, camera.height);
    renderer.setScissor(offsetLeft, below, camera.width, camera.height);
  }

  resize() {
    const parent = /** @type {Element} */ (this.canvas.parentElement);
    for (const { camera, surface } of this.views) {
      const { clientWidth, clientHeight } = surface ?? parent;
      camera.width = Math.max(clientWidth, 1);
      camera.height = Math.max(clientHeight, 1);
    }
    this.#size(this.#part);
    this.redraw();
  }

  /** @param {number} part of the picture's full width in pixels */
  #size(part) {
    this.#part = part;
    this.renderer.setPixelRatio(part * (this.isDrawnInSoftware ? 1 : Math.min(globalThis.devicePixelRatio ?? 1, FINEST)));
    const { clientWidth, clientHeight } = /** @type {Element} */ (this.canvas.parentElement);
    this.renderer.setSize(Math.max(clientWidth, 1), Math.max(clientHeight, 1), false);
  }
}
