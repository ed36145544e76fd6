/** Names that the code of `run` and `wait` may use. */
export const NAMES = `
  const element = document.querySelector("swings-player");
  const player = element?.player;
  const state = player?.state;
  const part = (selector) => element?.shadowRoot?.querySelector(selector);
`;
