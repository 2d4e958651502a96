/** Undo and redo, key after key: none is lost that is pressed before the answer to the one before, or to a stroke, is there. */

/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("./brush.js").Brush} Brush */

export class Steps {
  /** Steps that wait for strokes to be sent and answered. @type {("undo" | "redo")[]} */
  #waiting = [];
  /** So many more can be undone than the server said last, and so many fewer redone: by steps that it has not answered. */
  #ahead = 0;
  #told = { undo: 0, redo: 0 };

  /**
   * @param {Studio} studio
   * @param {Brush} brush
   * @param {(request: {do: "undo" | "redo"}) => Promise<unknown>} ask
   * @param {(error: unknown) => void} fault
   */
  constructor(studio, brush, ask, fault) {
    this.studio = studio;
    this.brush = brush;
    this.ask = ask;
    this.fault = fault;
    studio.stroke.listen((stroke) => {
      if (stroke === null) queueMicrotask(() => this.#go());
    });
  }

  /** One step back or forth; nothing while the pointer draws. @param {"undo" | "redo"} what */
  take(what) {
    if (!this.studio.ready.value || this.brush.isDown) return;
    this.#waiting.push(what);
    this.#go();
  }

  /** What the server says can be undone and redone, after all that it has answered. @param {number} undo @param {number} redo */
  tell(undo, redo) {
    this.#told = { undo, redo };
    this.#count();
  }

  /** What waits is not wanted any more: its stroke was refused, or the connection is gone. */
  drop() {
    this.#waiting = [];
  }

  #go() {
    if (this.brush.isBusy) return;
    for (const what of this.#waiting.splice(0)) this.#send(what);
  }

  /** @param {"undo" | "redo"} what */
  #send(what) {
    const { ready, undoCount, redoCount } = this.studio;
    if (!ready.value || (what === "undo" ? undoCount : redoCount).value <= 0) return;
    const by = what === "undo" ? -1 : 1;
    this.#ahead += by;
    this.#count();
    this.ask({ do: what })
      .catch(this.fault)
      .finally(() => {
        this.#ahead -= by;
        this.#count();
      });
  }

  #count() {
    this.studio.undoCount.value = Math.max(this.#told.undo + this.#ahead, 0);
    this.studio.redoCount.value = Math.max(this.#told.redo - this.#ahead, 0);
  }
}
