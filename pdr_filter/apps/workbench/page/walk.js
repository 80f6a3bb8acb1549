"use strict";
// One walk: its report, and the marks that a user makes on the map of the report.

const FIX_STD_M = 0.5, HEADING_STD_DEG = 5;
const id = location.pathname.split("/").at(-1), base = `/walks/${id}`;
const CHECKS = ["is_loop", "keep_on_plan", "truth_as_fixes"];
let state = null; // version, marks and summary as the server gave them last
let shown = null; // the report on the page
let mode = null; // steps that a user is taking: { button, steps, found, done }
const ours = new Set(); // versions that this page has saved

// --- the report ------------------------------------------------------------------------------------------------------

const report = () => shown;
let nLoads = 0;

// Put a report onto the page, in place of the present one, with the same view and time.
async function load(address) {
  const number = ++nLoads, answer = await fetch(address).catch(() => { throw new Error(text("not_reached")); });
  const words = await answer.text();
  if (!answer.ok) throw new Error(JSON.parse(words).error);
  if (number !== nLoads) return; // a later one comes
  state = await ask(base);
  const page = new DOMParser().parseFromString(words, "text/html"), { tracks, origin } = JSON.parse(page.getElementById("data").textContent);
  const old = shown, view = old && !old.map.isWhole && [old.map.place(), old.map.scale];
  const hasFocus = document.activeElement?.id === "map";
  if (mode) cancel();
  old?.end();
  page.getElementById("file-name")?.remove(); // the title of this page has it
  for (const part of ["way", "facts", "over-time"]) byId(part).replaceWith(page.getElementById(part));
  byId("about-tiles")?.remove(); // the workbench has its own option
  shown = showReport({ tracks, origin, tiles: about.tiles });
  const { map } = shown;
  map.followsMouse = false;
  map.leaflet.on("click", event => { if (mode) take(map.frame.place(event.latlng), event.latlng); });
  map.marked = state.marks.fixes.map(([, east, north]) => [east, north]);
  drawPictures();
  drawFixes();
  if (old && map.track.time.length) shown.show(shown.stepAt(old.time), old.time);
  if (view) map.leaflet.setView(map.at(...view[0]), map.leaflet.getZoom() + Math.log2(view[1] / map.scale), { animate: false });
  else map.whole();
  if (hasFocus) map.box.focus({ preventScroll: true });
}

// Show a report with the marks of the walk.
async function show(address) {
  say(text("working"));
  await load(address);
}

const reload = () => attempt(async () => {
  await show(`${base}/report?v=${state.version}-${Date.now()}`);
  say(text("shown"));
  byId("show-walk").hidden = true;
  fill();
});

// Pictures of the storeys of the floor plan, below the path.
function drawPictures() {
  const { map } = shown, { pictures = [] } = state.walk, plan = encodeURIComponent(state.marks.walk.plan);
  for (const { floor, stamp, corners } of pictures) {
    const picture = new PlacedPicture(`/plans/${plan}/${floor}.png?v=${stamp}`, corners.map(place => map.at(...place)));
    map.pictures.set(floor, picture.addTo(map.leaflet));
  }
  map.draw(); // areas of the plan are transparent above a picture
}

// Outcome of a mark that the smoother did not use, as [time, outcome, normalised innovation squared].
const refusalOf = ([time]) => (state.walk.unused ?? []).find(([at]) => Math.abs(at - time) < 1e-6);

function drawFixes() {
  const { map } = shown, group = L.layerGroup().addTo(map.leaflet);
  for (const fix of state.marks.fixes) {
    const [, east, north, , heading] = fix;
    group.addLayer(map.mark(map.at(east, north), refusalOf(fix) ? "cross rejected" : "cross", "", 18));
    if (heading !== null) {
      const angle = heading * Math.PI / 180, reach = 40 / map.scale;
      const tip = map.at(east + reach * Math.sin(angle), north + reach * Math.cos(angle));
      group.addLayer(L.polyline([map.at(east, north), tip], { color: styleColour("--ink"), weight: 2 }));
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
  if (!report() || now() === null) return say(text("no_path"), true);
  const { map } = report();
  mode = { name, steps: [...MODES[name].steps], fixes: [], time: now(), crosses: L.layerGroup().addTo(map.leaflet) };
  byId(name).setAttribute("aria-pressed", true);
  map.isTaking = true;
  map.cross = L.DomUtil.create("div", "cross middle", map.box);
  map.box.scrollIntoView({ block: "nearest" });
  map.box.focus({ preventScroll: true });
  hint();
}

function hint() {
  const [step] = mode.steps;
  report().map.cross.hidden = step === "choose";
  say(text(step === "choose" && mode.fixes.length ? "step_second" : `step_${step}`, { time: clock(mode.time) }));
}

function end() {
  byId(mode.name).setAttribute("aria-pressed", false);
  const { map } = report();
  map.isTaking = false;
  map.cross.remove();
  mode.crosses.remove();
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
    if (latlng && !map.point(latlng, 60)) return say(text("no_step"), true);
    mode.time = now();
  } else if (what === "place") {
    mode.fixes.push([mode.time, east, north, FIX_STD_M, null, null]);
    mode.crosses.addLayer(map.mark(map.at(east, north), "cross waiting", "", 18));
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
    const refusal = refusalOf(fix), why = refusal && (refusal[2] === null ? text("not_used_otherwise") : text("not_used", { n: number(Math.sqrt(refusal[2]), 0) }));
    return element("li", {}, element("span", {}, `${refusal ? "\u2715" : "+"} ${clock(fix[0])}: ${number(fix[1])}, ${number(fix[2])} m${heading}`),
      element("label", {}, "±", std, "m"), remove, ...why ? [element("p", { className: "wrong" }, why)] : []);
  }));
  byId("calibrate").disabled = marks.fixes.length < 2;
  for (const name of CHECKS) byId(name).checked = Boolean(marks.walk[name]);
  for (const name of ["person", "height_m"]) byId(name).value = marks.walk[name] ?? "";
  byId("height_m").placeholder = walk.height_m ?? "";
  byId("height-of-file").textContent = marks.walk.height_m ? "" : walk.height_m ? text("height_of_file", { height: walk.height_m }) : text("height_unknown");
  byId("plan").value = marks.walk.plan ?? "";
  byId("keep_on_plan").disabled = !marks.walk.plan;
  byId("truth_as_fixes").disabled = !walk.has_waypoints && !marks.walk.truth_as_fixes;
  const origin = marks.walk.origin ?? [];
  byId("latitude").value = origin[0] ?? "";
  byId("longitude").value = origin[1] ?? "";
  byId("not-on-earth").hidden = Boolean(walk.origin);
  for (const kind of ["gpx", "kml"]) byId(`export-${kind}`).disabled = !walk.origin;
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

// Draw the parts of the map that are HTML: the arrow of the pedestrian, the square at the end, crosses of known points,
// numbers of warnings, scale bar and north arrow.
function drawSigns(pen, box, frameOf) {
  const bars = { cross: ([x, y, w, h]) => [[x + w / 2 - 1, y, 2, h], [x, y + h / 2 - 1, w, 2]], end: ([x, y, w, h]) => [[x + 1.5, y + 1.5, w - 3, h - 3]],
    "bar-of-metres": ([x, y, w, h]) => [[x, y + h - 1.5, w, 1.5], [x, y + h / 2, 1.5, h / 2], [x + w - 1.5, y + h / 2, 1.5, h / 2]] };
  for (const sign of box.querySelectorAll(".walker svg, .cross, .end, .anchor, .percent, .place, .bar-of-metres, .north, .beyond-map:not(:empty)")) {
    const at = sign.getBoundingClientRect(), style = getComputedStyle(sign), { offsetWidth: width, offsetHeight: height } = sign;
    const x = -width / 2, y = -height / 2, kind = [...sign.classList].find(name => bars[name]);
    pen.save();
    pen.translate((at.left + at.right) / 2 - frameOf.left, (at.top + at.bottom) / 2 - frameOf.top);
    if (sign.localName === "svg") {
      const { a, b, c, d } = new DOMMatrix(style.transform), arrow = new Path2D(sign.firstChild.getAttribute("d"));
      pen.transform(a, b, c, d, 0, 0);
      Object.assign(pen, { fillStyle: style.fill, strokeStyle: style.stroke, lineWidth: parseFloat(style.strokeWidth) });
      pen.fill(arrow);
      pen.stroke(arrow);
      pen.restore();
      continue;
    }
    if (sign.matches(".rejected")) pen.rotate(Math.PI / 4);
    pen.fillStyle = style.backgroundColor; // of the end, and of the numbers of warnings
    pen.beginPath();
    pen.roundRect(x, y, width, height, height / 2);
    if (sign.matches(".place, .beyond-map")) pen.fill();
    if (kind !== "end") pen.fillStyle = style.color;
    else Object.assign(pen, { strokeStyle: style.borderTopColor, lineWidth: 1.5 }).strokeRect(x + 0.75, y + 0.75, width - 1.5, height - 1.5);
    if (kind) bars[kind]([x, y, width, height]).forEach(bar => pen.fillRect(...bar));
    Object.assign(pen, { textAlign: "center", textBaseline: "top", font: `${style.fontWeight} ${style.fontSize} ${style.fontFamily}` });
    pen.fillText(sign.classList.contains("anchor") ? "\u25B2" : sign.textContent, 0, y + (sign.classList.contains("place") ? 3 : 2));
    pen.font = `20px ${style.fontFamily}`;
    if (sign.classList.contains("north")) pen.fillText("\u2191", 0, -4);
    pen.restore();
  }
}

// The map of the report as a PNG file: its pictures, canvases and drawings in the order in which they lie.
async function png() {
  const { box, leaflet } = report().map, frameOf = box.getBoundingClientRect();
  const made = element("canvas", { width: 2 * frameOf.width, height: 2 * frameOf.height }), pen = made.getContext("2d");
  pen.scale(2, 2);
  pen.fillStyle = getComputedStyle(box).backgroundColor;
  pen.fillRect(0, 0, frameOf.width, frameOf.height);
  const depth = part => Number(getComputedStyle(part.closest(".leaflet-pane > .leaflet-pane")).zIndex);
  const parts = [...box.querySelectorAll("img:not([hidden]), :not(.walker) > svg, canvas")];
  for (const part of parts.sort((one, other) => depth(one) - depth(other))) {
    const at = part.getBoundingClientRect();
    let picture = part;
    if (part.localName === "svg") {
      const copy = part.cloneNode(true), shapes = part.querySelectorAll("path");
      copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
      copy.style.transform = "";
      copy.setAttribute("width", at.width);
      copy.setAttribute("height", at.height);
      copy.querySelectorAll("path").forEach((shape, k) => {
        const style = getComputedStyle(shapes[k]);
        for (const name of ["display", "fill", "fill-opacity", "stroke", "stroke-opacity", "stroke-width"]) shape.style.setProperty(name, style.getPropertyValue(name));
      });
      picture = new Image();
      picture.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(new XMLSerializer().serializeToString(copy))}`;
      await picture.decode();
    }
    pen.save();
    pen.globalAlpha = part.localName === "img" ? Number(getComputedStyle(part).opacity) : 1;
    if (part.transformTo) { // a picture of the floor plan
      await part.decode();
      const { a, b, c, d, e, f } = part.transformTo(place => leaflet.latLngToContainerPoint(place));
      pen.transform(a, b, c, d, e, f);
      pen.drawImage(part, 0, 0);
    } else pen.drawImage(picture, at.left - frameOf.left, at.top - frameOf.top, at.width, at.height);
    pen.restore();
  }
  drawSigns(pen, box, frameOf);
  element("a", { href: made.toDataURL("image/png"), download: `${state.walk.name}.png` }).click();
}

// A link would swallow the reason why a file cannot be made.
async function download(kind) {
  const answer = await fetch(`${base}/export/${kind}`).catch(() => { throw new Error(text("not_reached")); });
  if (!answer.ok) throw new Error((await answer.json()).error);
  const [, name] = /filename="?([^";]+)/.exec(answer.headers.get("Content-Disposition")) ?? [, ""];
  const address = URL.createObjectURL(await answer.blob());
  element("a", { href: address, download: decodeURIComponent(name) }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60000); // when the browser has saved it
}

byId("exports").append(
  ...about.exports.map(kind => element("button", { type: "button", id: `export-${kind}`, onclick: () => attempt(() => download(kind)) }, text(`export_${kind}`))),
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
  document.querySelector(".side").inert = false; // the result has moved the form down
});
