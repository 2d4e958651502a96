/** A value that tells who listens when it becomes another one. */

/** @template T */
export class Signal {
  /** @type {T} */
  #value;
  /** @type {Set<(value: T) => void>} */
  #listeners = new Set();

  /** @param {T} value */
  constructor(value) {
    this.#value = value;
  }

  get value() {
    return this.#value;
  }

  set value(next) {
    if (Object.is(next, this.#value)) return;
    this.#value = next;
    for (const listener of this.#listeners) listener(next);
  }

  /**
   * Call `listener` on every change, and once now.
   * @param {(value: T) => void} listener
   */
  follow(listener) {
    this.#listeners.add(listener);
    listener(this.#value);
  }

  /**
   * Call `listener` on every change from now on.
   * @param {(value: T) => void} listener
   */
  listen(listener) {
    this.#listeners.add(listener);
  }
}
