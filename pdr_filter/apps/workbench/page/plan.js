"use strict";
// Editor of a floor plan: shapes over a picture, in metres. Every change is saved at once, and can be taken back.

L.Path.mergeOptions({ interactive: true }); // other maps of this package are only looked at
L.Marker.mergeOptions({ interactive: true });
// Geoman takes away listeners that it has never set, which Leaflet would report on the console.
const { _off: takeOff } = L.Evented.prototype;
L.Evented.include({ _off(...given) { if (given.length === 1 || given[1]) takeOff.apply(this, given); } });
const COLOURS = { floor: "#8a8f98", wall: "--ink", room: "#cc6677", door: "#117733", stairs: "#cc6600", lift: "#882255" };
const LINES = ["wall", "door"], METRES_PER_PIXEL = 0.05; // of a picture without a scale
const base = `/plans/${location.pathname.split("/").at(-1)}`;
let plan = null, floor = "0", selected = null, mode = null;
const undone = { undo: [], redo: [] }, ours = new Set(); // versions that this page has saved

const map = new PlaneMap(byId("map"));
const shapes = L.featureGroup().addTo(map.leaflet), picked = L.layerGroup().addTo(map.leaflet);
let overlay = null;
map.leaflet.pm.setGlobalOptions({ snappable: true, snapDistance: 12, continueDrawing: true, tooltips: false, layerGroup: shapes });
map.cross = L.DomUtil.create("div", "cross middle", map.box);
map.cross.hidden = true;

// --- saving ----------------------------------------------------------------------------------------------------------

const content = () => structuredClone({ features: plan.features, storeys: plan.storeys, georeference: plan.georeference });

// Change the plan and save it. Who comes later than another browser is told, and can make the change again.
// Return whether it was saved.
const change = make => inTurn(async () => {
  const old = content();
  make(plan);
  const isSaved = await save(() => change(make));
  if (isSaved) {
    undone.undo.push(old);
    undone.redo = [];
  }
  show();
  return isSaved;
});

async function save(again) {
  try {
    plan = await ask(base, { version: plan.version, ...content() });
    ours.add(plan.version);
    say(text("plan_saved"));
    return true;
  } catch (error) {
    plan = await ask(base);
    if (error.status === 409) say(text("conflict"), true, again);
    else say(error.message, true);
    return false;
  }
}

const back = (from, to) => inTurn(async () => {
  if (!undone[from].length) return;
  const old = content();
  Object.assign(plan, undone[from].pop());
  if (await save(null)) undone[to].push(old);
  show();
});

// --- showing ---------------------------------------------------------------------------------------------------------

const storey = () => plan.storeys[floor];
const scaleOf = own => own.metres_per_pixel ?? METRES_PER_PIXEL;
const floorOf = feature => String(feature.properties.floor ?? 0);

function draw() {
  shapes.clearLayers();
  plan.features.forEach((feature, k) => {
    if (floorOf(feature) !== floor) return;
    const { type } = feature.properties, colour = COLOURS[type] ?? COLOURS.room;
    const style = { color: colour.startsWith("--") ? styleColour(colour) : colour, weight: LINES.includes(type) ? 4 : 2, fillOpacity: 0.15, renderer: map.above };
    for (const layer of L.geoJSON(feature, { style }).getLayers()) {
      layer.number = k;
      layer.on("click", () => select(k));
      layer.on("pm:update pm:dragend pm:markerdragend", () => take(layer));
      shapes.addLayer(layer);
    }
  });
  if (byId("edit").getAttribute("aria-pressed") === "true") map.leaflet.pm.enableGlobalEditMode();
}

function drawPicture() {
  overlay?.remove();
  overlay = null;
  const own = storey();
  if (!own?.width) return;
  const east = own.width * scaleOf(own), north = own.height * scaleOf(own), corners = [[0, 0], [east, 0], [0, north]];
  overlay = new PlacedPicture(`${base}/${floor}.png?v=${own.stamp}`, corners.map(place => map.at(...place))).addTo(map.leaflet);
}

function show() {
  byId("name").textContent = plan.name;
  document.title = `${plan.name} – ${about.texts.title}`;
  if (!plan.storeys[floor]) floor = Object.keys(plan.storeys)[0];
  byId("storey").replaceChildren(...Object.keys(plan.storeys).sort((a, b) => a - b).map(number =>
    element("option", { value: number, selected: number === floor }, plan.storeys[number].name ? `${number}: ${plan.storeys[number].name}` : number)));
  byId("storey-name").value = storey().name ?? "";
  for (const name of ["undo", "redo"]) byId(name).disabled = !undone[name].length;
  byId("rectify").disabled = byId("scale").disabled = !storey().width;
  const file = `plans/${plan.name}.geojson`;
  const isReady = !plan.reason && plan.features.length;
  byId("usable").textContent = isReady ? text("usable", { file }) : plan.reason ? text("not_usable", { reason: plan.reason }) : "";
  const problems = plan.problems.map(({ feature, words }) => element("li", {}, element("button", {
    type: "button", className: "problem", onclick: () => { if (feature !== null) select(feature); },
  }, words)));
  byId("problems").replaceChildren(...problems.length || !plan.features.length ? problems : [element("li", {}, text("no_problems"))]);
  drawPicture();
  draw();
  select(selected !== null && plan.features[selected] ? selected : null);
  fillPoints();
}

function select(k) {
  selected = k;
  byId("feature-name").disabled = k === null;
  byId("feature-name").value = k === null ? "" : plan.features[k].properties.name ?? "";
  shapes.eachLayer(layer => layer.setStyle({ dashArray: layer.number === k ? "6 5" : null }));
}

function whole() {
  const own = storey(), metres = scaleOf(own), easts = [0], norths = [0];
  if (own.width) easts.push(own.width * metres), norths.push(own.height * metres);
  shapes.eachLayer(layer => {
    const bounds = layer.getBounds();
    for (const place of [bounds.getNorthEast(), bounds.getSouthWest()]) easts.push(map.frame.place(place)[0]), norths.push(map.frame.place(place)[1]);
  });
  map.fit(easts, norths, 20);
}

// --- drawing ---------------------------------------------------------------------------------------------------------

const press = (button, isPressed) => button.setAttribute("aria-pressed", isPressed);

function stop() {
  map.leaflet.pm.disableDraw();
  map.leaflet.pm.disableGlobalEditMode();
  map.leaflet.pm.disableGlobalRemovalMode();
  document.querySelectorAll("[aria-pressed]").forEach(button => press(button, false));
  picked.clearLayers();
  map.cross.hidden = true;
  mode = null;
}

// Begin a mode; its button is pressed until it ends. Pressing it again ends it.
function begin(button, makeMode) {
  const was = button.getAttribute("aria-pressed") === "true";
  stop();
  if (was) return;
  press(button, true);
  mode = makeMode();
  map.cross.hidden = false;
  map.box.focus({ preventScroll: true });
}

document.querySelectorAll("[data-kind]").forEach(button => button.addEventListener("click", () => begin(button, () => {
  const { kind } = button.dataset, shape = LINES.includes(kind) ? "Line" : "Polygon";
  map.leaflet.pm.enableDraw(shape);
  return { kind, shape };
})));
byId("edit").addEventListener("click", () => begin(byId("edit"), () => {
  map.leaflet.pm.enableGlobalEditMode();
  return {};
}));
byId("delete").addEventListener("click", () => begin(byId("delete"), () => {
  map.leaflet.pm.enableGlobalRemovalMode();
  return {};
}));

const geometryOf = layer => {
  const { geometry } = layer.toGeoJSON(3);
  return { type: geometry.type, coordinates: geometry.coordinates };
};
map.leaflet.on("pm:create", ({ layer }) => {
  const properties = { type: mode?.kind ?? "wall", floor: Number(floor) }, geometry = geometryOf(layer);
  layer.remove();
  change(edited => edited.features.push({ type: "Feature", properties, geometry }));
});
function take(layer) {
  const geometry = geometryOf(layer);
  change(edited => { if (edited.features[layer.number]) edited.features[layer.number].geometry = geometry; });
}
map.leaflet.on("pm:remove", ({ layer }) => change(edited => edited.features.splice(layer.number, 1)));

// Points that a mode asks for, one after the other.
function asking(n, words, done) {
  say(words);
  return { points: [], add(place) {
    this.points.push(place);
    picked.addLayer(map.mark(map.at(...place), "picked", "", 14));
    if (this.points.length < n) return;
    const { points } = this;
    stop();
    done(points);
  } };
}
map.leaflet.on("click", event => { if (mode?.add) mode.add(map.frame.place(event.latlng)); });

// Keyboard: the cross in the middle is the pointer.
byId("map").addEventListener("keydown", event => {
  if (event.key === "Enter" && mode) {
    const latlng = map.at(...map.place());
    if (mode.add) return mode.add(map.place());
    for (const type of ["mousemove", "click"]) map.leaflet.fire(type, { latlng, layerPoint: map.leaflet.latLngToLayerPoint(latlng), originalEvent: event });
  }
  if (event.key.toLowerCase() === "f" && mode?.shape) map.leaflet.pm.Draw[mode.shape]._finishShape();
});
document.addEventListener("keydown", event => {
  if (event.key === "Escape" && document.querySelector("[aria-pressed=true]")) {
    stop();
    say(text("cancelled"));
  }
  if ((event.ctrlKey || event.metaKey) && "zy".includes(event.key.toLowerCase()) && !event.target.matches("input")) {
    event.preventDefault();
    if (event.key.toLowerCase() === "y" || event.shiftKey) back("redo", "undo"); else back("undo", "redo");
  }
});
byId("undo").addEventListener("click", () => back("undo", "redo"));
byId("redo").addEventListener("click", () => back("redo", "undo"));
byId("nearer").addEventListener("click", () => map.zoom(1.5));
byId("farther").addEventListener("click", () => map.zoom(1 / 1.5));
byId("whole").addEventListener("click", whole);

// --- storeys, pictures, scale ----------------------------------------------------------------------------------------

byId("storey").addEventListener("change", event => {
  floor = event.target.value;
  stop();
  show();
  whole();
});
byId("storey-name").addEventListener("change", ({ target: { value } }) => change(() => { storey().name = value.trim(); }));
byId("add-storey").addEventListener("submit", event => {
  event.preventDefault();
  const added = String(Number(byId("storey-number").value));
  change(edited => {
    edited.storeys[added] ??= { metres_per_pixel: storey().metres_per_pixel };
    floor = added;
  });
});
byId("feature-name").addEventListener("change", ({ target: { value } }) => change(edited => {
  if (edited.features[selected]) edited.features[selected].properties.name = value.trim();
}));
// Send a picture, or the corners of the present one, and show the picture that the server has made.
const makePicture = (address, content) => attempt(async () => {
  say(text("working"));
  const size = await ask(`${base}/${floor}${address}`, content);
  await change(() => Object.assign(storey(), size, { stamp: Date.now() }));
  whole();
});
byId("picture").addEventListener("change", async ({ target }) => {
  await makePicture(`.png?page=${byId("pdf-page").value}`, target.files[0]);
  target.value = "";
});

// Pixels of the picture, from its top left corner.
const pixelsOf = ([east, north]) => [east / scaleOf(storey()), storey().height - north / scaleOf(storey())];

byId("rectify").addEventListener("click", () => begin(byId("rectify"), () => {
  return asking(4, text("rectify_how"), points => makePicture("/rectify", { corners: points.map(pixelsOf) }));
}));
byId("scale").addEventListener("click", () => {
  const length = Number(byId("length").value);
  if (!(length > 0)) {
    say(text("no_length"), true);
    return byId("length").focus();
  }
  begin(byId("scale"), () => asking(2, text("scale_how"), ([a, b]) => {
    const factor = length / Math.hypot(b[0] - a[0], b[1] - a[1]);
    if (!Number.isFinite(factor)) return;
    const scaled = coordinates => typeof coordinates === "number" ? factor * coordinates : coordinates.map(scaled);
    change(edited => { // shapes that were drawn before stay on the picture
      storey().metres_per_pixel = factor * scaleOf(storey());
      for (const feature of edited.features) if (floorOf(feature) === floor) feature.geometry.coordinates = scaled(feature.geometry.coordinates);
    }).then(isSaved => {
      whole();
      if (isSaved) say(text("scale_set", { length }));
    });
  }));
});

// --- place on Earth --------------------------------------------------------------------------------------------------

const points = [[], []]; // east, north, latitude, longitude of each, as far as known

function fillPoints() {
  plan.georeference?.points.forEach((point, k) => { points[k] = [...point]; });
  byId("points").replaceChildren(...points.map((point, k) => {
    const fields = ["latitude", "longitude"].map((name, at) => {
      const field = element("input", { type: "number", step: "any", value: point[2 + at] ?? "" });
      field.onchange = () => {
        point[2 + at] = field.value === "" ? undefined : Number(field.value);
        reference();
      };
      const words = text(name).replace(/ .*\(/, " (");
      field.ariaLabel = text("of_point", { name: words, n: k + 1 });
      return element("label", {}, words, field);
    });
    const pick = element("button", { type: "button", "aria-pressed": "false" }, point[0] === undefined ? text("pick", { n: k + 1 }) : `${k + 1}: ${number(point[0])}, ${number(point[1])}`);
    pick.onclick = () => begin(pick, () => asking(1, text("georeference_how"), ([place]) => {
      [point[0], point[1]] = place;
      reference();
      fillPoints();
    }));
    return element("div", { className: "row" }, pick, ...fields);
  }));
}

function reference() {
  if (points.some(point => [0, 1, 2, 3].some(k => point[k] === undefined))) return;
  change(edited => { edited.georeference = { points: structuredClone(points) }; });
}
byId("clear").addEventListener("click", () => {
  points.forEach(point => point.splice(0));
  change(edited => { edited.georeference = null; });
});

// --- begin -----------------------------------------------------------------------------------------------------------

onEvents(event => {
  if (event.event !== "plan" || event.name !== plan?.name) return;
  inTurn(() => attempt(async () => { // after the answer to what this page has just saved
    if (ours.has(event.version)) return;
    plan = await ask(base);
    undone.undo = [];
    undone.redo = [];
    show();
    say(text("changed_elsewhere"));
  }));
});
attempt(async () => {
  plan = await ask(base);
  show();
  whole();
});
