/** Players out of sight that keep their workers, and go on at once when they are back in view. */
const MOST_WAITING = 4;

/**
 * The page's players out of view, the longest unseen first.
 * @type {Set<{ park: () => void }>}
 */
const waiting = new Set();

/**
 * Lets a player that is out of sight keep what it has, and parks the longest unseen one if there are
 * too many of them.
 * @param {{ park: () => void }} player
 */
export function keepWaiting(player) {
  waiting.delete(player);
  waiting.add(player);
  for (const longest of waiting) {
    if (waiting.size <= MOST_WAITING) break;
    waiting.delete(longest);
    longest.park();
  }
}

/** @param {{ park: () => void }} player that is seen, or has ended */
export function stopWaiting(player) {
  waiting.delete(player);
}
