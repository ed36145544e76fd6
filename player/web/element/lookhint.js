const KEY = "swings-player-looked";
const FOR_MS = 6000;

/**
 * Tells a viewer, once in this browser, that one may look around: when the first picture moves, unless the
 * viewer has tried already.
 * @param {import("./webplayer.js").WebPlayer} player
 * @param {import("./hints.js").Hints} hints
 * @param {AbortSignal} signal ends the listening
 */
export function hintToLook(player, hints, signal) {
  if (wasSaid()) return;
  const ending = new AbortController();
  const end = () => {
    ending.abort();
    remember();
  };
  const options = { signal: AbortSignal.any([signal, ending.signal]) };
  player.canvas.addEventListener("pointerdown", end, options);
  player.addEventListener(
    "shown",
    () => {
      if (!player.isStill && !player.state.playing) return;
      end();
      const isTouch = matchMedia("(pointer: coarse)").matches;
      const ownsFinger = player.canvas.style.touchAction === "none";
      if (!isTouch) hints.say("Drag to look around", FOR_MS);
      else if (ownsFinger) hints.say("Drag with a finger to look around", FOR_MS);
      else hints.say("Drag with two fingers to look around", FOR_MS);
    },
    options,
  );
}

function wasSaid() {
  try {
    return localStorage.getItem(KEY) !== null;
  } catch (error) {
    console.info("swings: this page may not remember anything:", error);
    return true;
  }
}

function remember() {
  try {
    localStorage.setItem(KEY, "1");
  } catch (error) {
    console.info("swings: this browser does not remember that the hint was shown:", error);
  }
}
