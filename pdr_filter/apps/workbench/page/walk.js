"use strict";
// One walk: its report, and the marks that a user makes on the map of the report.

const FIX_STD_M = 0.5, HEADING_STD_DEG = 5;
const id = location.pathname.split("/").at(-1), base = `/walks/${id}`;
const CHECKS = ["is_loop", "keep_on_plan", "truth_as_fixes"];
let state = null; // version, marks and summary as the server gave them last
let frame = null; // the report that is shown
let mode = null; // steps that a user is taking: { button, steps, found, done }
const ours = new Set(); // versions that this page has saved

// --- the report ------------------------------------------------------------------------------------------------------

const report = () => frame?.contentWindow.report;

// Load a report behind the present one, and show it with the same view and time.
function load(address) {
  return new Promise((done, failed) => {
    const coming = element("iframe", { src: address, className: "coming", title: byId("reports").dataset.title });
    coming.onload = () => {
      const now = coming.contentWindow.report;
      if (!now) {
        failed(new Error(JSON.parse(coming.contentDocument.body.textContent).error));
        coming.remove();
        return;
      }
      const old = report(), { map } = now;
      coming.contentDocument.querySelector("[data-track]").before(coming.contentDocument.getElementById("way"));
      if (old && map.track.time.length) now.show(now.stepAt(old.time), old.time);
      map.followsMouse = false;
      map.leaflet.on("click", event => { if (mode) take(map.frame.place(event.latlng), event.latlng); });
      coming.contentDocument.addEventListener("keydown", key);
      const scrolled = frame?.contentWindow.scrollY ?? 0;
      frame?.remove();
      frame = coming;
      frame.className = "";
      now.map.box.ownerDocument.defaultView.scrollTo(0, scrolled);
      done();
    };
    byId("reports").querySelector(".coming")?.remove();
    byId("reports").append(coming);
  });
}

// Show a report with the marks of the walk, in the view of the one before.
async function show(address) {
  say(text("working"));
  const old = report()?.map, view = old && !old.isWhole && [old.place(), old.scale];
  await load(address);
  state = await ask(base);
  drawTiles();
  drawFixes();
  if (!view) return;
  const { map } = report(), [place, scale] = view;
  map.leaflet.setView(map.at(...place), map.leaflet.getZoom() + Math.log2(scale / map.scale), { animate: false });
}

const reload = () => attempt(async () => {
  await show(`${base}/report?v=${state.version}-${Date.now()}`);
  say(text("shown"));
  byId("show-walk").hidden = true;
  fill();
});

// Map tiles below a path that lies on Earth, if the user named a source.
function drawTiles() {
  const { map } = report(), { origin } = state.walk;
  if (!about.tiles || !origin) return;
  map.lieIn(frame.contentWindow.world(origin));
  map.box.classList.add("has-tiles");
  map.tilesOf(about.tiles).addTo(map.leaflet);
  map.draw();
  map.whole();
}

function drawFixes() {
  const { L } = frame.contentWindow, { map } = report(), group = L.layerGroup().addTo(map.leaflet);
  for (const [, east, north, , heading] of state.marks.fixes) {
    group.addLayer(map.mark(map.at(east, north), "cross", "", 18));
    if (heading !== null) {
      const angle = heading * Math.PI / 180, reach = 40 / map.scale;
      const tip = map.at(east + reach * Math.sin(angle), north + reach * Math.cos(angle));
      group.addLayer(L.polyline([map.at(east, north), tip], { color: map.colour("--ink"), weight: 2 }));
    }
  }
}

// --- marks -----------------------------------------------------------------------------------------------------------

// Change a copy of the marks and save it. Who comes later than another browser is told, and can make the change again.
const edit = change => inTurn(async () => {
  const marks = structuredClone(state.marks);
  change(marks);
  await save("marks", { marks }, () => edit(change));
});

async function save(what, content, again) {
  try {
    state = await ask(`${base}/${what}`, { version: state.version, ...content });
    ours.add(state.version);
    say(text("saved"));
    fill();
    await reload();
  } catch (error) {
    if (error.status === 409) {
      state = await ask(base);
      fill();
      await reload();
      say(text("conflict"), true, again);
    } else {
      say(error.message, true);
      fill();
    }
  }
}

// A fix in the frame of the path that is shown. A path that locations have placed on Earth stays there.
function withFix(marks, fix) {
  if (!marks.fixes.length && !marks.walk.origin && state.walk.origin) marks.walk.origin = state.walk.origin;
  marks.fixes = [...marks.fixes.filter(other => other[0] !== fix[0]), fix];
}

const now = () => {
  const { map } = report();
  return map.row < 0 ? null : map.track.time[map.row];
};

// --- taking points on the map ----------------------------------------------------------------------------------------

const MODES = {
  here: { steps: ["place"], done: ([fix]) => marks => withFix(marks, fix) },
  two: { steps: ["choose", "place", "choose", "place"], done: fixes => marks => fixes.forEach(fix => withFix(marks, fix)) },
  direction: { steps: ["choose", "place", "towards"], done: ([fix]) => marks => withFix(marks, fix) },
};

function begin(name) {
  if (mode?.name === name) return cancel();
  if (mode) cancel();
  if (!report() || now() === null) return say(text("no_step"), true);
  mode = { name, steps: [...MODES[name].steps], fixes: [], time: now() };
  byId(name).setAttribute("aria-pressed", true);
  const { map } = report();
  map.isTaking = true;
  map.cross = frame.contentWindow.L.DomUtil.create("div", "cross", map.box);
  map.cross.style.cssText = "position:absolute;z-index:800;width:28px;height:28px;left:calc(50% - 14px);top:calc(50% - 14px);pointer-events:none";
  map.box.scrollIntoView({ block: "center" });
  map.box.focus({ preventScroll: true });
  hint();
}

function hint() {
  report().map.cross.hidden = mode.steps[0] === "choose";
  say(text(`step_${mode.steps[0]}`, { time: clock(mode.time) }));
}

function end() {
  byId(mode.name).setAttribute("aria-pressed", false);
  const { map } = report();
  map.isTaking = false;
  map.cross.remove();
  mode = null;
}

function cancel() {
  end();
  say(text("cancelled"));
}

// One step of the present mode, at a place on the map.
function take([east, north], latlng = null) {
  const { map } = report(), what = mode.steps[0];
  if (what === "choose") {
    if (latlng) {
      map.row = -1;
      map.point(latlng, 60);
    }
    if (now() === null) return say(text("no_step"), true);
    mode.time = now();
  } else if (what === "place") {
    mode.fixes.push([mode.time, east, north, FIX_STD_M, null, null]);
  } else {
    const fix = mode.fixes.at(-1), heading = Math.atan2(east - fix[1], north - fix[2]) * 180 / Math.PI;
    fix.splice(4, 2, (heading + 360) % 360, HEADING_STD_DEG);
  }
  mode.steps.shift();
  if (mode.steps.length) return hint();
  const change = MODES[mode.name].done(mode.fixes);
  end();
  edit(change);
}

function key(event) {
  const isText = event.target.matches?.("input:not([type=range]):not([type=checkbox]), select, textarea");
  if (event.key === "Escape" && mode) cancel();
  else if (event.key === "Enter" && mode && !event.target.matches?.("button, a") && !isText) take(report().map.place());
  else if ((event.ctrlKey || event.metaKey) && !isText && "zy".includes(event.key.toLowerCase())) {
    event.preventDefault();
    byId(event.key.toLowerCase() === "y" || event.shiftKey ? "redo" : "undo").click();
  }
}
document.addEventListener("keydown", key);

// --- the panel -------------------------------------------------------------------------------------------------------

function fill() {
  const { marks, walk } = state;
  byId("name").textContent = walk.name;
  document.title = `${walk.name} – ${about.texts.title}`;
  byId("undo").disabled = !state.can_undo;
  byId("redo").disabled = !state.can_redo;
  byId("fixes").replaceChildren(...marks.fixes.map((fix, k) => {
    const std = element("input", { type: "number", min: 0.01, step: "any", value: fix[3], ariaLabel: `${text("std")} ${text("at_time", { time: clock(fix[0]) })}` });
    std.onchange = () => edit(changed => { changed.fixes[k][3] = Number(std.value); });
    const heading = fix[4] === null ? "" : `, ${number(fix[4], 0)}°`;
    const remove = element("button", { type: "button", ariaLabel: text("remove_fix", { time: clock(fix[0]) }) }, "×");
    remove.onclick = () => edit(changed => { changed.fixes.splice(k, 1); });
    return element("li", {}, `${clock(fix[0])}: ${number(fix[1])}, ${number(fix[2])}${heading}`, std, remove);
  }));
  byId("calibrate").disabled = marks.fixes.length < 2;
  for (const name of CHECKS) byId(name).checked = Boolean(marks.walk[name]);
  for (const name of ["person", "height_m"]) byId(name).value = marks.walk[name] ?? "";
  byId("plan").value = marks.walk.plan ?? "";
  byId("keep_on_plan").disabled = !marks.walk.plan;
  byId("truth_as_fixes").disabled = !walk.has_waypoints && !marks.walk.truth_as_fixes;
  const origin = marks.walk.origin ?? [];
  byId("latitude").value = origin[0] ?? "";
  byId("longitude").value = origin[1] ?? "";
  byId("where").textContent = text("files", { files: state.files });
}

for (const name of Object.keys(MODES)) byId(name).addEventListener("click", () => begin(name));
byId("undo").addEventListener("click", () => inTurn(() => save("undo", {}, null)));
byId("redo").addEventListener("click", () => inTurn(() => save("redo", {}, null)));
byId("numbers").addEventListener("submit", event => {
  event.preventDefault();
  const time = now(), place = ["east", "north"].map(name => Number(byId(name).value));
  if (time !== null) edit(marks => withFix(marks, [time, ...place, FIX_STD_M, null, null]));
});
for (const name of CHECKS) {
  byId(name).addEventListener("change", ({ target: { checked } }) => edit(marks => { marks.walk[name] = checked; }));
}
for (const name of ["person", "height_m", "plan"]) {
  byId(name).addEventListener("change", ({ target: { value } }) => edit(marks => {
    marks.walk[name] = name === "height_m" && value ? Number(value) : value.trim();
    if (name === "plan" && !value) delete marks.walk.keep_on_plan;
  }));
}
for (const name of ["latitude", "longitude"]) {
  byId(name).addEventListener("change", () => {
    const values = ["latitude", "longitude"].map(each => byId(each).value);
    if (values.some(value => value === "") && values.some(value => value !== "")) return; // the other one comes
    edit(marks => { marks.walk.origin = values[0] === "" ? null : values.map(Number); });
  });
}
byId("calibrate").addEventListener("click", () => attempt(async () => {
  say(text("working"));
  const found = await ask(`${base}/teach`, {});
  say(text("calibrated", { name: state.marks.walk.person, length: number(found.step_length_m, 2), percent: number(100 * found.std) }));
}));

const VARIANTS = ["default/imm", "default/hc", "default/wc", ...about.recipes.filter(name => name !== "default").map(name => `${name}/`)];
byId("variants").append(...VARIANTS.map((value, k) => element("label", { className: "check" },
  element("input", { type: "checkbox", value, checked: k < 3 }), value.replace(/\/$/, "").replace("/", ", "))));
byId("compare").addEventListener("click", () => attempt(async () => {
  const chosen = [...byId("variants").querySelectorAll(":checked")].map(box => `with=${encodeURIComponent(box.value)}`);
  await show(`${base}/compare?${chosen.join("&")}`);
  say("");
  byId("show-walk").hidden = false;
}));
byId("show-walk").addEventListener("click", reload);

// --- export ----------------------------------------------------------------------------------------------------------

// Draw the parts of the map that are HTML: the square at the end, crosses of known points, scale bar and north arrow.
function drawSigns(pen, box, frameOf, styleOf) {
  const bars = { cross: ([x, y, w, h]) => [[x + w / 2 - 1, y, 2, h], [x, y + h / 2 - 1, w, 2]], end: place => [place],
    "bar-of-metres": ([x, y, w, h]) => [[x, y + h - 1.5, w, 1.5], [x, y + h / 2, 1.5, h / 2], [x + w - 1.5, y + h / 2, 1.5, h / 2]] };
  for (const sign of box.querySelectorAll(".cross, .end, .anchor, .percent, .bar-of-metres, .north")) {
    const at = sign.getBoundingClientRect(), style = styleOf(sign), place = [at.left - frameOf.left, at.top - frameOf.top, at.width, at.height];
    const [x, y, width, height] = place, kind = [...sign.classList].find(name => bars[name]);
    pen.fillStyle = kind === "end" ? style.backgroundColor : style.color;
    if (kind) bars[kind](place).forEach(bar => pen.fillRect(...bar));
    pen.textAlign = "center";
    pen.textBaseline = "top";
    pen.font = `${style.fontWeight} ${style.fontSize} ${style.fontFamily}`;
    pen.fillText(sign.classList.contains("anchor") ? "\u25B2" : sign.textContent, x + width / 2, y);
    if (!sign.classList.contains("north")) continue;
    pen.font = `20px ${style.fontFamily}`;
    pen.fillText("\u2191", x + width / 2, y + height / 2 - 4);
  }
}

// The map of the report as a PNG file: its canvases and drawings in the order in which they lie.
async function png() {
  const { box } = report().map, frameOf = box.getBoundingClientRect(), { contentWindow } = frame;
  const made = element("canvas", { width: 2 * frameOf.width, height: 2 * frameOf.height }), pen = made.getContext("2d");
  pen.scale(2, 2);
  pen.fillStyle = contentWindow.getComputedStyle(box).backgroundColor;
  pen.fillRect(0, 0, frameOf.width, frameOf.height);
  const parts = [...box.querySelectorAll("img.leaflet-tile, svg, canvas")], walker = box.querySelector(".walker svg");
  for (const part of [...parts.filter(each => each !== walker), walker]) {
    if (part === walker) drawSigns(pen, box, frameOf, each => contentWindow.getComputedStyle(each));
    if (!part) break;
    const at = part.getBoundingClientRect();
    let picture = part;
    if (part.localName === "svg") {
      const copy = part.cloneNode(true), shapes = part.querySelectorAll("path");
      copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
      copy.style.transform = "";
      copy.setAttribute("width", at.width);
      copy.setAttribute("height", at.height);
      copy.querySelectorAll("path").forEach((shape, k) => {
        const style = contentWindow.getComputedStyle(shapes[k]);
        for (const name of ["fill", "fill-opacity", "stroke", "stroke-opacity", "stroke-width"]) shape.style.setProperty(name, style.getPropertyValue(name));
      });
      picture = new Image();
      picture.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(new XMLSerializer().serializeToString(copy))}`;
      await picture.decode();
    }
    pen.drawImage(picture, at.left - frameOf.left, at.top - frameOf.top, at.width, at.height);
  }
  element("a", { href: made.toDataURL("image/png"), download: `${state.walk.name}.png` }).click();
}

// A link alone would swallow the reason why a file cannot be made.
async function download({ href }) {
  const answer = await fetch(href).catch(() => { throw new Error(text("not_reached")); });
  if (!answer.ok) throw new Error((await answer.json()).error);
  const [, name] = /filename="?([^";]+)/.exec(answer.headers.get("Content-Disposition")) ?? [, ""];
  const address = URL.createObjectURL(await answer.blob());
  element("a", { href: address, download: decodeURIComponent(name) }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60000); // when the browser has saved it
}

byId("exports").append(
  ...about.exports.map(kind => element("a", { href: `${base}/export/${kind}`, download: "", onclick: event => {
    event.preventDefault();
    attempt(() => download(event.target));
  } }, text(`export_${kind}`))),
  element("button", { type: "button", id: "png", onclick: () => attempt(png) }, text("export_png")));

// --- begin -----------------------------------------------------------------------------------------------------------

onEvents(event => {
  if (event.event !== "marks" || event.id !== id) return;
  inTurn(() => attempt(async () => { // after the answer to what this page has just saved
    if (ours.has(event.version)) return;
    state = await ask(base);
    fill();
    await reload();
    say(text("changed_elsewhere"));
  }));
});
attempt(async () => {
  const { plans, people } = await ask("/walks");
  byId("plan").append(...plans.map(name => element("option", { value: name }, name)));
  byId("people").append(...people.map(value => element("option", { value })));
  state = await ask(base);
  fill();
  await reload();
});
