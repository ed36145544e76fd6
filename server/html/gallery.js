/** Filters and sorts the cards of the front page; without scripts it shows them all. */
(() => {
  const form = /** @type {HTMLFormElement} */ (document.querySelector(".find"));
  const list = /** @type {HTMLUListElement} */ (document.querySelector(".streams"));
  const [input] = form.getElementsByTagName("input");
  const [select] = form.getElementsByTagName("select");
  const [count] = form.getElementsByTagName("output");
  const cards = /** @type {HTMLLIElement[]} */ ([...list.children]);
  const length = (/** @type {HTMLLIElement} */ card) => Number(card.dataset.seconds);

  /** @type {Record<string, (a: HTMLLIElement, b: HTMLLIElement) => number>} */
  const orders = {
    longest: (a, b) => length(b) - length(a),
    shortest: (a, b) => length(a) - length(b),
  };

  function filter() {
    const words = input.value.toLowerCase().split(/\s+/);
    for (const card of cards) {
      const text = (card.querySelector(".title")?.textContent ?? "").toLowerCase();
      card.hidden = !words.every((word) => text.includes(word));
    }
    const shown = cards.filter((card) => !card.hidden).length;
    count.textContent = input.value ? `${shown} of ${cards.length} streams` : "";
  }

  form.hidden = false;
  form.addEventListener("submit", (event) => event.preventDefault());
  input.addEventListener("input", filter);
  select.addEventListener("change", () => {
    // As the server sent them: live ones first, then by title.
    list.append(...(select.value in orders ? cards.toSorted(orders[select.value]) : cards));
  });
  filter(); // a browser may bring back what was typed before
})();
