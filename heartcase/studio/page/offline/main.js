/** A case without a server: looked at, cut open, coloured, its recordings played; pulled and probed where there is WebGPU. */

import { sidesOf } from "../operating/orientation.js";
import { arraysOf } from "../operating/messages.js";
import { Panel, shownName } from "../operating/panel.js";
import { NoGraphics, Picture } from "../operating/picture.js";
import { PlaneControls } from "../operating/plane_controls.js";
import { Pointer } from "../operating/pointer.js";
import { fillSpeeds } from "../operating/time_line.js";
import { showCursor, ToolBar } from "../operating/tool_bar.js";
import { runTabs } from "../shared/tabs.js";
import { runLanguage, runTheme, runWords } from "../shared/looks.js";
import { figure, language, say, showNotice } from "../shared/words.js";
import { NoWebGpu, SpringEngine } from "../webgpu/engine.js";
import { Lattice } from "../webgpu/lattice.js";
import { SceneShower } from "../touring/scene.js";
import { showTours } from "../touring/told_tour.js";
import { caseText, NoCase, readCase } from "./case_data.js";
import { Colouring, Lit } from "./colouring.js";
import { followingOf } from "./following.js";
import { Frame, LocalHands } from "./hands.js";
import { Looking, SIDES } from "./looking.js";
import { Marks, tornBefore } from "./marks.js";
import { runNaming } from "./naming.js";
import { Picking } from "./picking.js";
import { firstAct, momentsOf, Playing } from "./playing.js";
import { TimeMarks } from "./time_marks.js";
import { Vessels } from "./vessels.js";

/** @typedef {import("../shared/words.js").Word} Word */
/** @typedef {import("../shared/connection.js").Package} Package */
/** @typedef {import("./case_data.js").Recording} Recording */

/** Time of steps in a picture at most, as simulated: what takes longer goes slower. */
const MOST_S = 1 / 30;
/** Movement in a picture below which nothing moves any more [cells], and pictures of it after which steps end. */
const STILL = 2e-4;
const STILL_PICTURES = 20;
/** Displacement below which a node is where it was [cells]: then vessels are lit as they are at rest. */
const AT_REST = 0.05;
/** What steps may take in a picture, ms: where they take longer, fewer are taken. */
const STEPS_MS = 25;
/** Steps in a picture, however long they take: time goes on. */
const STEPS_LEAST = 4;
/** @type {Record<NoWebGpu["reason"], Word>} */
const WHY_NOT = { missing: "offline_no_webgpu", "too large": "offline_webgpu_too_large", refused: "offline_webgpu_refused" };
/** @type {readonly (readonly [string, Word])[]} */
const KEYS = [
  ["O", "operate_help_orbit"], ["G P", "offline_help_tools"], ["[  ]", "operate_help_size"], ["Enter", "operate_help_enter"],
  ["↑ ↓ ← →", "operate_help_arrows"], ["Shift + ↑ ↓ ← →", "operate_help_move"], ["+  -", "operate_help_zoom"],
  ["Page ↑ ↓", "operate_help_deeper"], ["K  <  >", "scene_help_plane"], ["Esc", "operate_help_escape"], ["A  Home", "offline_help_view"],
  ["Q  M  H", "tour_help"],
];

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

runWords();
language.follow((name) => {
  const back = /** @type {HTMLAnchorElement | null} */ (document.getElementById("back"));
  if (back) back.search = `?lang=${name}`;
});

/** What is open, for whoever looks at the page from outside, such as its tests. @type {Record<string, any>} */
export const open = /** @type {any} */ (globalThis).heartcase = {};

async function run() {
  const picture = new Picture(/** @type {HTMLCanvasElement} */ (find("picture")));
  const data = await readCase(await caseText());
  const { facts } = data;
  /** @type {[import("../operating/camera.js").Vector, import("../operating/camera.js").Vector]} */
  const box = facts.box_mm;
  const [topology, springs, ...tubes] = data.case.map((number) => data.parts[number]);
  /** @type {LocalHands | null} */
  let hands = null;
  /** @type {SpringEngine | null} */
  let engine = null;
  /** Why the case cannot be pulled here. @type {NoWebGpu["reason"] | null} */
  let whyNot = null;
  const playing = new Playing(facts.frames_per_second, { part: takePart, shown: momentShown, told: tellPlaying });
  let stillPictures = 0;
  let isStepping = false;
  let steps = STEPS_LEAST;

  const panel = new Panel({ hiddenChanged: () => (paint(), tellSeen()), replay: (name) => replay(name) }, KEYS);
  const picking = new Picking(picture);
  const toolBar = new ToolBar(take);
  const timeMarks = new TimeMarks(find("time-marks"), (at) => playing.goTo(at));
  const colouring = new Colouring(facts.structures, facts.inside, facts.oxygen, () => {
    panel.setStructures(colouring.listed());
    paint();
  });
  const lit = new Lit(picture.over, picture.heart);
  const vessels = new Vessels(picture.scene, picture.heart.uniforms.cutPlane, tubes);
  const landmarks = followingOf(arraysOf(data.landmarks));
  const marks = new Marks(/** @type {HTMLCanvasElement} */ (find("marks")), picture.camera);
  picture.drawn.push(() => marks.draw());
  const looking = new Looking(picture.camera, { changed: () => picture.move(), ended: () => tellSeen() });
  const shower = new SceneShower(picture);
  const pointer = new Pointer(find("scene"), picture.camera, {
    ask: (request) => (hands === null ? Promise.resolve({ kind: "done", used: false }) : hands.ask(request)),
    answered: (answer) => {
      if (answer.used) wake();
    },
    failed: (error) => stop(error),
    changed: () => {
      shower.stop();
      picture.move();
    },
    hasTool: () => hands !== null && hands.tool !== "" && playing.of === null,
    isReady: () => hands !== null,
    cursorMoved: () => showCursor(pointer.cursor),
    twoFingersMove: true,
  });

  function paint() {
    const painted = colouring.painted();
    picture.heart.paint(painted, panel.hidden);
    vessels.paint(painted, panel.hidden, colouring.lit);
    const isShown = colouring.lit !== null && !panel.hidden.has(colouring.lit);
    lit.show(isShown ? colouring.of(/** @type {number} */ (colouring.lit)) : undefined);
    picture.redraw();
  }

  /** @param {number | null} value */
  function light(value) {
    if (colouring.lit === value) return;
    colouring.lit = value;
    paint();
  }

  /** Landmarks and vessels go with the tissue. */
  function follow() {
    const { nodes, arrays, place } = picture.heart;
    if (nodes === null || place === null || arrays.cell_corners === undefined) return;
    const isAtRest = nodes.displacement.every((part, n) => n % 4 === 3 || Math.abs(part) < AT_REST);
    landmarks.follow(nodes.displacement, arrays.cell_corners, place);
    let at = 0;
    marks.marks = facts.landmarks.map((/** @type {import("./marks.js").Mark} */ mark) => {
      const points = mark.points.map(() => /** @type {any} */ ([...landmarks.places.subarray(3 * at, 3 * ++at)]));
      return { ...mark, points, torn: tornBefore(mark.points, points, mark.closed) };
    });
    vessels.follow(nodes.displacement, arrays.cell_corners, place, isAtRest);
  }

  function tellSeen() {
    const side = sidesOf(picture.camera.towards).map((one) => say(/** @type {Word} */ (`offline_side_${one}`))).join(", ");
    const total = panel.structures.length;
    find("said").textContent = say("offline_seen_from", { side, count: total - panel.hidden.size, total });
  }

  /** @param {string} tool */
  function take(tool) {
    if (hands === null) return;
    pointer.forget();
    hands.letGo();
    hands.tool = tool;
    toolBar.choose(tool);
    tellSize();
  }

  function tellSize() {
    const tool = hands?.tool ?? "";
    toolBar.tellSize(hands && (tool === "g" || tool === "p") ? hands.sizes[tool] : null);
  }

  /** @param {number} count */
  function resize(count) {
    hands?.resize(count);
    tellSize();
  }

  function fillTools() {
    toolBar.fill(["g", "p"]);
    tellSize();
  }

  /** The heart's surface as at the start. */
  function showStart() {
    picture.heart.takeTopology(topology);
    picture.heart.nodes?.takeAll(new Float32Array(4 * topology.header.node_count));
    changed();
    follow();
    picture.tools.show({ instruments: [], stitches: [], patches: [] }, {});
  }

  function changed() {
    picture.heart.uniforms.displacements.value.needsUpdate = true;
    picture.heart.uniforms.nodeNormals.value.needsUpdate = true;
    picture.move();
  }

  // Steps of the page's own engine
  function wake() {
    stillPictures = 0;
    if (!isStepping && engine !== null && playing.of === null) void stepOn();
  }

  async function stepOn() {
    isStepping = true;
    let before = performance.now();
    while (engine !== null && hands !== null && playing.of === null && stillPictures < STILL_PICTURES) {
      await new Promise((resolve) => requestAnimationFrame(resolve));
      const now = performance.now();
      const { stepS } = engine.lattice.arrays.facts;
      const took = now - before;
      before = now;
      // as much time as went by, where there is time for so many steps
      const due = Math.max(1, Math.ceil(Math.min(took / 1000, MOST_S) / stepS));
      const taken = Math.min(steps, due);
      hands.lead(taken);
      const began = performance.now();
      engine.take(taken);
      const displacement = await engine.displacements();
      const isSlow = performance.now() - began > STEPS_MS;
      if (isSlow) steps = Math.max(STEPS_LEAST, Math.floor(0.8 * steps));
      else if (taken === steps) steps = Math.ceil(1.15 * steps);
      if (playing.of !== null || picture.heart.nodes === null) break;
      const most = picture.heart.nodes.takeAll(displacement);
      stillPictures = most < STILL && !hands.isUsed ? stillPictures + 1 : 0;
      if (most > 0) follow();
      const shown = hands.shown();
      const areToolsNew = picture.tools.show({ instruments: shown, stitches: [], patches: [] }, {});
      panel.showForces({ mode: "running", instruments: shown.filter(({ kind }) => kind === "grab"), stitches: [], patches: [] });
      find("pace").textContent = say("operate_pace", { pace: figure((taken * stepS * 1000) / Math.max(took, 1), 2) });
      if (most > 0) changed();
      else if (areToolsNew) picture.redraw();
      open.pictures = (open.pictures ?? 0) + 1;
    }
    find("pace").textContent = "";
    isStepping = false;
  }

  // Recordings
  /** @param {string} name */
  function replay(name) {
    const recording = data.recordings.find((one) => one.name === name);
    if (recording === undefined) return;
    const moments = partsOf(recording);
    begin(recording, moments);
    find("time-bar").hidden = false;
    timeMarks.show(moments);
    /** @type {HTMLInputElement} */ (find("time")).max = String(moments.length - 1);
    tellSpeed();
    playing.play(firstAct(moments, facts.frames_per_second));
  }

  /** Play some moments of what a tour does, after which time stands. @param {{parts: number[]}} told @param {number} from @param {number} until */
  function playPart(told, from, until) {
    leaveTools();
    if (playing.of !== told) {
      begin(told, partsOf(told));
      find("time-bar").hidden = true;
    }
    playing.setSpeed(1);
    playing.play(from, until);
  }

  /** @param {{parts: number[]}} one */
  const partsOf = (one) => momentsOf(one.parts.map((number) => data.parts[number]));

  /** @param {object} of @param {Package[][]} moments */
  function begin(of, moments) {
    leaveTools();
    showStart();
    playing.open(of, moments);
  }

  function leaveTools() {
    pointer.forget();
    hands?.letGo();
  }

  /** @param {Package} part @param {boolean} isShown */
  function takePart(part, isShown) {
    if (part.header.kind === "topology") {
      picture.heart.takeTopology(part);
      return;
    }
    const arrays = arraysOf(part);
    picture.heart.takeFrame(part, arrays);
    if (isShown) picture.tools.show(part.header, arrays);
  }

  /** @param {number} at @param {Record<string, any>} header */
  function momentShown(at, header) {
    follow();
    panel.showForces({ ...header, mode: "paused" });
    /** @type {HTMLInputElement} */ (find("time")).value = String(at);
    find("time-words").textContent = say("offline_time", { at: figure(header.time_s ?? 0, 1), end: figure(header.end_s ?? 0, 1) });
    changed();
  }

  /** @param {boolean} isRunning */
  function tellPlaying(isRunning) {
    find("play").setAttribute("aria-pressed", String(isRunning));
    /** @type {Element} */ (find("play").querySelector("use")).setAttribute("href", isRunning ? "#icon-pause" : "#icon-go");
  }

  function tellSpeed() {
    playing.setSpeed(Number(/** @type {HTMLSelectElement} */ (find("speed")).value));
  }

  function leaveRecording() {
    playing.leave();
    find("time-bar").hidden = true;
    engine?.reset();
    showStart();
    paint();
  }

  const planeControls = new PlaneControls(picture, () => {
    marks.cut = picture.plane.isOn ? picture.plane.equation : null;
  });

  const reset = () => {
    shower.stop();
    picture.camera.frame(...box);
    picture.redraw();
  };
  /** @type {[string, () => void][]} */
  const clicks = [
    ["hide-all", () => panel.hideAll()],
    ["smaller", () => resize(-1)], ["larger", () => resize(1)], ["reset-view", reset], ["play", () => playing.playOrPause()], ["begin", leaveRecording],
    ["as-at-start", () => {
      leaveTools();
      engine?.reset();
      wake();
    }],
  ];
  for (const [id, does] of clicks) find(id).addEventListener("click", does);
  runView();
  /** @type {HTMLInputElement} */ (find("time")).addEventListener("input", (event) => playing.goTo(Number(/** @type {HTMLInputElement} */ (event.target).value)));
  const speed = /** @type {HTMLSelectElement} */ (find("speed"));
  fillSpeeds(speed);
  speed.addEventListener("change", tellSpeed);
  document.addEventListener("keydown", (event) => {
    const target = /** @type {Element} */ (event.target);
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || target.closest("select, textarea, input:not([type=checkbox])")) return;
    const isInScene = target.closest("#scene") !== null;
    const key = event.key.toLowerCase();
    const does = /** @type {Record<string, () => void>} */ ({
      o: () => take(""), g: () => take("g"), p: () => take("p"), a: () => panel.showAll(), home: reset, escape: leaveTools,
      k: () => planeControls.toggle(), "<": () => planeControls.step(-1), ">": () => planeControls.step(1),
      "[": () => resize(-1), "]": () => resize(1), ",": () => resize(-1), ".": () => resize(1),
    })[key] ?? tour.action(key);
    if (isInScene && pointer.key(event)) event.preventDefault();
    else if (does && (isInScene || key !== "home")) {
      event.preventDefault();
      does();
    }
  });

  /** What the tab with views and colours does, and what a row of the list and a click on the heart tell. */
  function runView() {
    const moves = /** @type {Record<string, () => void>} */ ({
      turn_left: () => looking.turn(-1, 0), turn_right: () => looking.turn(1, 0), turn_up: () => looking.turn(0, -1),
      turn_down: () => looking.turn(0, 1), nearer: () => looking.zoom(1), farther: () => looking.zoom(-1),
    });
    for (const button of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("[data-side]"))) {
      button.addEventListener("click", () => {
        shower.stop();
        looking.moveTo(SIDES[/** @type {import("./looking.js").Side} */ (button.dataset.side)]);
      });
    }
    for (const button of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("[data-move]"))) {
      button.addEventListener("click", () => {
        shower.stop();
        moves[button.dataset.move ?? ""]();
      });
    }
    const shows = /** @type {HTMLInputElement} */ (find("landmarks"));
    shows.addEventListener("change", () => {
      marks.areShown = shows.checked;
      picture.redraw();
    });
    find("landmarks-row").hidden = facts.landmarks.length + tubes.length === 0;
    const list = find("structures");
    /** @param {Event} event */
    const rowOf = (event) => {
      const row = /** @type {HTMLElement | null} */ (/** @type {Element} */ (event.target).closest(".structure"));
      return row ? Number(row.dataset.value) : null;
    };
    // a finger points at nothing before it presses
    list.addEventListener("pointerover", (event) => event.pointerType !== "touch" && light(rowOf(event)));
    list.addEventListener("pointerleave", () => light(null));
    list.addEventListener("focusin", (event) => /** @type {Element} */ (event.target).matches(":focus-visible") && light(rowOf(event)));
    list.addEventListener("focusout", () => light(null));
    runNaming(find("scene"), (x, y) => {
      if (hands !== null && hands.tool !== "") return;
      const seen = picking.seen(x, y);
      const found = seen && colouring.of(seen.structure);
      find("said").textContent = found ? say("offline_this_is", { name: shownName(found) }) : say("offline_nothing_there");
    });
  }

  find("case-name").textContent = facts.name;
  showNotice(find("not-device"), facts.notice);
  find("draft-case").hidden = facts.is_approved;
  panel.setStructures(colouring.listed());
  panel.showRecordings(data.recordings.map(({ name }) => name));
  find("tab-recordings").hidden = data.recordings.length === 0;
  const tour = showTours(find("panel-tour"), data.tours, {
    shower,
    hide: (numbers) => panel.hide(numbers),
    play: playPart,
    leave: () => {
      if (playing.of !== null && data.recordings.every((one) => one !== playing.of)) leaveRecording();
    },
    looked: () => tellSeen(),
  });
  find("tab-tour").hidden = data.tours.length === 0;
  picture.camera.frame(...box);
  planeControls.setCase(facts.axes, box);
  showStart();
  if (data.normalMap !== null) {
    await picture.heart.takeNormalMap(arraysOf(data.normalMap).png);
    picture.redraw();
  }
  paint();
  language.follow(() => colouring.build());
  language.listen(() => {
    fillTools();
    fillSpeeds(speed);
    tellEngine();
    tellSeen();
  });
  runTheme();
  runLanguage();
  runTabs();

  function tellEngine() {
    find("engine").textContent = whyNot === null ? "" : say(WHY_NOT[whyNot]);
  }
  try {
    const lattice = latticeOf(springs);
    engine = await SpringEngine.create(lattice);
    const pick = (/** @type {import("./hands.js").Look} */ look) => {
      const [x, y] = picture.camera.pixel(/** @type {any} */ (look.start_mm.map((part, axis) => part + 100 * look.direction[axis])));
      return picking.at(x, y);
    };
    hands = new LocalHands(engine, new Frame(facts.place), pick, () => picture.heart.nodes?.displacement ?? new Float32Array(0));
  } catch (error) {
    if (!(error instanceof NoWebGpu)) throw error;
    whyNot = error.reason;
  }
  fillTools();
  for (const id of ["tools", "size-group", "as-at-start"]) find(id).hidden = engine === null;
  find("tab-forces").hidden = engine === null && data.recordings.length === 0;
  tellEngine();
  Object.assign(open, { picture, engine, picking, panel, facts, data, tour, marks, vessels });
  find("curtain").hidden = true;
  document.body.dataset.ready = "true";
}

/** @param {Package} message */
function latticeOf(message) {
  const arrays = arraysOf(message);
  return new Lattice({
    nodeIndex: arrays.node_index, inverseMass: arrays.inverse_mass, higher: arrays.higher, weight: arrays.weight,
    cellCorners: arrays.cell_corners, guardScale: arrays.guard_scale, facts: message.header.facts,
  });
}

/** @param {unknown} error */
function stop(error) {
  find("curtain").hidden = false;
  find("curtain-bar").hidden = true;
  const word = error instanceof NoGraphics ? "offline_no_graphics" : error instanceof NoCase ? "offline_no_case" : "offline_broken";
  find("curtain-words").textContent = say(word);
  if (word === "offline_broken") console.error(error);
}

run().catch(stop);
