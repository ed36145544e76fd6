/** Shared by the drivers of browsers. */

/** Names that the code of `run` and `wait` may use. */
export const NAMES = `
  const element = document.querySelector("swings-player");
  const player = element?.player;
  const state = player?.state;
  const part = (selector) => element?.shadowRoot?.querySelector(selector);
`;

/**
 * Waits until the expression `code` is true; an error means that it is not yet.
 * @param {(code: string) => Promise<any>} evaluate in the page
 * @param {string} code
 * @param {number} timeoutS
 */
export async function waitFor(evaluate, code, timeoutS) {
  const text = `(() => {${NAMES} try { return Boolean(${code}) } catch (e) { return e.message } })()`;
  const endMs = performance.now() + 1000 * timeoutS;
  for (;;) {
    const found = await evaluate(text);
    if (found === true) return;
    if (performance.now() > endMs) throw new Error(`${found} after ${timeoutS} s: ${code}`);
    await new Promise((resolve) => setTimeout(resolve, 30));
  }
}
