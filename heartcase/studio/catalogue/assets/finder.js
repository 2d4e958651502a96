/* The index: cards of the cases that fit what is searched for, some at a time. */
"use strict";
(function () {
  const BATCH = 48;

  /** Text as it is compared: without case and accents. */
  function plain(text) {
    return text.normalize("NFD").replace(/[\u0300-\u036f]/g, "").toLowerCase();
  }

  /** All that a case can be found by. */
  function haystack(card) {
    const parts = [card.name, card.segmental || "", ...Object.values(card.titles)];
    for (const one of card.diagnoses) parts.push(one.name, ...(one.more || []), ...(one.codes || []));
    return plain(parts.join("\n"));
  }

  /** Whether a case fits: every word is found in it, and it has the diagnosis and the origin. */
  function fits(card, wanted) {
    return (
      wanted.words.every((word) => card.haystack.includes(word)) &&
      (!wanted.diagnosis || card.diagnoses.some((one) => plain(one.name) === wanted.diagnosis)) &&
      (!wanted.origin || card.origin === wanted.origin) &&
      (!wanted.clean || card.doubtful === 0)
    );
  }

  const pure = { plain: plain, haystack: haystack, fits: fits };
  if (typeof document === "undefined") {
    module.exports = pure;
    return;
  }

  const catalogue = window.HeartcaseCatalogue;
  const field = (name) => document.getElementById(name);
  let cards = [];
  let shown = [];
  let drawn = 0;

  function element(tag, values, ...children) {
    const made = document.createElement(tag);
    for (const name of Object.keys(values)) made.setAttribute(name, values[name]);
    made.append(...children);
    return made;
  }

  function titleOf(card) {
    return card.titles[catalogue.available(Object.keys(card.titles))];
  }

  function cardElement(card) {
    const name = encodeURIComponent(card.name);
    const language = catalogue.available(Object.keys(card.titles));
    const link = element("a", { href: catalogue.withLanguage("cases/" + name + ".html"), lang: language, dir: "auto" }, card.titles[language]);
    const item = element("li", { class: "card" });
    if (card.picture) {
      const picture = { src: "pictures/" + name + ".small.webp", alt: "", width: 320, height: 240, loading: "lazy", decoding: "async" };
      item.append(element("img", picture));
    } else {
      item.append(element("div", { class: "blank", "aria-hidden": "true" }));
    }
    const badges = element("ul", { class: "badges" });
    badges.append(element("li", { class: "badge origin-" + card.origin }, catalogue.word(card.origin)));
    badges.append(element("li", { class: "badge " + (card.doubtful ? "look" : "good") }, catalogue.doubtfulWord(card.doubtful)));
    if (card.p99 !== null) badges.append(element("li", { class: "badge" }, catalogue.word("surface_badge", { mm: catalogue.number(card.p99) })));
    badges.append(element("li", { class: "badge" }, catalogue.word("nodes_badge", { count: catalogue.number(card.nodes) })));
    const diagnoses = element("p", { class: "diagnoses", lang: "en" }, card.diagnoses.map((one) => one.name).join("; "));
    item.append(element("div", { class: "words" }, element("h3", {}, link), diagnoses, badges));
    return item;
  }

  function drawMore() {
    const next = shown.slice(drawn, drawn + BATCH);
    field("cards").append(...next.map(cardElement));
    drawn += next.length;
    const left = shown.length - drawn;
    field("more").hidden = left === 0;
    field("more").textContent = catalogue.word("more", { count: Math.min(left, BATCH) });
  }

  function wanted() {
    return {
      words: plain(field("search").value).split(/\s+/).filter(Boolean),
      diagnosis: field("diagnosis").value,
      origin: field("origin").value,
      clean: field("clean").checked,
    };
  }

  function draw() {
    const what = wanted();
    shown = cards.filter((card) => fits(card, what));
    drawn = 0;
    field("cards").textContent = "";
    drawMore();
    const found = catalogue.word("found", { count: catalogue.number(shown.length), total: catalogue.number(cards.length) });
    field("count").textContent = shown.length ? found : found + ". " + catalogue.word("none");
  }

  function sort() {
    const compare = new Intl.Collator(catalogue.interfaceLanguage(), { numeric: true }).compare;
    cards.sort((one, other) => compare(titleOf(one), titleOf(other)) || compare(one.name, other.name));
  }

  function fillDiagnoses() {
    const names = new Map();
    for (const card of cards) {
      for (const key of new Set(card.diagnoses.map((one) => plain(one.name)))) {
        const name = card.diagnoses.find((one) => plain(one.name) === key).name;
        names.set(key, { name: (names.get(key) || { name: name }).name, count: (names.get(key) || { count: 0 }).count + 1 });
      }
    }
    const ordered = Array.from(names).sort((one, other) => one[1].name.localeCompare(other[1].name, "en"));
    for (const [key, one] of ordered) {
      field("diagnosis").append(element("option", { value: key, lang: "en" }, one.name + " (" + one.count + ")"));
    }
  }

  function start(data) {
    cards = data;
    for (const card of cards) card.haystack = haystack(card);
    sort();
    fillDiagnoses();
    field("finder").hidden = false;
    let waiting = 0;
    field("search").addEventListener("input", function () {
      window.clearTimeout(waiting);
      waiting = window.setTimeout(draw, 120);
    });
    for (const name of ["diagnosis", "origin", "clean"]) field(name).addEventListener("change", draw);
    field("filters").addEventListener("submit", (event) => event.preventDefault());
    field("filters").addEventListener("reset", () => window.setTimeout(draw, 0));
    field("more").addEventListener("click", function () {
      const first = drawn;
      drawMore();
      field("cards").children[first].querySelector("a").focus();
    });
    catalogue.watch(function () {
      sort();
      draw();
    });
    draw();
    // A browser fills in again what was searched for, after the scripts ran.
    window.addEventListener("pageshow", draw);
  }

  window.HeartcaseIndex = { register: start };
})();
