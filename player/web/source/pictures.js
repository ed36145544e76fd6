import { fileUrl } from "./addresses.js";

/** The pictures that a manifest names: the poster and the storyboard. */

/**
 * The URL of a picture of an open stream; null if there is none.
 * @param {import("../element/streamsession.js").StreamSession} session
 * @param {string} path as in the manifest @returns {Promise<string | null>}
 */
export async function pictureUrl({ base, files, source }, path) {
  const url = fileUrl(path.split("/").map(encodeURIComponent).join("/"), base);
  if (files === null && !source?.transformRequest) return url;
  const { fetchedPicture } = await import("./packedpicture.js");
  if (files === null) return fetchedPicture(url, path, source);
  return Object.hasOwn(files, path) ? fetchedPicture(base, path, source, files[path]) : null;
}
