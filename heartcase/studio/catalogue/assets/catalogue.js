/* What all pages share: the language of words and texts. */
"use strict";
(function () {
  const data = window.HeartcaseWords || { languages: [["en", "English"]], words: { en: {} } };
  const KEY = "heartcase-catalogue-language";
  const watchers = [];
  let chosen = "en";

  /** The language whose interface words stand for a language: its own, its main language's, or English. */
  function interfaceOf(language) {
    const main = language.split("-")[0];
    return data.words[language] ? language : data.words[main] ? main : "en";
  }

  /** A word of the interface, with {places} filled in. */
  function word(key, values) {
    const words = data.words[interfaceOf(chosen)];
    let text = words[key] !== undefined ? words[key] : (data.words.en || {})[key] || key;
    for (const name of Object.keys(values || {})) text = text.split("{" + name + "}").join(String(values[name]));
    return text;
  }

  /** The language in which a text is there: the chosen one, its main language, or English. */
  function available(languages) {
    const main = chosen.split("-")[0];
    return languages.includes(chosen) ? chosen : languages.includes(main) ? main : "en";
  }

  function number(value) {
    return Number(value).toLocaleString(interfaceOf(chosen));
  }

  function doubtfulWord(count) {
    return word(count === 0 ? "doubtful_0" : count === 1 ? "doubtful_1" : "doubtful_n", { count: count });
  }

  function translate(root) {
    for (const one of root.querySelectorAll("[data-word]")) {
      const { count, mm } = one.dataset;
      one.textContent = word(one.dataset.word, { count: count ? number(count) : "", mm: mm ? number(mm) : "" });
    }
    for (const one of root.querySelectorAll("[data-count-word=doubtful]")) {
      one.textContent = doubtfulWord(Number(one.dataset.count));
    }
    for (const one of root.querySelectorAll("[data-word-label]")) {
      one.setAttribute("aria-label", word(one.dataset.wordLabel));
    }
  }

  /** Of the texts that stand beside each other in several languages, show one. */
  function showTexts() {
    const parents = new Set();
    for (const one of document.querySelectorAll("[data-text]")) parents.add(one.parentElement);
    for (const parent of parents) {
      const texts = Array.from(parent.children).filter((one) => one.dataset.text);
      const language = available(texts.map((one) => one.dataset.text));
      for (const one of texts) one.hidden = one.dataset.text !== language;
    }
    for (const one of document.querySelectorAll("[data-only]")) {
      const languages = one.dataset.only.split(" ");
      one.hidden = !languages.includes(available(languages));
    }
  }

  function keepLanguage() {
    for (const link of document.querySelectorAll("a[data-keep]")) {
      const address = withLanguage(link.getAttribute("href"));
      // the viewer keeps a language of its own, which the one chosen here goes before
      const isPlain = link.dataset.keep === "always" && chosen === "en";
      link.setAttribute("href", isPlain ? address + "?lang=en" : address);
    }
  }

  /** An address of the catalogue that opens in the language chosen here. */
  function withLanguage(address) {
    return address.split("?")[0] + (chosen === "en" ? "" : "?lang=" + encodeURIComponent(chosen));
  }

  function use(language) {
    chosen = data.languages.some((one) => one[0] === language) ? language : "en";
    document.documentElement.lang = interfaceOf(chosen);
    translate(document);
    showTexts();
    keepLanguage();
    const heading = document.querySelector("#title > :not([hidden])");
    const own = document.body.dataset.titleWord;
    document.title = own ? word(own) : heading ? heading.textContent : document.title;
    for (const watcher of watchers) watcher();
  }

  /** What the reader chose before: in the address, in the browser's store, or in the browser's settings. */
  function remembered() {
    const asked = new URLSearchParams(window.location.search).get("lang");
    if (asked) return asked;
    try {
      const stored = window.localStorage.getItem(KEY);
      if (stored) return stored;
    } catch (error) {
      // Some browsers refuse a store to pages of a folder.
    }
    const offered = data.languages.map((one) => one[0]);
    for (const language of navigator.languages || []) {
      if (offered.includes(language)) return language;
      if (offered.includes(language.split("-")[0])) return language.split("-")[0];
    }
    return "en";
  }

  function start() {
    const select = document.getElementById("language");
    for (const [code, name] of data.languages) {
      const option = document.createElement("option");
      option.value = code;
      option.lang = code;
      option.textContent = name;
      select.append(option);
    }
    document.getElementById("languages").hidden = data.languages.length < 2;
    use(remembered());
    select.value = chosen;
    select.addEventListener("change", function () {
      use(select.value);
      try {
        window.localStorage.setItem(KEY, chosen);
      } catch (error) {
        // The addresses of the links carry it as well.
      }
    });
  }

  window.HeartcaseCatalogue = {
    word: word,
    number: number,
    available: available,
    doubtfulWord: doubtfulWord,
    withLanguage: withLanguage,
    interfaceLanguage: () => interfaceOf(chosen),
    watch: (watcher) => watchers.push(watcher),
  };
  start();
})();
