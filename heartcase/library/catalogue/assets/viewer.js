/* The 3-D view of a case's page: what its buttons, keys and pointers do. The surface comes in a script of its own,
   loaded when the view is opened, because pages of a folder may load scripts but no data. */
"use strict";
(function () {
  const math = window.HeartcaseMath;
  const catalogue = window.HeartcaseCatalogue;
  const word = catalogue.word;
  const field = (name) => document.getElementById(name);
  const stage = field("stage"), heart = field("heart"), overlay = field("overlay"), status = field("view-status");
  const boxes = Array.from(document.querySelectorAll("#structures input"));
  const TURN = Math.PI / 24, INK = "#21252b";
  const CUTS = {
    front: { normal: [0, -1, 0], up: [0, 0, 1] },
    left: { normal: [1, 0, 0], up: [0, 0, 1] },
    right: { normal: [-1, 0, 0], up: [0, 0, 1] },
    feet: { normal: [0, 0, -1], up: [0, -1, 0] },
  };
  const state = {
    view: math.SIDES.anterior, zoom: 1, shift: [0, 0], mode: "structure", shown: boxes.map(() => true), lit: null,
    cut: null, fill: true, marks: true,
  };
  let scene = null, mesh = null, base = null, asked = false, moving = 0, telling = 0;

  function say(text) {
    status.textContent = text;
  }

  /* Drawing: once for each picture of the screen in which something changed. */

  function redraw() {
    if (asked || !scene) return;
    asked = true;
    window.requestAnimationFrame(function () {
      asked = false;
      fit();
      scene.draw(state);
      drawOverlay();
    });
  }

  function fit() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(stage.clientWidth * ratio)), height = Math.max(1, Math.round(stage.clientHeight * ratio));
    for (const canvas of [heart, overlay]) {
      if (canvas.width !== width || canvas.height !== height) {
        canvas.width = width;
        canvas.height = height;
      }
    }
  }

  function drawOverlay() {
    const pen = overlay.getContext("2d"), width = overlay.width, height = overlay.height;
    const unit = width / Math.max(1, stage.clientWidth);
    pen.clearRect(0, 0, width, height);
    pen.font = 600 + " " + 15 * unit + "px system-ui, sans-serif";
    const written = (text, x, y, align, line) => {
      pen.textAlign = align;
      pen.textBaseline = line;
      pen.lineWidth = 4 * unit;
      pen.lineJoin = "round";
      pen.strokeStyle = "#fff";
      pen.strokeText(text, x, y);
      pen.fillStyle = INK;
      pen.fillText(text, x, y);
    };
    const minus = (v) => math.scaled(v, -1), inset = 8 * unit;
    written(math.lettersOf(state.view[0]), width - inset, height / 2, "right", "middle");
    written(math.lettersOf(minus(state.view[0])), inset, height / 2, "left", "middle");
    written(math.lettersOf(state.view[1]), width / 2, inset, "center", "top");
    written(math.lettersOf(minus(state.view[1])), width / 2, height - inset, "center", "bottom");
    drawScale(pen, unit, written);
    pen.font = 500 + " " + 13 * unit + "px system-ui, sans-serif";
    const taken = [];
    if (state.marks && mesh) for (const mark of mesh.landmarks) drawMark(pen, unit, written, mark, taken);
  }

  function drawScale(pen, unit, written) {
    const size = scene.pixelsPerMm(state), room = 0.25 * overlay.width;
    const length = [1, 2, 5, 10, 20, 50, 100, 200].filter((mm) => mm * size <= room).pop() || 1;
    const left = 12 * unit, bottom = overlay.height - 14 * unit;
    pen.fillStyle = INK;
    pen.fillRect(left, bottom, length * size, 3 * unit);
    written(length + " mm", left, bottom - 4 * unit, "left", "bottom");
  }

  function drawMark(pen, unit, written, mark, taken) {
    const cut = state.cut;
    const isAway = (point) => cut && math.dot(math.less(point, cut.point), cut.normal) > 2;
    if (mark.points.every(isAway)) return;
    const points = mark.points.map((point) => scene.project(state, point));
    pen.lineJoin = pen.lineCap = "round";
    if (points.length === 1) {
      pen.beginPath();
      pen.arc(points[0][0], points[0][1], 5 * unit, 0, 2 * Math.PI);
      pen.fillStyle = "#fff";
      pen.fill();
      pen.lineWidth = 2.5 * unit;
      pen.strokeStyle = INK;
      pen.stroke();
    } else {
      pen.beginPath();
      points.forEach(([x, y], n) => (n ? pen.lineTo(x, y) : pen.moveTo(x, y)));
      if (mark.closed) pen.closePath();
      const styles = mark.kind === "incision" ? [[7, "#fff", []], [3.5, "#111", [9, 6]]] : [[6, "#fff", []], [2.5, INK, []]];
      for (const [wide, colour, dashes] of styles) {
        pen.lineWidth = wide * unit;
        pen.strokeStyle = colour;
        pen.setLineDash(dashes.map((dash) => dash * unit));
        pen.stroke();
      }
      pen.setLineDash([]);
    }
    const [x, y] = points[mark.closed ? 0 : points.length - 1];
    const depth = mark.depth === null ? "" : ", " + word("deep", { mm: catalogue.number(mark.depth) });
    const wide = pen.measureText(mark.name + depth).width, high = 15 * unit, gap = 9 * unit;
    const left = x + gap + wide < overlay.width ? x + gap : x - gap - wide;
    const room = [0, 1, -1, 2, -2, 3, -3].map((step) => ({ left: left, top: y + (step - 0.5) * high }));
    const isFree = (one) => taken.every((other) => one.left > other.left + other.wide || other.left > one.left + wide || Math.abs(one.top - other.top) >= high);
    const place = room.find(isFree) || room[0];
    taken.push({ left: place.left, top: place.top, wide: wide });
    written(mark.name + depth, place.left, place.top + high / 2, "left", "middle");
  }

  /* Words for those who do not see the picture. */

  function describe(isLoud) {
    const sides = math.sidesOf(state.view[2]).map((side) => word(side)).join(", ");
    const shown = { count: state.shown.filter(Boolean).length, total: state.shown.length };
    const text = word("seen_from", { side: sides }) + " " + word("shown_count", shown);
    heart.setAttribute("aria-label", word("view_3d") + ". " + text);
    if (!isLoud) return;
    window.clearTimeout(telling);
    telling = window.setTimeout(() => say(text), 600);
  }

  /* Moving. */

  function moveTo(view) {
    window.cancelAnimationFrame(moving);
    const from = state.view, start = performance.now();
    const still = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
    const step = function (now) {
      const part = still ? 1 : Math.min(1, (now - start) / 320);
      state.view = part < 1 ? math.between(from, view, part * part * (3 - 2 * part)) : view;
      redraw();
      if (part < 1) moving = window.requestAnimationFrame(step);
      else describe(true);
    };
    step(start);
  }

  function turn(right, down) {
    window.cancelAnimationFrame(moving);
    state.view = math.turned(state.view, right, down);
    redraw();
    describe(true);
  }

  function zoom(factor) {
    state.zoom = Math.min(12, Math.max(0.4, state.zoom * factor));
    redraw();
  }

  function shift(x, y) {
    const size = scene.pixelsPerMm(state), ratio = heart.width / Math.max(1, stage.clientWidth);
    state.shift = [state.shift[0] + (x * ratio) / size, state.shift[1] - (y * ratio) / size];
    redraw();
  }

  function reset() {
    state.zoom = 1;
    state.shift = [0, 0];
    moveTo(math.SIDES.anterior);
  }

  const MOVES = {
    turn_left: () => turn(-2 * TURN, 0),
    turn_right: () => turn(2 * TURN, 0),
    turn_up: () => turn(0, -2 * TURN),
    turn_down: () => turn(0, 2 * TURN),
    zoom_in: () => zoom(1.2),
    zoom_out: () => zoom(1 / 1.2),
    reset: reset,
  };

  function onKey(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target !== stage) return;
    const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const way = ways[event.key];
    if (way && event.shiftKey) shift(24 * way[0], 24 * way[1]);
    else if (way) turn(TURN * way[0], TURN * way[1]);
    else if (event.key === "+" || event.key === "=") zoom(1.15);
    else if (event.key === "-") zoom(1 / 1.15);
    else if (event.key === "Home" || event.key === "0") reset();
    else return;
    event.preventDefault();
  }

  function followPointers() {
    const held = new Map();
    let travelled = 0;
    const middle = () => {
      const all = Array.from(held.values());
      return [(all[0][0] + all[1][0]) / 2, (all[0][1] + all[1][1]) / 2, Math.hypot(all[0][0] - all[1][0], all[0][1] - all[1][1])];
    };
    stage.addEventListener("pointerdown", function (event) {
      stage.setPointerCapture(event.pointerId);
      held.set(event.pointerId, [event.clientX, event.clientY]);
      if (held.size === 1) travelled = 0;
    });
    stage.addEventListener("pointermove", function (event) {
      const before = held.get(event.pointerId);
      if (!before) return;
      const x = event.clientX - before[0], y = event.clientY - before[1];
      travelled += Math.abs(x) + Math.abs(y);
      if (held.size === 2) {
        const from = middle();
        held.set(event.pointerId, [event.clientX, event.clientY]);
        const to = middle();
        shift(to[0] - from[0], to[1] - from[1]);
        if (from[2] > 0) zoom(to[2] / from[2]);
        return;
      }
      held.set(event.pointerId, [event.clientX, event.clientY]);
      if (event.shiftKey || event.buttons === 2 || event.buttons === 4) shift(x, y);
      else turn(x * 0.008, y * 0.008);
    });
    const end = function (event) {
      if (held.delete(event.pointerId) && event.type === "pointerup" && held.size === 0 && travelled < 5) tell(event);
    };
    stage.addEventListener("pointerup", end);
    stage.addEventListener("pointercancel", end);
    stage.addEventListener("contextmenu", (event) => event.preventDefault());
    stage.addEventListener("wheel", function (event) {
      // The page must go on scrolling under a wheel until the view is chosen.
      if (document.activeElement !== stage) return;
      event.preventDefault();
      zoom(Math.exp(-event.deltaY * 0.0015));
    }, { passive: false });
  }

  function tell(event) {
    const place = heart.getBoundingClientRect(), ratio = heart.width / place.width;
    const number = scene.structureAt(state, (event.clientX - place.left) * ratio, (event.clientY - place.top) * ratio);
    redraw();
    window.clearTimeout(telling);
    for (const row of document.querySelectorAll("#structures li")) row.classList.toggle("pointed", Number(row.dataset.row) === number);
    if (number === null) return say(word("pointed_none"));
    const name = boxes[number].nextElementSibling.cloneNode(true);
    for (const one of name.querySelectorAll("[hidden]")) one.remove();
    say(word("pointed", { name: name.textContent.trim() }));
  }

  /* Cutting, colours, structures. */

  function setCut() {
    const key = field("cut").value;
    field("cut-depth").disabled = key === "none";
    const own = mesh.cuts.find((one) => one.key === key);
    if (key === "none") base = null;
    else if (own) base = own;
    else if (key === "view") base = { point: scene.centre, normal: state.view[2], up: null };
    else base = { point: scene.centre, normal: CUTS[key].normal, up: CUTS[key].up };
    field("cut-depth").value = 50;
    moveCut();
    if (base && base.up) moveTo(math.lookingAt(base.normal, base.up));
  }

  /** 50 is where the cut was made; to either side it moves through the whole heart. */
  function moveCut() {
    if (base) {
      const height = math.dot(math.less(scene.centre, base.point), base.normal);
      const part = (Number(field("cut-depth").value) - 50) / 50;
      const way = part < 0 ? -part * (height - scene.radius) : part * (height + scene.radius);
      state.cut = { normal: base.normal, point: math.added(base.point, math.scaled(base.normal, way)) };
    } else {
      state.cut = null;
    }
    redraw();
  }

  function setMode() {
    state.mode = document.querySelector("[name=colours]:checked").value;
    for (const one of document.querySelectorAll("#panel [data-mode]")) one.hidden = one.dataset.mode !== state.mode;
    for (const chip of document.querySelectorAll("[data-chip]")) {
      chip.firstElementChild.setAttribute("fill", mesh.groups[Number(chip.dataset.chip)][state.mode]);
    }
    redraw();
  }

  function setShown() {
    state.shown = boxes.map((box) => box.checked);
    redraw();
    describe(true);
  }

  function setAll(isShown) {
    for (const box of boxes) box.checked = isShown;
    setShown();
  }

  function light(number) {
    if (state.lit === number) return;
    state.lit = number;
    redraw();
  }

  function connect() {
    stage.addEventListener("keydown", onKey);
    followPointers();
    for (const button of document.querySelectorAll("[data-side]")) button.addEventListener("click", () => moveTo(math.SIDES[button.dataset.side]));
    for (const button of document.querySelectorAll("[data-move]")) button.addEventListener("click", MOVES[button.dataset.move]);
    field("cut").addEventListener("change", setCut);
    field("cut-depth").addEventListener("input", moveCut);
    field("cut-fill").addEventListener("change", function () {
      state.fill = field("cut-fill").checked;
      redraw();
    });
    for (const radio of document.querySelectorAll("[name=colours]")) radio.addEventListener("change", setMode);
    boxes.forEach(function (box, n) {
      const row = box.parentElement;
      box.addEventListener("change", setShown);
      row.addEventListener("pointerenter", () => light(n));
      row.addEventListener("pointerleave", () => light(null));
      // After a click the focus stays, and everything else would stay grey.
      box.addEventListener("focus", () => light(box.matches(":focus-visible") ? n : null));
      box.addEventListener("blur", () => light(null));
    });
    field("all-on").addEventListener("click", () => setAll(true));
    field("all-off").addEventListener("click", () => setAll(false));
    const marks = field("show-landmarks");
    if (marks) marks.addEventListener("change", function () {
      state.marks = marks.checked;
      redraw();
    });
    field("panel").addEventListener("submit", (event) => event.preventDefault());
    heart.addEventListener("webglcontextlost", function (event) {
      event.preventDefault();
      scene = null;
      say(word("lost"));
    });
    catalogue.watch(function () {
      describe(false);
      redraw();
    });
    new ResizeObserver(redraw).observe(stage);
  }

  function open(data) {
    mesh = data;
    button.parentElement.hidden = true;
    field("viewer").hidden = false;
    fit();
    try {
      scene = new window.HeartcaseScene(heart, data);
    } catch (error) {
      field("viewer").hidden = true;
      return say(word("no_webgl"));
    }
    connect();
    setMode();
    describe(false);
    say(word("ready"));
    stage.focus();
  }

  const button = field("open-view");
  window.HeartcaseViewer = { register: open };
  button.hidden = false;
  button.addEventListener("click", function () {
    if (button.disabled) return;
    button.disabled = true;
    say(word("loading"));
    const script = document.createElement("script");
    script.src = button.dataset.mesh;
    script.addEventListener("error", function () {
      button.disabled = false;
      say(word("no_mesh"));
    });
    document.head.append(script);
  });
})();
