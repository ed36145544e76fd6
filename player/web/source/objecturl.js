import { corrupt } from "../format/bytes/errors.js";
import { fileUrl } from "./addresses.js";
import { SourceError } from "./fetcher.js";

/**
 * The URL of an object. Throws a FormatError if it is not a URL, and a SourceError if its origin is not
 * the manifest's and `otherHosts` is false.
 * @param {string} base
 * @param {string} path as given by the manifest, possibly a whole URL
 * @param {boolean} otherHosts
 */
export function objectUrl(base, path, otherHosts) {
  const name = new URL("manifest.json", base).href;
  if (!URL.canParse(path, base))
    throw corrupt(`${name}: object_url gives ${path.slice(0, 200)}, which is not a URL`);
  const url = new URL(path, base);
  if (url.origin === new URL(base).origin) return fileUrl(path, base);
  if (!/^https?:$/.test(url.protocol))
    throw corrupt(`${name}: object_url gives ${url.href.slice(0, 200)}, which is not on the web`);
  if (!otherHosts) {
    throw new SourceError(
      `${name} leads to another host, ${url.origin.slice(0, 200)}; other-hosts, as an attribute of ` +
        "the player or other-hosts=1 in the address of its page, allows it",
    );
  }
  return url.href;
}
