/** Stitches that were tied before they had the tension that they were drawn with. */

/** `drawn_n` is what it is drawn with; null where its length is held. @typedef {{name: string, force_n: number, drawn_n: number | null, tied: boolean}} Stitch */

/** Part of the tension with which a stitch may be tied without a word, as `heartcase simulate` has it. */
const TIED_PART = 0.9;

/**
 * Of the stitches that were tied now, the one with the least part of the tension, N, that was asked for; null where all reached it.
 * @param {readonly Stitch[]} before @param {readonly Stitch[]} tied @returns {{name: string, force: number, asked: number} | null}
 */
export function tensionMissed(before, tied) {
  const drawn = new Map(before.filter((one) => !one.tied && one.drawn_n !== null).map((one) => [one.name, one]));
  let worst = null;
  for (const { name, force_n: now } of tied) {
    const was = drawn.get(name);
    if (was === undefined) continue;
    const [force, asked] = [Math.max(now, was.force_n), was.drawn_n ?? 0];
    if (force < TIED_PART * asked && (worst === null || force / asked < worst.force / worst.asked)) worst = { name, force, asked };
  }
  return worst;
}
