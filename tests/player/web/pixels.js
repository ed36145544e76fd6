/** Reads what the player has drawn, in the frame in which it was. */
(() => {
  const isSettled = (player) => player.asked === "waits" && player.sorted === null;

  const read = ({ gl }, { x, y, width, height }) => {
    const pixels = new Uint8Array(4 * width * height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(x, y, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    let text = "";
    for (let at = 0; at < pixels.length; at += 8192) {
      text += String.fromCharCode(...pixels.subarray(at, at + 8192));
    }
    return { widthPx: width, heightPx: height, pixels: btoa(text) };
  };

  /** The canvas, once its order is that of what is seen from where the camera is. */
  window.readCanvas = (player) =>
    new Promise((resolve) => {
      const look = () => {
        const { width, height } = player.canvas;
        if (isSettled(player)) resolve(read(player, { x: 0, y: 0, width, height }));
        else again();
      };
      const again = () => {
        player.moved();
        requestAnimationFrame(look); // after the player's own
      };
      requestAnimationFrame(again);
    });

  /** Each eye of the headset: its matrices column by column, and its picture. */
  window.readEyes = (player) =>
    new Promise((resolve) => {
      const { session, space, layer } = player.headset;
      const look = (ms, frame) => {
        if (!isSettled(player)) {
          session.requestAnimationFrame(look);
          return;
        }
        const { views } = frame.getViewerPose(space);
        const eyes = views.map((view) => ({
          projection: [...view.projectionMatrix],
          transform: [...view.transform.matrix],
          ...read(player, layer.getViewport(view)),
        }));
        resolve(eyes);
      };
      window.twoFrames(session).then(() => session.requestAnimationFrame(look));
    });

  /** The emulator takes what its device does with the next frame, and tells of it with that after. */
  window.twoFrames = (session) =>
    new Promise((resolve) => {
      session.requestAnimationFrame(() => session.requestAnimationFrame(resolve));
    });
})();
