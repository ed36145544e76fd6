import { fileUrl } from "./addresses.js";
import { fetchRange } from "./byteranges.js";
import { SourceError } from "./fetcher.js";

/**
 * The bytes of a file of the stream at `base`, from the manifest's folder or from the packed stream.
 * Rejects with a SourceError.
 * @param {import("./fetcher.js").Fetcher} fetcher
 * @param {string} base
 * @param {string} path
 * @param {import("./source.js").SourceStream["files"]} files
 * @param {number} mostBytes
 * @param {RequestInit} [init]
 */
export async function fileBytes(fetcher, base, path, files, mostBytes, init) {
  if (files === null) return fetcher.get(fileUrl(path, base), mostBytes, undefined, init);
  if (!Object.hasOwn(files, path)) throw new SourceError(`${base} holds no ${path}`);
  const { size } = files[path];
  if (!(size > 0 && size <= mostBytes))
    throw new SourceError(`${base}: ${path} has ${size} bytes, at most ${mostBytes}`);
  return (await fetchRange(fetcher, base, files[path], undefined, init)).bytes;
}
