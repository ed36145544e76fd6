/** @typedef {import("../source/transform.js").TransformRequest} TransformRequest */

/**
 * A port through which a worker asks the page how to send each of its requests, because a function cannot be posted;
 * undefined if the page changes none.
 * @param {TransformRequest | undefined} transformRequest
 * @param {(message: string) => void} fail called if the code for it cannot be loaded
 */
export function requestPort(transformRequest, fail) {
  if (!transformRequest) return undefined;
  const { port1, port2 } = new MessageChannel();
  import("../source/transform.js").then(
    (module) => module.answer(port1, transformRequest),
    (error) => fail(`The code for transformRequest could not be loaded: ${error}`),
  );
  return port2;
}
