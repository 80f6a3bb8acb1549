"use strict";
// Shows the events of the server. The docstring of broadcast.py describes them.

// Colours of the contexts by position; they repeat after twelve.
const COLOURS = [
  "#9a9a9a", "#0072b2", "#cc6600", "#44aa99", "#c9a227", "#882255", "#55aa55", "#443300", "#112288", "#888855", "#8877ff", "#00a5bf",
];
const ON_DARK = { 1: "#56b4e9", 2: "#e08a3c", 5: "#d77fae", 6: "#99dd99", 7: "#b9a27c", 8: "#8fa8ff", 9: "#b5b57a", 10: "#b3a8ff", 11: "#00ddff" }; // colours with a contrast above 6 on dark
const KEPT_S = 300; // time range of the charts
const SILENT_MS = 5000; // longer than any batch period and most holes in a network
const LATE_STEP_S = 1.5; // a shorter speed of zero may be a step that is detected late
const sessions = new Map(); // id: {about, path, now, fixes, anchors, history, origin, heardAt}
let shown = "";
let charts = null, charted = ""; // charts, and the names of the contexts in them

const map = new LiveMap(byId("map"), setHere);

function session(id) {
  if (!sessions.has(id)) sessions.set(id, { path: [], now: null, fixes: [], anchors: new Map(), history: [], origin: null, about: {} });
  return sessions.get(id);
}

const handlers = {
  session(event) {
    const isNew = !sessions.get(event.id)?.about.id, known = session(event.id);
    known.about = event;
    known.heardAt = performance.now() - 1000 * (event.silent_s ?? 0);
    // keep showing a phone that has started a new session
    if (isNew && sessions.get(shown)?.about.device === event.device) shown = event.id;
    known.origin = event.origin;
    list();
  },
  track(event) {
    const known = session(event.id);
    known.path = event.path;
    if (event.history) known.history = event.history; // sent to a page that was opened later
    handlers.session(event);
  },
  path(event) {
    session(event.id).path = event.path;
  },
  step(event) {
    const known = session(event.id);
    const [[ee, en], [, nn]] = event.position_cov_m2;
    const row = [event.time_s, ...event.position_m, ee, en, nn];
    while (known.path.length && known.path.at(-1)[0] >= event.time_s) known.path.pop(); // the event replaces earlier positions
    known.path.push(row);
  },
  now(event) {
    const known = session(event.id);
    known.now = event;
    known.history.push(event);
    while (known.history.length && known.history[0].time_s < event.time_s - KEPT_S) known.history.shift();
    known.heardAt = performance.now() - 1000 * event.silent_s;
    if (event.received_unix_s) known.delay_s = Math.max(Date.now() / 1000 - event.received_unix_s, 0);
  },
  fix(event) { // fixes from this page only; locations of the phone are not shown
    const { fixes, anchors } = session(event.id);
    if (event.anchor_m && event.accepted) anchors.set(String(event.anchor_m), event.anchor_m);
    if (event.kind === "position" && event.outcome === "waiting") fixes.push({ time_s: event.time_s, place: [event.east_m, event.north_m] });
    const known = fixes.find(fix => fix.time_s === event.time_s && [undefined, "waiting"].includes(fix.outcome));
    if (event.kind !== "position" || !known) return;
    known.outcome = event.outcome;
    if (event.id === shown) sayFix(known, event);
  },
  gone(event) {
    sessions.delete(event.id);
    list();
  },
  server(event) {
    const n = Object.values(event.n_refused).reduce((sum, count) => sum + count, 0);
    text("messages", `${event.messages_per_s.toFixed(1)} per s`);
    text("bytes", `${size(event.bytes_per_s)}/s`);
    text("answer", event.answer_s === null ? "–" : `${Math.round(1000 * event.answer_s)} ms`);
    text("refused", String(n));
    text("disk", size(event.disk_left_bytes));
    text("disk_time", duration(event.disk_left_s));
    text("refusal", n ? `Refused by status: ${Object.entries(event.n_refused).map(([status, count]) => `${status} (${count})`).join(", ")}. The last one: ${event.refusal}` : "");
    text("warning", event.is_disk_low ? `The disk of the server is full in ${duration(event.disk_left_s)}: ${size(event.disk_left_bytes)} are left. Free some space, otherwise phones can send nothing more.` : "");
    byId("warning").hidden = !event.is_disk_low;
    byId("server").hidden = false;
  },
};

const UUID = /^[0-9a-f]{8}-?([0-9a-f]{4}-?){3}[0-9a-f]{12}$/i;
const nameOf = ({ about }, id) => {
  const device = UUID.test(about.device) ? `phone ${about.device.slice(0, 4)}` : about.device;
  const begun = about.begun_unix_s && new Date(1000 * about.begun_unix_s).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" });
  return [device, UUID.test(about.session) ? begun : about.session].filter(Boolean).join(" · ").slice(0, 60) || id;
};

function list() {
  const select = byId("session"), names = [...sessions].map(([id, known]) => [id, nameOf(known, id)]);
  const isNamedTwice = name => names.filter(other => other[1] === name).length > 1;
  const options = names.map(([id, name]) => new Option(isNamedTwice(name) ? `${name} (${id.slice(-4)})` : name, id));
  const listed = shownOptions => [...shownOptions].map(option => option.value + option.text).join();
  if (listed(options) !== listed(select.options)) select.replaceChildren(...options); // do not change the list without need, because that closes it
  if (!sessions.has(shown)) shown = [...sessions.keys()].at(-1) || "";
  select.value = shown;
  for (const id of ["way", "numbers", "input"]) byId(id).hidden = !shown;
  byId("empty").hidden = Boolean(shown);
  if (!shown) for (const id of ["charts", "state"]) byId(id).hidden = true;
  draw();
}

const text = (id, words) => { if (byId(id).textContent !== words) byId(id).textContent = words; };
const largest = probabilities => {
  const known = Object.entries(probabilities).filter(([, p]) => p !== null).sort((a, b) => b[1] - a[1]);
  return known.length ? `${known[0][0]} ${Math.round(100 * known[0][1])}\u00a0%` : "–";
};

// Without magnetometer or location, directions are relative to the first heading.
const hasNorth = known => ["fixes", "heading fixes", "north"].includes(known.about.frame);
const placeWords = (known, [east, north]) => {
  const side = (v, above, below) => `${Math.abs(v).toFixed(1)} m ${v < 0 ? below : above}`;
  if (hasNorth(known)) return `${side(east, "east", "west")} and ${side(north, "north", "south")}${known.origin ? "" : " of the start"}`;
  return `${side(north, "ahead", "behind")} and ${side(east, "to the right", "to the left")} of the start`;
};
const headingWords = (known, rad) => {
  const degrees = (Math.round(rad * 180 / Math.PI) % 360 + 360) % 360;
  if (hasNorth(known)) return `${degrees}°`;
  return degrees > 180 ? `${360 - degrees}° left` : `${degrees}° right`;
};
const steadySpeeds = history => history.map(({ walking_speed_mps: speed, time_s }, i) => {
  let k = i;
  while (!speed && k > 0 && history[k - 1].time_s > time_s - LATE_STEP_S && !history[k].walking_speed_mps) k -= 1;
  return speed || history[k].walking_speed_mps;
});

const duration = s => s < 100 ? `${Math.round(s)} s` : s < 6000 ? `${Math.round(s / 60)} min` : s < 720000 ? `${Math.round(s / 3600)} h` : `${Math.round(s / 86400)} days`;
const size = bytes => bytes < 1e6 ? `${Math.round(bytes / 1e3)} kB` : bytes < 1e9 ? `${Math.round(bytes / 1e6)} MB` : `${Math.round(bytes / 1e9)} GB`;
function stateOf(known) {
  const { about } = known, silentS = (performance.now() - known.heardAt) / 1000;
  if (about.has_ended) return "This session has ended.";
  if (about.refused) return `Not tracked: ${about.refused}. The samples are recorded.`;
  const silent = 1000 * silentS > SILENT_MS ? `Silent for ${duration(silentS)}: the phone sends nothing, and all below is as it was then. ` : "";
  return `${silent}${about.waits ? `Waiting: ${about.waits}.` : ""}`.trim();
}

function draw() {
  const known = sessions.get(shown);
  if (!known) return;
  map.show(known, hasNorth(known));
  const now = known.now, state = stateOf(known), isLive = now && !state.startsWith("Silent") && !known.about.has_ended;
  byId("geojson").href = `sessions/${shown}/track.geojson`;
  byId("recording").href = `sessions/${shown}/recording.zip`;
  notes(known);
  text("state", state);
  byId("state").hidden = !state;
  byId("state").className = known.about.refused ? "wrong" : "";
  const number = (id, words) => text(id, now ? words(now) : "–");
  number("n_steps", () => String(now.n_steps));
  number("distance", () => `${now.distance_m.toFixed(1)} m`);
  text("speed", isLive ? `${(steadySpeeds(known.history).at(-1) ?? now.walking_speed_mps).toFixed(2)} m/s` : "–");
  number("heading", () => now.walking_heading_std_rad > Math.PI / 4 ? "unknown" : headingWords(known, now.walking_heading_rad));
  byId("heading_name").title = hasNorth(known) ? "Clockwise from north" : "Relative to the first heading, because north is unknown";
  number("std", () => now.position_std_m === null ? "–" : `${now.position_std_m.toFixed(1)} m`);
  number("floor", () => now.floor_prob < 0.5 ? "unknown" : String(now.floor));
  number("context", () => largest(now.context_prob));
  number("carrying", () => largest(now.carrying_prob));
  text("latency", isLive && now.latency_s !== null ? `${(now.latency_s + (known.delay_s || 0)).toFixed(1)} s` : "–");
  const n = now ? now.provisional_steps.length : 0;
  const ahead = n ? `with ${n} ${n > 1 ? "steps" : "step"} that may still be rejected, dashed on the map` : "extrapolated from the last step with the walking speed";
  text("where", now ? `At ${placeWords(known, now.position_m)}${now.is_provisional ? `: provisional, ${ahead}` : ""}.` : "");
  byId("rates").replaceChildren(...Object.entries(now ? now.rates_hz : {}).map(([name, rate]) => {
    const row = document.createElement("tr");
    for (const words of [name, rate === null ? "–" : rate.toFixed(0)]) row.insertCell().textContent = words;
    return row;
  }));
  const lost = known.about.n_lost_messages ? `, ${known.about.n_lost_messages} messages lost` : "";
  text("gaps", now ? `${now.n_gaps} gaps, ${now.lost_s.toFixed(1)} s without samples${lost}` : "");
  byId("charts").hidden = !known.history.length;
  drawCharts(known);
}

function notes(known) {
  const words = [...(known.about.notes ?? []), ...(known.now ? known.now.notes : [])];
  const shownNow = [...byId("notes").children].map(item => item.textContent);
  if (words.join("\n") === shownNow.join("\n")) return;
  byId("notes").replaceChildren(...words.map(note => {
    const item = document.createElement("li");
    item.textContent = note;
    return item;
  }));
}

function drawCharts(known) {
  const times = known.history.map(event => event.time_s);
  const names = Object.keys(known.history.at(-1)?.context_prob ?? {});
  const contexts = names.map(name => known.history.map(event => event.context_prob[name] ?? null));
  const speeds = steadySpeeds(known.history);
  const width = byId("contexts").clientWidth;
  if (!width) return;
  if (charts && charted !== names.join("\n")) {
    for (const chart of Object.values(charts)) chart.destroy();
    charts = null;
  }
  if (!charts) {
    charted = names.join("\n");
    const colours = { ...COLOURS, ...(isDark() ? ON_DARK : {}) };
    const ink = styleColour("--faint"), line = styleColour("--line");
    const axis = { stroke: ink, grid: { stroke: line, width: 1 }, ticks: { stroke: line } };
    const made = (id, series, range) => new uPlot({
      width, height: 170, legend: { live: false }, cursor: { show: false },
      scales: { x: { time: false }, y: { range } },
      axes: [{ ...axis, values: (_, ticks) => ticks.map(t => `${t} s`) }, axis],
      series: [{}, ...series],
    }, [[]], byId(id));
    charts = {
      contexts: made("contexts", names.map((label, i) => ({ label, stroke: colours[i % COLOURS.length], width: 2, points: { show: false } })), [0, 1]),
      speeds: made("speeds", [{ label: "speed in m/s", stroke: styleColour("--accent"), width: 2, points: { show: false } }], (_, low, high) => [0, Math.max(2, high)]),
    };
  }
  for (const [name, data] of [["contexts", [times, ...contexts]], ["speeds", [times, speeds]]]) {
    if (charts[name].width !== width) charts[name].setSize({ width, height: 170 });
    charts[name].setData(data);
  }
}

new ResizeObserver(draw).observe(byId("charts"));
setInterval(draw, 1000); // without events, the page must still show that a phone is silent

addEventListener("themed", () => {
  if (charts) for (const chart of Object.values(charts)) chart.destroy();
  charts = null;
  draw();
});

const OUTCOMES = {
  waiting: "waits until the current step is complete",
  used: "was used", placed: "was used", turned: "was used", moved: "was used, and the track was moved to it together with other fixes",
  frozen: "was not used, because it repeats the last position although the person walks",
  repeated: "was not used, because it repeats an earlier fix",
  "nothing to compare": "was not used, because there is no step at its time",
};

function sayFix({ place }, { outcome, nis }) {
  const far = nis === null ? "there is no step at its time" : `the track is ${Math.sqrt(nis).toFixed(0)} standard deviations from it`;
  byId("said").className = ["rejected", "frozen"].includes(outcome) ? "wrong" : "";
  text("said", `Your fix at ${placeWords(sessions.get(shown), place)} ${OUTCOMES[outcome] ?? `was rejected: ${far}`}.`);
}

async function setHere(east, north) {
  setPlacing(false);
  const answer = await fetch(`sessions/${shown}/fix`, {
    method: "POST", headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ east_m: east, north_m: north, std_m: 1.0 }),
  });
  if (answer.ok) return; // the result arrives as an event
  const content = await answer.json().catch(() => ({}));
  byId("said").className = "wrong";
  text("said", content.error || "the server did not accept the position; try again");
}

function setPlacing(placing) {
  map.setPlacing(placing);
  byId("said").className = "";
  byId("here").setAttribute("aria-pressed", String(placing));
  text("said", placing ? "Click where you are on the map, or move the cross there with the arrow keys and press Enter." : "");
}

byId("here").addEventListener("click", () => setPlacing(!map.placing));
byId("follow").addEventListener("click", () => map.setFollow(!map.follow));
byId("nearer").addEventListener("click", () => map.zoom(1.4));
byId("farther").addEventListener("click", () => map.zoom(1 / 1.4));
byId("whole").addEventListener("click", () => map.whole());
byId("map").addEventListener("followed", () => byId("follow").setAttribute("aria-pressed", String(map.follow)));
byId("session").addEventListener("change", event => {
  shown = event.target.value;
  text("said", "");
  draw();
});
byId("map").addEventListener("keydown", event => {
  const keys = { // in addition to the keys of Leaflet
    f: () => map.setFollow(true), w: () => map.whole(),
    h: () => setPlacing(!map.placing), Escape: () => setPlacing(false),
    Enter: () => { if (map.placing) setHere(...map.place()); },
  };
  if (keys[event.key] && !event.ctrlKey && !event.metaKey && !event.altKey) {
    event.preventDefault();
    keys[event.key]();
  }
});
byId("address").textContent = new URL("data", location.href).href.split("?")[0] + location.search;

const events = new EventSource("events" + location.search);
events.onopen = () => text("connection", "connected");
events.onerror = () => text("connection", "not connected, trying again");
const DRAW_MS = 100, TOGETHER_MS = 15; // time between redraws; time within which events belong together
let waits = false, drawnAt = 0;
events.onmessage = message => {
  const event = JSON.parse(message.data);
  handlers[event.event]?.(event);
  if (waits) return;
  waits = true;
  setTimeout(() => {
    waits = false;
    drawnAt = performance.now();
    draw();
  }, Math.max(drawnAt + DRAW_MS - performance.now(), TOGETHER_MS));
};
fetch("sessions" + location.search).then(answer => answer.json()).then(content => {
  map.tiles = content.tiles;
  draw();
});
window.live = { sessions, map }; // for tests and debugging
