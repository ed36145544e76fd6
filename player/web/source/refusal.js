/**
 * Why a host that is reachable cannot be read, as a sentence; null if there is no such reason. To a page, such a host
 * looks like a missing network.
 * @param {string} url
 */
export async function refusalOf(url) {
  const ask = (/** @type {RequestInit} */ how) =>
    fetch(url, { method: "HEAD", ...how }).catch(() => null); // no answer
  const { origin } = new URL(url);
  if (origin !== globalThis.origin && (await ask({ mode: "no-cors" })))
    return (
      `${origin} answers, but does not let pages of other hosts read ${url}; ` +
      "configure that host to send the header Access-Control-Allow-Origin (docs/EMBED.md)"
    );
  if ((await ask({ redirect: "manual" }))?.type === "opaqueredirect")
    return `${url} leads to an address that cannot be reached, or back to itself`;
  return null;
}
