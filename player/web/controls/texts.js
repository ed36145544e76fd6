/**
 * What viewers read, in their language. The code has the English texts; a table has each of them in another
 * language, and is loaded only for viewers of that language.
 */

/** @typedef {Record<string, string>} Table by the English text */

/** @typedef {(text: string, values?: Record<string, string>) => string} Translate of a text with `{names}` of values */

/** @type {Record<string, () => Promise<{ default: Table }>>} */
const TABLES = {
  de: () => import("./texts/de.js"),
  fr: () => import("./texts/fr.js"),
};

/**
 * The language for an element, as HTML has it: of its attribute `lang`, or of the nearest element around it, or else
 * of the browser.
 * @param {Element} element
 */
function languageOf(element) {
  const around = /** @type {HTMLElement | null} */ (element.closest("[lang]"));
  return (around?.lang || navigator.language || "en").split("-")[0].toLowerCase();
}

/** @param {Table} table @returns {Translate} */
function translating(table) {
  return (text, values = {}) =>
    (table[text] ?? text).replace(/\{(\w+)\}/g, (_, /** @type {string} */ name) => values[name]);
}

/**
 * Translates for an element; to English if there is no table of its language, or if that cannot be loaded.
 * @param {Element} element @returns {Promise<{ t: Translate, language: string }>}
 */
export async function translatorOf(element) {
  const language = languageOf(element);
  try {
    const table = Object.hasOwn(TABLES, language) ? (await TABLES[language]()).default : null;
    if (table !== null) return { t: translating(table), language };
  } catch (error) {
    console.warn(`swings: the texts in the language ${language} could not be loaded:`, error);
  }
  return { t: translating({}), language: "en" };
}
