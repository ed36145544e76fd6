/** The bytes break a rule of codec/FORMAT.md, or this reader does not know their meaning. */
export class FormatError extends Error {
  /**
   * @param {"corrupt" | "unsupported"} kind
   * @param {string} message
   */
  constructor(kind, message) {
    super(message);
    this.name = "FormatError";
    this.kind = kind;
  }
}

/** @param {string} message */
export function corrupt(message) {
  return new FormatError("corrupt", message);
}

/** @param {string} message */
export function unsupported(message) {
  return new FormatError("unsupported", message);
}
