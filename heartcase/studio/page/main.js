/** The page of heartcase studio: puts its parts together, and hands them what the server sends. */

import { BuildTab } from "./building/build_tab.js";
import { runDrafts } from "./painting/panel/drafts.js";
import { Guide } from "./painting/panel/guide.js";
import { runNaming } from "./painting/panel/naming.js";
import { runNewStructure } from "./painting/panel/new_structure.js";
import { runPlanes } from "./painting/panel/planes.js";
import { Status } from "./painting/panel/status.js";
import { Structures } from "./painting/panel/structures.js";
import { runHelp, runTiles } from "./painting/panel/tiles.js";
import { runTabs } from "./shared/tabs.js";
import { runToolbar } from "./painting/panel/toolbar.js";
import { Seen } from "./painting/pictures/seen.js";
import { NoGraphics, Views } from "./painting/pictures/views.js";
import { TooLarge } from "./painting/pictures/volume.js";
import { Connection, Lost, Refused } from "./shared/connection.js";
import { handFocusOn } from "./shared/focus.js";
import { Studio } from "./painting/studio.js";
import { fillWords, isWord, language, say } from "./shared/words.js";
import { Brush } from "./painting/tools/brush.js";
import { Measures } from "./painting/tools/measures.js";
import { Pointers } from "./painting/tools/pointers.js";
import { drawLines, drawLinesOnSolid } from "./shaping/drawing.js";
import { Hands } from "./shaping/hands.js";
import { runPreview } from "./shaping/preview.js";
import { ShapePanel } from "./shaping/panel.js";
import { Shaping } from "./shaping/shaping.js";
import { Shortcuts } from "./painting/tools/shortcuts.js";
import { Steps } from "./painting/tools/steps.js";
import { runTurning } from "./painting/tools/turning.js";

/** @typedef {import("./shared/connection.js").Message} Message */
/** @typedef {import("./shared/connection.js").Package} Package */

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

language.follow((name) => {
  document.documentElement.lang = name;
  fillWords(document);
});

function run() {
  const studio = new Studio();
  const measures = new Measures();
  const tiles = { axial: find("axial"), coronal: find("coronal"), sagittal: find("sagittal") };
  const views = new Views(/** @type {HTMLCanvasElement} */ (find("pictures")), tiles, find("solid"), studio, measures);
  const url = new URL(location.pathname.replace("/prepare/", "/socket/"), location.href);
  url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  url.search = url.hash = "";
  const connection = new Connection(url.href, (message) => hear(message), (message) => receive(message), (error) => fault(error));
  const status = new Status(document, studio, views, connection);
  const brush = new Brush(studio, (request) => connection.ask(request), (problems) => {
    steps.drop();
    status.refused(problems);
  });
  const pointers = new Pointers(views, studio, brush, measures);
  runTurning(views, studio, () => void (studio.tool.value === "shape" && hands.placeAtCrosshair()));
  const shaping = new Shaping((request) => connection.ask(request), (error) => fault(error));
  const hands = (pointers.hands = new Hands(studio, shaping));
  studio.tool.listen((tool) => {
    if (tool !== "shape") hands.drop();
  });
  const seen = new Seen(views, studio, (request) => connection.ask(request), (error) => fault(error));
  // all labels at once, which the fine look takes, would hold a stroke up, or those that are shown
  const isBusy = () => studio.stroke.value !== null || seen.hasRest;
  const preview = runPreview(views, (request) => connection.ask(request), (error) => fault(error), isBusy);
  seen.yields = () => preview.isFirstLook;
  hands.lookAt = (mm) => views.lookAt(mm);
  hands.labelValueAt = (voxel) => views.volume?.labelAt(voxel) ?? null;
  const shapePanel = new ShapePanel(find("panel-shape"), studio, views, shaping, hands);
  views.over.push((view, thickness) => drawLines(view.pen, view.camera, studio.crosshair.value, thickness, shaping));
  views.overSolid.push((view) => drawLinesOnSolid(view.pen, view.camera, studio.crosshair.value, shaping));
  for (const signal of [shaping.shape, shaping.selected, shaping.draft, shaping.isOpen]) {
    /** @type {import("./shared/signal.js").Signal<any>} */ (signal).listen(() => views.redrawAllOverlays());
  }
  const structures = new Structures(find("structures"), studio, views, (label, locked) => {
    status.clear();
    connection.ask({ do: "lock", label, locked }).catch((error) => fault(error));
  });
  const parts = { place: find("place"), right: find("place-right"), wrong: find("place-wrong"), checklist: find("checklist"), heading: find("checklist-heading") };
  const guide = new Guide(studio, views, (request) => connection.ask(request), parts, (error) => fault(error));

  const askStep = (/** @type {{do: "undo" | "redo"}} */ request) => {
    status.clear();
    return connection.ask(request);
  };
  const steps = new Steps(studio, brush, askStep, (error) => fault(error));
  const actions = {
    undo: () => steps.take("undo"),
    redo: () => steps.take("redo"),
    nextPlace: () => void guide.next(),
    placeRight: () => void guide.confirm(),
    placeWrong: () => guide.paint(),
    fit: () => views.fit(),
    shape: () => find("tab-shape").click(),
    removeShape: () => {
      const line = shaping.selected.value;
      const entry = shaping.entryOf(line);
      if (line && entry) void shaping.remove(line, entry);
      return line !== null;
    },
  };
  const shortcuts = new Shortcuts(studio, views, pointers, brush, measures, actions);
  runToolbar(studio, actions);
  handFocusOn(() => views.active.surface);
  runTiles(studio, views);
  runTabs((id) => {
    shaping.isOpen.value = id === "tab-shape";
    if (id === "tab-shape") studio.take("shape");
    else if (studio.tool.value === "shape") studio.take(studio.toolBefore === "shape" ? "pointer" : studio.toolBefore);
  });
  runHelp(shortcuts.areOn);
  runNaming(studio, shaping);
  runNewStructure(studio, shaping);
  runPlanes(studio, views, (request) => connection.ask(request), (error) => fault(error));
  runDrafts(studio, location.pathname.replace("/prepare/", "/draft/"));
  find("next-place").addEventListener("click", () => actions.nextPlace());
  studio.ready.follow((ready) => {
    document.body.dataset.ready = String(ready);
    /** @type {HTMLButtonElement} */ (find("next-place")).disabled = !ready;
  });
  language.listen(() => views.redrawOverlays());

  connection.state.listen((state) => {
    if (state === "open") return;
    studio.ready.value = false;
    steps.drop();
    pointers.letGo();
  });

  /** @param {Message} message */
  function hear(message) {
    if (message.kind === "progress") {
      const key = `stage_${message.text}`;
      status.progress(isWord(key) ? say(key) : say("stage_other", { stage: message.text }), message.fraction);
    } else if (message.kind === "compiling") status.compiling(message);
    else if (message.kind === "opened") open(message);
    else if (message.kind === "refused" && message.id === null) status.refused(message.problems ?? []);
    else if (message.kind === "structures") {
      studio.marked.value = message.marked ?? null;
      preview.refresh();
      shapePanel.tellLumens();
      const isComplete = (message.checklist ?? []).every((/** @type {{key: string, done: boolean}} */ one) => one.done || one.key === "ends");
      structures.tell(message.volumes_ml, message.marked, message.locked ?? [], isComplete);
      guide.forget();
      guide.tell(message.checklist ?? [], message.marked ?? []);
    } else if (message.kind === "label_table") tellLabels(message.labels);
    else if (message.kind === "shaping_facts") shaping.facts.value = /** @type {any} */ (message);
    else if (message.kind === "shape") {
      shaping.tell(/** @type {any} */ (message));
      preview.refresh();
    }
    else if (message.kind === "volumes") structures.tellVolumes(message.volumes_ml ?? {});
    else if (message.kind === "states") {
      structures.tellStates(message.states ?? {});
      guide.tellStates(message.states ?? {});
    }
    else if (message.kind === "done") {
      steps.tell(message.undo_count, message.redo_count);
      studio.undoKind.value = message.undo_kind;
      studio.redoKind.value = message.redo_kind;
      studio.saved.value = message.saved;
      studio.spreads.value = message.dividing === true;
      seen.tell(message.rest === true, true);
    } else if (message.kind === "seen") {
      studio.spreads.value = message.dividing === true;
      seen.tell(message.rest === true);
    }
    else if (message.kind === "failed") {
      connection.end();
      studio.ready.value = false;
      status.stop("failed", message.problems ?? []);
    }
  }

  /** @param {readonly import("./painting/studio.js").Label[]} labels */
  function tellLabels(labels) {
    studio.labels.value = labels;
    // what was hidden or in hand may be gone
    const values = new Set(labels.map(({ value }) => value));
    if ([...studio.hidden.value].some((one) => !values.has(one))) studio.hidden.value = new Set([...studio.hidden.value].filter((one) => values.has(one)));
    if (studio.pickedLabel === null) studio.picked.value = labels.find(({ role }) => role !== "background")?.value ?? null;
  }

  /** @param {Message} message */
  function open(message) {
    studio.ready.value = false;
    views.begin(message.size, message.index_to_world);
    find("case-name").textContent = message.name;
    studio.modality.value = message.modality;
    studio.firstWindow.value = message.window;
    studio.range.value = message.range;
    if (message.labels.every((/** @type {{value: number}} */ one) => one.value !== studio.picked.value)) studio.window.value = { ...message.window };
    tellLabels(message.labels);
    steps.tell(message.undo_count, message.redo_count);
    studio.undoKind.value = message.undo_kind;
    studio.redoKind.value = message.redo_kind;
    studio.saved.value = message.saved;
    status.progress(say("loading"), null);
  }

  /** @param {Package} message */
  function receive({ header, bytes }) {
    if (views.volume === null) throw new Error("voxels came before the scan was opened");
    if (header.kind === "scan") {
      const values = new Int16Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength));
      views.volume.setScan(values, header.scale, header.offset);
    } else if (header.kind === "surface") {
      preview.take(/** @type {any} */ (header), bytes);
    } else if (header.kind === "labels") {
      views.setLabels(header.low, header.size, bytes);
    } else if (header.kind === "boxes") {
      views.setBoxes(header.boxes, bytes);
    }
    if (!studio.ready.value && views.volume.isComplete) {
      views.redraw();
      status.progress(null, null);
      studio.ready.value = true;
    }
  }

  /** @param {unknown} error */
  function fault(error) {
    if (error instanceof Lost) return;
    if (error instanceof Refused) {
      status.refused(error.problems);
      return;
    }
    connection.end();
    studio.ready.value = false;
    if (error instanceof TooLarge) status.stop("too_large", [{ place: "", message: say("too_large_why", { most: error.message }) }]);
    else {
      status.stop("broken", [{ place: "", message: say("broken_why") }]);
      console.error(error);
    }
  }

  connection.open();
  new BuildTab(studio, views, shaping, (request) => connection.ask(request), (error) => fault(error));
}

try {
  run();
} catch (error) {
  const word = error instanceof NoGraphics ? "no_graphics" : "broken_why";
  find("curtain").hidden = false;
  find("curtain-bar").hidden = true;
  find("curtain-words").textContent = say(word);
  if (!(error instanceof NoGraphics)) console.error(error);
}
