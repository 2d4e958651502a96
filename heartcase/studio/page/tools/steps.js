/** Undo and redo, key after key: none is lost that is pressed before the answer to the one before, or to a stroke, is there. */

/** @typedef {import("../shared/studio.js").Studio} Studio */
/** @typedef {import("./brush.js").Brush} Brush */

export class Steps {
  /** Steps that wait for strokes to be sent and answered. @type {("undo" | "redo")[]} */
  #waiting = [];

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
    const { undoCount, redoCount } = this.studio;
    const [from, to] = what === "undo" ? [undoCount, redoCount] : [redoCount, undoCount];
    if (!this.studio.ready.value || from.value === 0) return;
    // Counted before the answer comes, which has the true numbers: the next key finds what it asks for.
    from.value -= 1;
    to.value += 1;
    this.ask({ do: what }).catch((error) => {
      from.value += 1;
      to.value -= 1;
      this.fault(error);
    });
  }
}
