/** Reads what the player has drawn, in the frame in which it was. */
(() => {
  const answer = (widthPx, heightPx, pixels) => {
    let text = "";
    for (let at = 0; at < pixels.length; at += 8192) {
      text += String.fromCharCode(...pixels.subarray(at, at + 8192));
    }
    return { widthPx, heightPx, pixels: btoa(text) };
  };

  /** A part of what WebGL draws to, the last row first. */
  const readPort = ({ gl }, { x, y, width, height }) => {
    const pixels = new Uint8Array(4 * width * height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(x, y, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    return answer(width, height, pixels);
  };

  /** What a canvas shows now, the last row first. */
  window.shownPixels = (canvas) => {
    const { width, height } = canvas;
    const copy = new OffscreenCanvas(width, height);
    const target = copy.getContext("2d", { willReadFrequently: true });
    target.setTransform(1, 0, 0, -1, 0, height);
    target.drawImage(canvas, 0, 0);
    return answer(width, height, target.getImageData(0, 0, width, height).data);
  };

  /** The canvas, once its order is that of what is seen from where the camera is. */
  window.readCanvas = (player) =>
    new Promise((resolve) => {
      const look = (nowMs) => {
        // Without a picture in this very frame the canvas is empty: the last one is with the browser.
        const isDrawn = player.view.drawnMs === nowMs;
        if (player.isSettled && isDrawn) resolve(window.shownPixels(player.canvas));
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
        if (!player.isSettled) {
          session.requestAnimationFrame(look);
          return;
        }
        const { views } = frame.getViewerPose(space);
        const eyes = views.map((view) => ({
          projection: [...view.projectionMatrix],
          transform: [...view.transform.matrix],
          ...readPort(player, layer.getViewport(view)),
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
