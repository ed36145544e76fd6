/** Maximum number of players out of view that keep their workers and so can resume at once. */
const MOST_WAITING = 4;

/**
 * The page's players out of view, the longest unseen first.
 * @type {Set<{ park: () => void }>}
 */
const waiting = new Set();

/**
 * Lets a player that is out of view keep its resources, and parks the longest unseen player if there
 * are too many.
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

/** @param {{ park: () => void }} player one that is in view again, or has ended */
export function stopWaiting(player) {
  waiting.delete(player);
}
