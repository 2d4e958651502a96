/** A draft that is dropped on the page, or chosen: how it is to be taken, and what is wrong with it. */

import { figure, language, say } from "../../shared/words.js";
import { element, problemList } from "../../shared/elements.js";

/** @typedef {import("../studio.js").Studio} Studio */
/** @typedef {import("../../shared/connection.js").Problem} Problem */

/** How deep inside its labels a draft is trusted, mm. */
const CORE_MM = 3;
const MEGABYTE = 1e6;
/** What files that are read are called; a DICOM file may be called anything. */
const ENDINGS = [".nii", ".nii.gz", ".nrrd", ".mha", ".dcm", ".stl", ".mrk.json"];
const NAMES_SHOWN = 5;

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));
/** @param {string} id */
const input = (id) => /** @type {HTMLInputElement} */ (document.getElementById(id));

/**
 * What is sent: the length of a header, the header, and the files.
 * @param {readonly File[]} files
 * @param {Record<string, unknown>} options
 */
export function packed(files, options) {
  const header = new TextEncoder().encode(JSON.stringify({ files: files.map(({ name, size }) => ({ name, size })), ...options }));
  const length = new DataView(new ArrayBuffer(4));
  length.setUint32(0, header.length, true);
  return new Blob([length.buffer, header, ...files]);
}

/** Whether a file is of a kind that can be a draft. @param {File} file */
export async function isDraft(file) {
  const name = file.name.toLowerCase();
  if (ENDINGS.some((ending) => name.endsWith(ending))) return true;
  try {
    return (await file.slice(128, 132).text()) === "DICM";
  } catch {
    // a folder has no content
    return false;
  }
}

/** @param {readonly File[]} files */
function listed(files) {
  const more = files.length - NAMES_SHOWN;
  const names = files.slice(0, NAMES_SHOWN).map(({ name }) => name).join(", ");
  return more > 0 ? say("draft_more", { names, more }) : names;
}

/** @param {Studio} studio @param {string} address where drafts are sent */
export function runDrafts(studio, address) {
  const dialog = /** @type {HTMLDialogElement} */ (find("draft"));
  const chooser = input("draft-files");
  const [add, said] = [/** @type {HTMLButtonElement} */ (find("draft-add")), find("draft-said")];
  /** @type {File[]} */
  let files = [];
  /** Those of them that nobody reads. @type {readonly File[]} */
  let unread = [];
  let isSending = false;

  const tell = () => {
    const size = files.reduce((sum, file) => sum + file.size, 0) / MEGABYTE;
    const words = size < 0.1 ? `${figure(Math.ceil(1000 * size), 0)} kB` : `${figure(size, size < 10 ? 1 : 0)} MB`;
    find("draft-what").hidden = unread.length > 0;
    find("draft-what").textContent = say("draft_what", { names: listed(files), size: words });
    if (unread.length > 0) said.replaceChildren(element("strong", "", say("draft_unread", { names: listed(unread) })));
    add.disabled = isSending || files.length === 0 || unread.length > 0 || !studio.ready.value;
    input("draft-background").disabled = !input("draft-cores").checked;
    find("draft-busy").hidden = !isSending;
  };

  /** @param {Iterable<File>} given */
  const offer = async (given) => {
    if (isSending || !studio.ready.value) return;
    const all = [...given];
    const read = await Promise.all(all.map(isDraft));
    if (isSending) return;
    files = all;
    unread = all.filter((_, n) => !read[n]);
    said.replaceChildren();
    tell();
    if (files.length > 0 && !dialog.open) dialog.showModal();
  };

  const send = async () => {
    const isDraft = input("draft-cores").checked;
    const convention = /** @type {HTMLSelectElement} */ (find("draft-convention")).value;
    const options = {
      ...(isDraft ? { core_mm: CORE_MM, background: input("draft-background").checked } : {}),
      ...(convention ? { convention } : {}),
      ignores_others: input("draft-ignores").checked,
    };
    isSending = true;
    said.replaceChildren();
    tell();
    /** @type {Problem[]} */
    let problems = [];
    try {
      const answer = await fetch(address, { method: "POST", body: packed(files, options) });
      problems = answer.ok ? (await answer.json()).problems : [{ place: "", message: say("draft_lost") }];
    } catch {
      // a file that changed since it was dropped cannot be read any more, either
      problems = [{ place: "", message: say("draft_lost") }];
    }
    isSending = false;
    tell();
    if (problems.length > 0) {
      said.replaceChildren(element("strong", "", say("refused")), problemList(problems));
      add.focus();
      return;
    }
    files = [];
    dialog.close();
  };

  find("draft-open").addEventListener("click", () => chooser.click());
  chooser.addEventListener("change", () => {
    void offer(chooser.files ?? []);
    // the same file can be chosen again
    chooser.value = "";
  });
  add.addEventListener("click", () => void send());
  find("draft-cancel").addEventListener("click", () => dialog.close());
  dialog.addEventListener("cancel", (event) => {
    if (isSending) event.preventDefault();
  });
  for (const id of ["draft-cores", "draft-whole"]) input(id).addEventListener("change", tell);

  /** @param {DragEvent} event */
  const holdsFiles = (event) => event.dataTransfer?.types.includes("Files") ?? false;
  for (const name of /** @type {const} */ (["dragenter", "dragover"])) {
    document.addEventListener(name, (event) => {
      if (!holdsFiles(event)) return;
      event.preventDefault();
      document.body.classList.toggle("dropping", studio.ready.value && !isSending);
    });
  }
  document.addEventListener("dragleave", (event) => {
    if (event.relatedTarget === null) document.body.classList.remove("dropping");
  });
  document.addEventListener("drop", (event) => {
    if (!holdsFiles(event)) return;
    // a browser would leave the page and show the file
    event.preventDefault();
    document.body.classList.remove("dropping");
    void offer(event.dataTransfer?.files ?? []);
  });
  studio.ready.follow((ready) => {
    /** @type {HTMLButtonElement} */ (find("draft-open")).disabled = !ready;
    tell();
  });
  language.listen(tell);
}
