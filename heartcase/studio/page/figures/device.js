/** A haptic device at the server: started where one looks, seen where its tip is, with what the hand on it feels. */

import { figure, language, say } from "../shared/words.js";

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));
const EVERY_MS = 250;

export class Device {
  #isLed = false;
  #toldAt = -Infinity;
  /** @type {readonly string[]} */
  #names = [];

  /** @param {{ask: (request: Record<string, unknown> & {do: string}) => void, look: () => object}} does */
  constructor(does) {
    this.choice = /** @type {HTMLSelectElement} */ (find("device-name"));
    find("device-start").addEventListener("click", () => {
      if (this.#isLed) does.ask({ do: "device", name: null });
      else does.ask({ do: "device", name: this.choice.value, pointer: does.look() });
    });
    language.follow(() => this.setNames(this.#names));
  }

  /** @param {readonly string[]} names devices that there are */
  setNames(names) {
    const chosen = this.choice.value;
    this.#names = names;
    this.choice.replaceChildren(
      ...names.map((name) => new Option(name === "simulated" ? say("device_simulated") : name, name, false, name === chosen)),
    );
    this.#tell(null);
  }

  /** @param {Record<string, any>} header of a frame */
  show(header) {
    const device = header.device ?? null;
    const now = performance.now();
    if ((device !== null) === this.#isLed && now - this.#toldAt < EVERY_MS) return;
    this.#toldAt = now;
    this.#tell(device);
  }

  /** @param {Record<string, any> | null} device */
  #tell(device) {
    this.#isLed = device !== null;
    find("device-start").textContent = say(this.#isLed ? "device_stop" : "device_start");
    this.choice.disabled = this.#isLed;
    const words =
      device === null
        ? ""
        : say(device.holds === null ? "device_free" : "device_holds", {
            force: figure(Math.hypot(...device.force_n), 2), part: figure(100 * device.part, 0),
          });
    if (find("device-state").textContent !== words) find("device-state").textContent = words;
  }
}
