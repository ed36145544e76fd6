/** Runs in a page before its own scripts: when the first picture was drawn, since navigation began. */
const look = () => {
  const player = document.querySelector("swings-player")?.player;
  if (player?.shownFrame >= 0) window.firstPictureMs = performance.now();
  else requestAnimationFrame(look);
};
requestAnimationFrame(look);
