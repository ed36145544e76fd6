/**
 * A worker of ours, wherever this page comes from: a page of another origin may not start one itself.
 * @param {URL} url of the module
 */
export function startWorker(url) {
  const script = `import ${JSON.stringify(url.href)};`;
  if (globalThis.origin === "null") {
    // A page from a file, or in a sandbox: Chromium runs no module of its blobs.
    const dataUrl = `data:text/javascript,${encodeURIComponent(script)}`;
    return new Worker(dataUrl, { type: "module" });
  }
  const blobUrl = URL.createObjectURL(new Blob([script], { type: "text/javascript" }));
  const worker = new Worker(blobUrl, { type: "module" });
  URL.revokeObjectURL(blobUrl);
  return worker;
}
