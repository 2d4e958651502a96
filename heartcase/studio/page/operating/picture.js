/** The picture: heart and instruments, seen by a camera, drawn when something is new. */

import * as three from "../vendor/three/three.module.min.js";
import { Caps } from "../section/caps.js";
import { CutPlane } from "../section/plane.js";
import { Camera, VIEW_ANGLE_DEG } from "./camera.js";
import { Detail } from "./detail.js";
import { Heart } from "./heart.js";
import { ToolsInScene } from "./tools_in_scene.js";

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
  #observer = new ResizeObserver(() => this.#resize());
  #isStale = true;
  #isWaiting = false;
  /** Part of the full width that is drawn, in pixels. */
  #part = 1;
  /** What tells that a picture is done. @type {WebGLSync | null} */
  #fence = null;

  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.isDrawnInSoftware = SOFTWARE.test(rendererName());
    const options = { antialias: !this.isDrawnInSoftware, alpha: true, stencil: true };
    const context = canvas.getContext("webgl2", options);
    if (context === null) throw new NoGraphics();
    this.renderer = new three.WebGLRenderer({ canvas, context, ...options });
    this.renderer.autoClear = false;
    this.scene = new three.Scene();
    this.over = new three.Scene();
    this.eye = new three.PerspectiveCamera(VIEW_ANGLE_DEG, 1, 1, 1000);
    this.heart = new Heart(this.scene);
    this.plane = new CutPlane();
    this.plane.listen(() => this.redraw());
    this.caps = new Caps(this.scene, this.heart, this.plane);
    this.tools = new ToolsInScene(this.scene, this.over);
    this.detail = new Detail(() => this.redraw(), this.isDrawnInSoftware);
    this.#observer.observe(/** @type {Element} */ (canvas.parentElement));
    this.#resize();
  }

  /** No more is drawn: give the graphics card back what it holds. */
  end() {
    this.#observer.disconnect();
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
    const { camera, eye } = this;
    eye.position.set(...camera.position);
    eye.up.set(...camera.up);
    eye.lookAt(...camera.target);
    eye.near = Math.max(0.05 * camera.distance, 0.5);
    eye.far = camera.distance + 4 * camera.size;
    eye.updateProjectionMatrix();
    this.caps.beforeDraw();
    this.renderer.clear();
    this.renderer.render(this.scene, eye);
    this.renderer.clearDepth();
    this.renderer.render(this.over, eye);
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

  #resize() {
    const { clientWidth, clientHeight } = /** @type {Element} */ (this.canvas.parentElement);
    this.camera.width = Math.max(clientWidth, 1);
    this.camera.height = Math.max(clientHeight, 1);
    this.eye.aspect = this.camera.width / this.camera.height;
    this.#size(this.#part);
    this.redraw();
  }

  /** @param {number} part of the picture's full width in pixels */
  #size(part) {
    this.#part = part;
    this.renderer.setPixelRatio(part * (this.isDrawnInSoftware ? 1 : Math.min(globalThis.devicePixelRatio ?? 1, FINEST)));
    this.renderer.setSize(this.camera.width, this.camera.height, false);
  }
}
