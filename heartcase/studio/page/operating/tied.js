/** Stitches that were tied before they had the tension that they were drawn with. */

/** `drawn_n` is what it is drawn with; null where its length is held. @typedef {{name: string, force_n: number, drawn_n: number | null, tied: boolean}} Stitch */

/** Part of the tension with which a stitch may be tied without a word, as `heartcase simulate` has it. */
const TIED_PART = 0.9;

/**
 * The tension, N, of those that were tied now, and the higher one that was asked for; null where it was reached.
 * @param {readonly Stitch[]} before @param {readonly Stitch[]} tied @returns {{force: number, asked: number} | null}
 */
export function tensionMissed(before, tied) {
  const drawn = new Map(before.filter((one) => !one.tied && one.drawn_n !== null).map((one) => [one.name, one]));
  let [force, asked] = [0, 0];
  for (const { name, force_n: now } of tied) {
    const was = drawn.get(name);
    if (was === undefined) continue;
    force = Math.max(force, now, was.force_n);
    asked = Math.max(asked, was.drawn_n ?? 0);
  }
  return force < TIED_PART * asked ? { force, asked } : null;
}
