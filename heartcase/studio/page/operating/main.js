/** The page on which a case moves: puts its parts together, and hands them what the server sends. */

import { Beside } from "../figures/beside.js";
import { Device } from "../figures/device.js";
import { LiveFigures } from "../figures/live_figures.js";
import { Plans } from "../figures/plans.js";
import { SavedPage } from "../figures/saved_page.js";
import { runLanguage, runTheme, runWords, showCompiling, tellLost } from "../shared/looks.js";
import { runTabs } from "../shared/tabs.js";
import { element, problemList } from "../shared/elements.js";
import { Connection, Lost, Refused } from "../shared/connection.js";
import { handFocusOn } from "../shared/focus.js";
import { nameOf } from "../shared/said.js";
import { keep, kept } from "../shared/settings.js";
import { figure, language, say, showNotice } from "../shared/words.js";
import { SceneShower } from "../touring/scene.js";
import { TourPanel } from "../touring/tour_panel.js";
import { arraysOf } from "./messages.js";
import { Branches } from "./branches.js";
import { Panel } from "./panel.js";
import { NoGraphics, Picture } from "./picture.js";
import { Orientation } from "./orientation.js";
import { PlaneControls } from "./plane_controls.js";
import { Pointer } from "./pointer.js";
import { ScanControls } from "./scan_controls.js";
import { SecondView } from "./second_view.js";
import { Surroundings } from "./surroundings.js";
import { tensionMissed } from "./tied.js";
import { fillSpeeds, TimeLine } from "./time_line.js";
import { showCursor, ToolBar } from "./tool_bar.js";

/** @typedef {import("../shared/connection.js").Message} Message */
/** @typedef {import("../shared/connection.js").Package} Package */
/** @typedef {import("../shared/connection.js").Problem} Problem */
/** @typedef {import("../shared/words.js").Word} Word */
/** @typedef {{key: string, size_words: string, size: number, sizes: number[]}} Tool */

const NOTICE_MS = 8000;
/** Key of the instrument that draws a patch's outline. */
const PATCH = "e";

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

runWords();

/** What is open, for whoever looks at the page from outside, such as its tests. @type {{picture: Picture | null, header: any, tour: TourPanel | null, connection: Connection | null}} */
export const open = { picture: null, header: null, tour: null, connection: null };

function run() {
  const picture = new Picture(/** @type {HTMLCanvasElement} */ (find("picture")), find("scene"));
  open.picture = picture;
  const url = new URL(location.pathname.replace("/operate/", "/operating/"), location.href);
  url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  const connection = new Connection(url.href, hear, receive, fault);
  open.connection = connection;
  let isReady = false;
  let keysAreOn = kept("keys") !== "off";
  /** @type {readonly Tool[]} */
  let tools = [];
  /** Size of each tool that was set. @type {Map<string, number>} */
  const sizes = new Map();
  const toolBar = new ToolBar((key) => take(key));
  let noticeUntil = 0;

  /** @param {Record<string, unknown> & {do: string}} request */
  const ask = (request) => {
    if (!isReady) return undefined;
    beside.pass(request);
    return connection.ask(request).then(answered, fault);
  };
  const beside = new Beside(picture, {
    askMain: (request) => connection.ask(request).then(answered, fault),
    painted: () => [[...panel.structures, ...tissueInside], panel.hidden],
    mainHeader: () => open.header,
    shown: () => showTime(),
    told: (said) => notice("", [said]),
    failed: fault,
  });
  const panel = new Panel({
    hiddenChanged: () => {
      paint();
      ask({ do: "hide", structures: [...panel.hidden] });
    },
    replay,
  });
  const saving = new SavedPage(() => ask({ do: "save_page", names: plans.chosen.slice(0, 6) }), () => ask({ do: "leave_page" }), location.pathname.replace("/operate/", "/saved/"));
  const plans = new Plans({
    ask,
    replay,
    sideBySide: ([one, other]) => {
      // both keep one time: neither passes over a pause of its own
      replay(one, false);
      beside.open(other, one);
    },
  });
  const branches = new Branches({
    bringBack: (number) => {
      forget();
      notice("", [{ place: "", message: say("branch_brought_back") }]);
      ask({ do: "take_up", branch: number });
    },
    left: () => notice("", [{ place: "", message: say("branch_left") }]),
  });
  const figures = new LiveFigures(ask);
  const device = new Device({ ask, look: () => picture.camera.at(picture.camera.width / 2, picture.camera.height / 2) });
  const timeLine = new TimeLine((step) => {
    forget();
    const request = { do: "command", command: { kind: "go_to", step } };
    beside.pass(request);
    return connection.ask(request);
  });
  picture.detail.wanted = () => ask({ do: "coarser" });
  const second = new SecondView(picture);
  for (const one of [new Orientation(find("scene"), picture.camera), new Orientation(find("scene-2"), second.camera)]) {
    picture.drawn.push(() => one.draw());
  }
  /** @param {string} surface @param {import("./camera.js").Camera} camera @param {string} cursor @returns {Pointer} */
  const pointerOn = (surface, camera, cursor) => {
    const made = new Pointer(find(surface), camera, {
      ask: (request) => connection.ask(request),
      answered,
      failed: fault,
      changed: () => {
        if (camera === picture.camera) shower.stop();
        picture.move();
      },
      // one hand acts at a time
      hasTool: () => toolBar.tool !== "" && pointers.every((one) => one === made || !one.isUsed),
      isReady: () => isReady,
      cursorMoved: () => showCursor(made.cursor, cursor),
    });
    for (const name of ["pointerenter", "pointerdown", "focus"]) find(surface).addEventListener(name, () => (pointer = made));
    return made;
  };
  /** @type {Pointer[]} */
  const pointers = [];
  pointers.push(pointerOn("scene", picture.camera, "cursor"), pointerOn("scene-2", second.camera, "cursor-2"));
  /** That of the view which was used last. */
  let pointer = pointers[0];
  const shower = new SceneShower(picture);
  const tour = new TourPanel(find("panel-tour"), {
    show: (scene) => {
      panel.hide(scene.hidden);
      shower.setPlane(scene.plane);
      if (strain.checked !== scene.stretch) strain.click();
      if (scene.view !== null) shower.goTo(scene.view);
    },
    enter: (number, step) => {
      forget();
      ask({ do: "tour", tour: number, step });
    },
  });

  open.tour = tour;
  const planeControls = new PlaneControls(picture, (plane) => ask({ do: "cut_open", plane }));
  /** Colours of tissue that lies inside alone. @type {{value: number, colour: string}[]} */
  let tissueInside = [];

  const scanControls = new ScanControls(picture, (request) => connection.ask(request), fault);
  const surroundings = new Surroundings(picture.scene);
  const surrounds = /** @type {HTMLInputElement} */ (find("surroundings"));
  surrounds.addEventListener("change", () => {
    surroundings.group.visible = surrounds.checked;
    picture.redraw();
  });
  const skipPauses = /** @type {HTMLInputElement} */ (find("skip-pauses"));
  skipPauses.checked = kept("skip_pauses") !== "off";
  /** Whether a recording is being opened, and said so. */
  let isOpening = false;
  /** @param {string} name @param {boolean} [skips] */
  function replay(name, skips = skipPauses.checked) {
    forget();
    notice("", [{ place: "", message: say("recording_opening", { name }) }]);
    isOpening = true;
    ask({ do: "replay", name, speed: beside.speed, skips });
  }

  function tellStretch() {
    const [low, high] = stretchShown;
    find("stretch-legend").textContent = say("operate_stretch", { low: figure(low, 1), high: figure(high, 1) });
  }

  function forget() {
    for (const one of pointers) one.forget();
    forgetLine();
  }

  function forgetLine() {
    outline = [];
    picture.tools.showLine([]);
    picture.redraw();
  }

  function paint() {
    picture.heart.paint([...panel.structures, ...tissueInside], panel.hidden);
    picture.redraw();
    beside.repaint();
  }

  /** @param {string} key */
  function take(key) {
    forget();
    toolBar.choose(key);
    ask({ do: "take", tool: key });
    tellSize();
  }

  function tellSize() {
    const one = tools.find(({ key }) => key === toolBar.tool);
    toolBar.tellSize(one ? (sizes.get(one.key) ?? one.size) : null, one && one.sizes[2] < 1 ? 1 : 0);
  }

  function fillTools() {
    toolBar.fill(tools.map(({ key }) => key));
    tellSize();
  }

  /** @param {Message} answer */
  function answered(answer) {
    if (answer.kind !== "done") return;
    if (answer.size !== null) {
      sizes.set(answer.tool, answer.size);
      tellSize();
    }
    showLine(answer);
    if (answer.recordings) plans.showRecordings(answer.recordings, answer.unfinished);
    if (answer.shown_s !== undefined) notice("", [{ place: "", message: say("recording_not_whole", { seconds: figure(answer.shown_s, 1) }) }]);
    if (answer.used === false && answer.id === lettingGo) notice("", [{ place: "", message: say("operate_nothing_held") }]);
  }

  /** The outline of a patch that was asked for: it stays in sight until the patch is there, also where it is refused. */
  let outline = /** @type {number[][]} */ ([]);
  /** @param {Message} answer */
  function showLine({ line_mm: line, tool }) {
    if (line.length > 0) outline = tool === PATCH ? line : [];
    picture.tools.showLine(line.length > 0 ? line : outline);
    picture.redraw();
  }

  /** Stretch that the first and the last colour stand for. @type {[number, number]} */
  let stretchShown = [1, 1];
  let lettingGo = -1;
  const actions = {
    undo: () => {
      if (!isReady) return;
      forget();
      notice("", [{ place: "", message: say("operate_undone") }]);
      ask({ do: "undo" });
    },
    redo: () => (forget(), ask({ do: "redo" })),
    back: () => (forget(), ask({ do: "back" })),
    play: () => (forget(), ask({ do: "play", speed: beside.speed, skips: skipPauses.checked && !beside.isOpen })),
    tie: () => ask({ do: "tie" }),
    putDown: () => (forget(), ask({ do: "put_down" })),
    /** @param {boolean} isPointed */
    letGo: (isPointed) => {
      if (!isReady) return;
      const request = { do: "let_go", pointer: isPointed ? pointer.look : null };
      connection.ask(request).then((answer) => {
        lettingGo = answer.id;
        answered(answer);
      }, fault);
    },
    holdLast: () => {
      const answer = ask({ do: "hold_open", incision: Math.max((open.header?.cut_count ?? 0) - 1, 0) });
      if (answer === undefined) return;
      toolBar.tellHolding(true);
      answer.finally(() => toolBar.tellHolding(false));
    },
    letGoAll: () => (forget(), ask({ do: "let_go", everything: true })),
    pause: () => ask(beside.pauseOrGoOn()),
    record: () => ask({ do: open.header?.recording ? "stop_recording" : "record" }),
    /** @param {number} steps */
    resize: (steps) => ask({ do: "resize", steps }),
    strain: () => /** @type {HTMLInputElement} */ (find("strain")).click(),
    showAll: () => panel.showAll(),
    reset: () => {
      if (pointer === pointers[1] && second.isShown) second.reset();
      else {
        shower.stop();
        picture.camera.frame(...box);
      }
      picture.redraw();
    },
  };
  /** @type {[import("./camera.js").Vector, import("./camera.js").Vector]} */
  let box = [[0, 0, 0], [1, 1, 1]];
  /** @type {[string, () => void][]} */
  const clicks = [
    ["undo", actions.undo], ["redo", actions.redo], ["let-go", () => actions.letGo(false)], ["let-go-all", actions.letGoAll],
    ["hold-last", actions.holdLast], ["tie", actions.tie],
    ["back", actions.back], ["pause", actions.pause], ["play", actions.play], ["record", actions.record],
    ["smaller", () => actions.resize(-1)], ["larger", () => actions.resize(1)], ["reset-view", actions.reset],
    ["begin", () => (forget(), ask({ do: "begin" }))], ["tab-recordings", () => ask({ do: "recordings" })],
    ["notice-close", () => notice("", [])],
  ];
  for (const [id, does] of clicks) find(id).addEventListener("click", does);
  handFocusOn(() => find(pointer === pointers[1] && second.isShown ? "scene-2" : "scene"));
  const speed = /** @type {HTMLSelectElement} */ (find("speed"));
  fillSpeeds(speed);
  speed.addEventListener("change", () => {
    beside.speed = Number(speed.value);
    if (beside.mode === "playing") void actions.play();
  });
  skipPauses.addEventListener("change", () => {
    keep("skip_pauses", skipPauses.checked ? "on" : "off");
    if (beside.mode === "playing") void actions.play();
  });
  const strain = /** @type {HTMLInputElement} */ (find("strain"));
  strain.addEventListener("change", () => {
    picture.heart.uniforms.showsStretch.value = strain.checked;
    find("stretch-legend").hidden = !strain.checked;
    ask({ do: "strain", shown: strain.checked });
    picture.redraw();
  });
  const keysOn = /** @type {HTMLInputElement} */ (find("keys-on"));
  keysOn.checked = keysAreOn;
  keysOn.addEventListener("change", () => {
    keysAreOn = keysOn.checked;
    keep("keys", keysAreOn ? "on" : "off");
  });

  document.addEventListener("keydown", (event) => {
    if (event.defaultPrevented) return;
    const target = /** @type {Element} */ (event.target);
    const isInScene = target.closest(".scene-tile .surface") !== null;
    if (isInScene && !event.ctrlKey && !event.metaKey && !event.altKey && pointer.key(event)) {
      event.preventDefault();
      return;
    }
    if (target.closest("input[type=text], input[type=number], select, textarea")) return;
    const key = event.key.toLowerCase();
    if (event.ctrlKey || event.metaKey) {
      const does = key === "z" && !event.shiftKey ? actions.undo : key === "y" || key === "z" ? actions.redo : null;
      if (does === null || event.altKey) return;
      event.preventDefault();
      does();
      return;
    }
    if (!keysAreOn || event.altKey) return;
    // a button or a slider keeps the keys that it has a use for
    const isKept = key === " " ? !target.matches("input[type=range]") : ["enter", "home", "end"].includes(key);
    if (!isInScene && target !== document.body && isKept) return;
    const does = keyAction(key);
    if (does === null) return;
    event.preventDefault();
    does();
  });

  /** @param {string} key @returns {(() => void) | null} */
  function keyAction(key) {
    if (key === "o") return () => take("");
    if (tools.some((one) => one.key === key)) return () => take(key);
    const found = /** @type {Record<string, () => void>} */ ({
      u: actions.undo, y: actions.redo, b: actions.back, l: actions.play, t: actions.tie, w: actions.record, v: actions.strain,
      x: () => actions.letGo(true), a: actions.showAll, home: actions.reset, escape: actions.putDown, " ": actions.pause,
      i: () => second.toggle(), d: () => surrounds.click(), k: () => planeControls.toggle(), "<": () => planeControls.step(-1), ">": () => planeControls.step(1),
      "[": () => actions.resize(-1), "]": () => actions.resize(1), ",": () => actions.resize(-1), ".": () => actions.resize(1),
    });
    return found[key] ?? tour.action(key);
  }

  /** @param {Message} message */
  function hear(message) {
    if (message.kind === "progress") curtain(say("operate_opening"), []);
    else if (message.kind === "compiling") showCompiling(find("curtain-compiling"), message);
    else if (message.kind === "opened") begin(message);
    else if (message.kind === "tour") tour.hear(/** @type {any} */ (message));
    else if (message.kind === "figures") figures.hear(message);
    else if (message.kind === "plans") plans.hear(message);
    else if (message.kind === "saved_page") saving.hear(message);
    else if (message.kind === "approval") find("draft-case").hidden = message.is_approved;
    else if (message.kind === "message") notice("", [/** @type {any} */ (message)]);
    else if (message.kind === "refused" && message.id === null) notice(say("refused"), message.problems ?? []);
    else if (message.kind === "failed") {
      connection.end();
      stop(say("operate_failed"), message.problems ?? []);
    }
  }

  /** @param {Message} message */
  function begin(message) {
    find("case-name").textContent = find("case-name").title = message.name;
    showNotice(find("not-device"), message.notice);
    find("draft-case").hidden = message.is_approved;
    tools = message.tools;
    sizes.clear();
    const isFirst = box[1][0] === 1 && box[0][0] === 0;
    box = message.box_mm;
    if (isFirst) picture.camera.frame(...box);
    timeLine.stepS = message.step_s;
    picture.heart.forgetNormalMap();
    tissueInside = message.tissue_inside;
    panel.setStructures(message.structures);
    picture.heart.paintStretch(message.stretch_colours);
    stretchShown = message.stretch_shown;
    tellStretch();
    isReady = true;
    figures.setPlanned(message.incisions);
    device.setNames(message.devices);
    branches.begin();
    figures.begin();
    fillTools();
    paint();
    take(toolBar.tool);
    ask({ do: "hide", structures: [...panel.hidden] });
    planeControls.setCase(message.heart_axes, box);
    second.setCase(message.heart_axes.planes, box);
    surroundings.setCase(box, message.cannulae);
    scanControls.setCase(message.scan, box);
    find("recipe").hidden = message.recipe === null;
    if (message.recipe !== null) /** @type {HTMLAnchorElement} */ (find("recipe")).href = message.recipe;
    if (strain.checked) ask({ do: "strain", shown: true });
    connection.ask({ do: "tours" }).then((answer) => {
      tour.setTours(answer.tours, answer.tour_problems);
      find("tab-tour").hidden = answer.tours.length + answer.tour_problems.length === 0;
    }, fault);
    // what draws needs a processor of those that step
    if (picture.isDrawnInSoftware) ask({ do: "spare" });
    picture.detail.begin();
  }

  /** A topology, and coarser ones of it, whose first frame is to come. @type {Package[]} */
  let coming = [];
  /** @param {Package} message */
  function receive(message) {
    const { header } = message;
    // shown with the first frame of its own: where its nodes are is not known before
    if (header.kind === "topology") {
      coming = [message];
      return;
    }
    if (header.kind === "coarse_topology") {
      if (coming.length > 0) coming.push(message);
      else picture.heart.takeCoarse(message);
      return;
    }
    const arrays = arraysOf(message);
    if (header.kind === "normal_map") {
      picture.heart.takeNormalMap(arrays.png).then(() => picture.redraw(), fault);
      return;
    }
    if (header.kind === "slice") {
      scanControls.take(header, arrays);
      return;
    }
    for (const one of coming.splice(0)) {
      if (one.header.kind === "topology") picture.heart.takeTopology(one);
      else picture.heart.takeCoarse(one);
    }
    const isHeartNew = picture.heart.takeFrame(message, arrays);
    const areToolsNew = picture.tools.show(header, arrays);
    if (isHeartNew) picture.move();
    else if (areToolsNew) picture.redraw();
    const before = open.header;
    open.header = header;
    if (header.patches.length !== before?.patches.length) forgetLine();
    if (header.branches) branches.show(header.branches);
    panel.showForces(header);
    device.show(header);
    beside.keepTogether();
    showTime();
    showState(header, before);
    // The next one comes when this one is drawn: a page that is slow or hidden is sent the newest then.
    requestAnimationFrame(() => connection.tell({ do: "seen", frame: header.frame }));
    if (document.body.dataset.ready !== "true") {
      document.body.dataset.ready = "true";
      find("curtain").hidden = true;
      connection.watch();
    }
  }

  function showTime() {
    if (open.header !== null) timeLine.show({ ...open.header, mode: beside.mode });
  }

  /** @param {Record<string, any>} header @param {Record<string, any> | null} before */
  function showState(header, before) {
    /** @type {HTMLButtonElement} */ (find("undo")).disabled = header.act_count === 0;
    /** @type {HTMLButtonElement} */ (find("redo")).disabled = header.end_s <= header.time_s;
    /** @type {HTMLButtonElement} */ (find("let-go")).disabled = header.instruments.length === 0;
    find("let-go-all").hidden = header.instruments.length < 2;
    find("hold-last").hidden = !header.can_hold_open;
    find("tie").hidden = !header.stitches.some((/** @type {any} */ one) => !one.tied);
    toolBar.tellRecording(header.recording !== null);
    const cutting = header.cutting > 0 ? say("operate_cutting") : "";
    const pace = header.pace === null ? "" : say("operate_pace", { pace: figure(header.pace, 2) });
    find("pace").textContent = [cutting, pace].filter(Boolean).join("   ");
    if (before?.recording && !header.recording) ask({ do: "recordings" });
    if (before?.mode === "running" && header.mode === "running" && header.patches.length === before.patches.length + 1) {
      const { stitch_count: count, area_mm2: area } = header.patches[header.patches.length - 1];
      notice("", [{ place: "", message: say("operate_patched", { count: String(count), area: figure(area, 0) }) }]);
    }
    const tied = header.stitches.filter((/** @type {any} */ one) => one.tied);
    const tiedBefore = before?.stitches.filter((/** @type {any} */ one) => one.tied).length ?? tied.length;
    if (before?.mode === "running" && header.mode === "running" && tied.length > tiedBefore) {
      const force = Math.max(...tied.map((/** @type {any} */ one) => one.force_n));
      const missed = tensionMissed(before?.stitches ?? [], tied);
      const less = missed === null ? "" : ` ${say("operate_tied_less", { name: nameOf(missed.name), force: figure(missed.force, 2), asked: figure(missed.asked, 2) })}`;
      notice("", [{ place: "", message: say("operate_tied", { count: String(tied.length), force: figure(force, 2) }) + less }]);
    }
    const isOpen = isOpening && header.mode === "playing";
    if (isOpen || (noticeUntil > 0 && performance.now() > noticeUntil)) notice("", []);
  }

  /** @param {string} heading @param {readonly Problem[]} problems */
  function notice(heading, problems) {
    isOpening = false;
    find("notice").hidden = problems.length === 0;
    noticeUntil = problems.length ? performance.now() + NOTICE_MS : 0;
    find("notice-words").replaceChildren(...(heading ? [element("strong", "", heading)] : []), problemList(problems));
  }

  /** @param {string} heading @param {readonly Problem[]} problems */
  function curtain(heading, problems) {
    find("curtain").hidden = false;
    find("curtain-bar").hidden = problems.length > 0;
    find("curtain-words").replaceChildren(element("strong", "", heading), problemList(problems));
  }

  /** Nothing more will come: say why, for good. @param {string} heading @param {readonly Problem[]} problems */
  function stop(heading, problems) {
    isReady = false;
    document.body.dataset.ready = "false";
    curtain(heading, problems);
    find("curtain-bar").hidden = find("curtain-compiling").hidden = true;
  }

  /** @param {unknown} error */
  function fault(error) {
    if (error instanceof Lost) return;
    if (error instanceof Refused) {
      notice(say("refused"), error.problems);
      return;
    }
    connection.end();
    stop(say("broken"), [{ place: "", message: say("operate_broken_why") }]);
    console.error(error);
  }

  function tellState() {
    const state = connection.state.value;
    tellLost(state, state === "lost" ? say("operate_lost") : state === "silent" ? say("operate_silent") : state === "stranger" ? say("operate_stranger") : "");
  }

  /** Whether all that is missing is an answer: what the page knows still holds when it comes. */
  let isSilent = false;
  connection.state.follow((state) => {
    tellState();
    if (state === "open") {
      if (!isSilent) return;
      isSilent = false;
      isReady = true;
      document.body.dataset.ready = "true";
      ask({ do: "abandon" });
      showTime();
      return;
    }
    isSilent = state === "silent" && isReady;
    isReady = false;
    document.body.dataset.ready = "false";
    forget();
    timeLine.tell("");
  });
  language.listen(() => {
    tellState();
    tellStretch();
    fillTools();
    fillSpeeds(speed);
    timeLine.tell(timeLine.mode);
  });
  runTheme();
  runLanguage();
  runTabs((id) => figures.show(id === "tab-figures"));
  connection.open();
}

try {
  run();
} catch (error) {
  find("curtain").hidden = false;
  find("curtain-bar").hidden = true;
  find("curtain-words").textContent = say(error instanceof NoGraphics ? "no_graphics" : "broken_why");
  if (!(error instanceof NoGraphics)) console.error(error);
}
