"use strict";
// Map of the path of a report, with floor plan, locations, ground truth and other tracks.

const FAR_M = 500; // a floor plan that is this far from the path lies at a wrong place
const BAND_M = 8, BAND_SHARE = 0.25; // largest margin of the uncertainty around the whole path: in metres, or relative to it

class WayMap extends PlaneMap {
  constructor(box, onStep) {
    super(box);
    this.onStep = onStep; // called with the index of the step at the pointer
    this.hidden = new Set(); // names of hidden layers
    this.tracks = [];
    this.chosen = 0;
    this.groups = "floors"; // grouping for the step colours, if there are several floors
    this.row = -1; // index of the selected step
    this.isWhole = true;
    this.still = L.layerGroup().addTo(this.leaflet); // layers that do not depend on the selected step
    this.now = L.layerGroup().addTo(this.leaflet); // layers of the selected step
    this.numbers = L.layerGroup().addTo(this.leaflet); // of warnings, which depend on the zoom
    this.leaflet.on("zoomend", () => { if (this.way) this.drawWarnings(); });
    this.pictures = new Map(); // of storeys; that of the selected step is shown
    this.marked = []; // east and north of known points, which are in view if they are near the path
    // The workbench selects steps by clicks alone, and uses clicks for marks.
    this.followsMouse = true;
    this.isTaking = false;
    this.leaflet.on("mousemove click", event => {
      if (this.leaflet.dragging.moving() || this.isTaking || (event.type === "mousemove" && !this.followsMouse)) return;
      this.point(event.latlng, 40);
    });
    this.beyond = L.DomUtil.create("div", "beyond-map", box);
    this.leaflet.on("movestart", () => {
      this.isWhole = false;
      this.beyond.textContent = "";
    });
    this.leaflet.on("resize", () => { if (this.isWhole) this.whole(); });
    this.leaflet.on("dblclick", () => this.whole());
    box.addEventListener("keydown", event => { if (event.key === "0") this.whole(); });
  }

  get track() { return this.tracks[this.chosen]; }

  // Select the step nearest to a position, if it is within this many pixels. Return whether there is one.
  point(latlng, within) {
    const { east, north } = this.track, place = this.frame.place(latlng);
    let best = -1, least = (within / this.scale) ** 2;
    for (let k = 0; k < east.length; k++) {
      const apart = (east[k] - place[0]) ** 2 + (north[k] - place[1]) ** 2;
      if (apart <= least) [best, least] = [k, apart];
    }
    if (best >= 0) this.onStep(best);
    return best >= 0;
  }

  whole() {
    const easts = [], norths = [];
    const add = (east, north, reach = 0) => {
      easts.push(east - reach, east + reach);
      norths.push(north - reach, north + reach);
    };
    for (const track of this.tracks) {
      add(...track.start);
      track.east.forEach((east, k) => add(east, track.north[k]));
      if (track.anchors && !this.hidden.has("anchors")) track.anchors.east.forEach((east, k) => add(east, track.anchors.north[k]));
      if (track.truth && !this.hidden.has("truth")) track.truth.east.forEach((east, k) => add(east, track.truth.north[k]));
    }
    // More than the tracks as well, but nothing that is far outside of them: it would make the path small.
    const near = (values, least, share) => {
      const low = Math.min(...values), high = Math.max(...values), more = Math.max(share * (high - low), least);
      return value => value > low - more && value < high + more;
    };
    const adding = (least, share = 1) => {
      const isEast = near(easts, least, share), isNorth = near(norths, least, share);
      return (east, north) => { if (isEast(east) && isNorth(north)) add(east, north); };
    };
    const addNear = adding(20), addBand = adding(BAND_M, BAND_SHARE), addMark = adding(100), addPlan = adding(FAR_M);
    for (const { gps } of this.hidden.has("GPS") ? [] : this.tracks) gps?.east.forEach((east, k) => addNear(east, gps.north[k]));
    for (const { band, east, north, major } of this.hidden.has("ellipses") ? [] : this.tracks) {
      for (const k of band) for (const by of [-major[k], major[k]]) addBand(east[k] + by, north[k] + by);
    }
    this.marked.forEach(place => addMark(...place));
    if (!this.hidden.has("plan")) {
      for (const { plan } of this.tracks) plan.forEach(({ rings }) => rings.flat().forEach(place => addPlan(...place)));
      for (const { corners } of this.pictures.values()) corners.forEach(place => addPlan(...this.frame.place(place)));
    }
    this.fit(easts, norths, 4);
    this.isWhole = true;
    this.sayBeyond();
  }

  // Say how large the uncertainty is, if the view cuts it off: a band without an edge would not show it.
  sayBeyond() {
    const { track } = this, [west, north] = this.place(0, 0), [east, south] = this.place(this.box.clientWidth, this.box.clientHeight);
    const isBeyond = k => {
      const cosine = Math.cos(track.angle[k]), sine = Math.sin(track.angle[k]), [a, b] = [track.major[k], track.minor[k]];
      const [x, y] = [Math.hypot(a * cosine, b * sine), Math.hypot(a * sine, b * cosine)];
      return track.east[k] - x < west || track.east[k] + x > east || track.north[k] - y < south || track.north[k] + y > north;
    };
    const most = this.isWhole && !this.hidden.has("ellipses") ? Math.max(...track.band.filter(isBeyond).map(k => track.major[k])) : 0;
    this.beyond.textContent = most > 0 ? `The 95 % uncertainty is larger than the map: up to ± ${most.toFixed(0)} m` : "";
  }

  places({ east, north }) { return east.map((_, k) => this.at(east[k], north[k])); }

  wayOf(track) { return [this.at(...track.start), ...this.places(track)]; }

  // Redraw everything after a change of track, colours or layers.
  draw() {
    const shown = name => !this.hidden.has(name), { track } = this;
    this.still.clearLayers();
    this.now.clearLayers();
    if (shown("plan")) this.drawPlan(track.plan);
    if (track.gps && shown("GPS")) this.drawGps(track.gps);
    if (shown("ellipses")) {
      this.polygon(this.band(track), "--accent", { stroke: false, fillOpacity: 0.17, fillRule: "nonzero" });
      track.ellipses.forEach(k => this.polygon(this.ellipseOf(k), "--accent", { fill: false, opacity: 0.6 }));
    }
    const others = shown("other tracks") ? this.tracks.filter(t => t !== track) : [];
    others.forEach(t => this.still.addLayer(L.polyline(this.wayOf(t), { color: t.colour, weight: 2 })));
    this.drawWay(track);
    // Tracks that coincide with the chosen one are also drawn on top of it, with interleaved dashes.
    // The offset is part of dashArray, because the canvas renderer does not support dashOffset.
    others.forEach((t, k) => {
      const dashArray = [0, 20 * k, 10, 20 * (others.length - k) - 10];
      this.still.addLayer(L.polyline(this.wayOf(t), { color: t.colour, weight: 2, lineCap: "butt", dashArray }));
    });
    if (track.truth && shown("truth")) this.drawTruth(track.truth);
    if (track.anchors && shown("anchors")) this.places(track.anchors).forEach(place => this.still.addLayer(this.mark(place, "anchor", "", 12)));
    this.drawEnds(track);
    this.drawWarnings();
    this.sayBeyond();
    this.show(this.row);
  }

  polygon(places, name, options) {
    const colour = styleColour(name);
    this.still.addLayer(L.polygon(places, { color: colour, weight: 1.2, ...options }));
  }

  dot(place, radius, name, options) {
    const colour = styleColour(name);
    this.still.addLayer(L.circleMarker(place, { radius, stroke: false, color: colour, fillOpacity: 1, ...options }));
  }

  drawPlan(plan) {
    const opacity = Number(styleColour("--plan")); // plan colours are chosen for a white background
    for (const { fill, edge, width, rings } of plan) {
      const places = rings.map(ring => ring.map(place => this.at(...place)));
      const options = { color: edge, weight: width, opacity: fill ? opacity : Math.max(opacity, 0.8), lineCap: "butt" };
      this.still.addLayer(fill ? L.polygon(places, { ...options, fillColor: fill, fillOpacity: this.pictures.size ? 0 : opacity }) : L.polyline(places, options));
    }
  }

  drawGps(gps) {
    this.places(gps).forEach((place, k) => {
      const radius = gps.accuracy[k] ?? 0;
      if (radius) this.still.addLayer(L.circle(place, { radius, color: styleColour("--gps"), weight: 1, opacity: 0.12, fill: false }));
      this.dot(place, 2, "--gps", { fillOpacity: 0.8 });
    });
  }

  drawTruth(truth) {
    const places = this.places(truth);
    // Nothing is known of the way between waypoints: a line would lead through walls.
    if (truth.points) places.forEach(place => this.dot(place, 3, "--truth"));
    else this.still.addLayer(L.polyline(places, { color: styleColour("--truth"), weight: 1.5, dashArray: "5 5" }));
  }

  // Draw all steps in the colour of their group. Steps after the selected step are faint.
  drawWay(track) {
    const { group, colours } = track.groups[this.groups] ?? track.groups.contexts;
    this.way = this.wayOf(track);
    this.runs = []; // runs of consecutive steps of one group: [group, first index, last index + 1]
    group.forEach((own, k) => {
      if (k && own === group[k - 1]) this.runs.at(-1)[2] = k + 1;
      else this.runs.push([own, k, k + 1]);
    });
    const inColours = opacity => colours.map((color, own) => {
      const line = L.polyline(opacity < 1 ? this.runsUntil(own, group.length) : [], { color, weight: 3.4, opacity });
      this.still.addLayer(line);
      return line;
    });
    inColours(0.3);
    this.walked = L.polyline([], { color: styleColour("--ink"), weight: 5 });
    this.still.addLayer(this.walked);
    this.walkedBy = inColours(1);
  }

  // Paths of the runs of a group that begin before step `until`, cut off at this step.
  runsUntil(own, until) {
    return this.runs.filter(([of, from]) => of === own && from < until)
      .map(([, from, to]) => this.way.slice(from, Math.min(to, until) + 1));
  }

  drawEnds(track) {
    this.dot(this.at(...track.start), 5, "--paper", { stroke: true, weight: 2, color: styleColour("--ink"), fillColor: styleColour("--paper") });
    if (track.east.length) this.still.addLayer(this.mark(this.way.at(-1), "end", "", 12).setZIndexOffset(1e6)); // above the arrow
  }

  // Draw the numbers of warnings, and those whose signs would overlap in one sign.
  drawWarnings() {
    const { warnings = [], time, start_s: start } = this.track, signs = [];
    this.numbers.clearLayers();
    if (!time.length || this.hidden.has("warnings")) return;
    for (const [number, at] of warnings.filter(([, at]) => at >= start)) {
      const place = this.way[time.findLastIndex(each => each <= at) + 1], pixel = this.leaflet.project(place);
      const other = signs.find(each => each.pixel.distanceTo(pixel) < 20);
      if (other) other.numbers.push(number);
      else signs.push({ place, pixel, numbers: [number] });
    }
    for (const { place, numbers } of signs) this.numbers.addLayer(this.mark(place, "place", numbers.join(", ")));
  }

  ellipseOf(k) {
    const { east, north, major, minor, angle } = this.track;
    return major[k] === null ? [] : this.ellipse([east[k], north[k]], major[k], minor[k], angle[k]);
  }

  // Rings whose union is the band of uncertainty: the ellipses, and quadrilaterals between the sides of neighbours.
  band(track) {
    const sides = k => { // half width of the ellipse across a direction, as a vector
      const { major, minor, angle } = track, cosine = Math.cos(angle[k]), sine = Math.sin(angle[k]);
      const xx = (major[k] * cosine) ** 2 + (minor[k] * sine) ** 2, yy = (major[k] * sine) ** 2 + (minor[k] * cosine) ** 2;
      const xy = (major[k] ** 2 - minor[k] ** 2) * sine * cosine;
      return (x, y) => {
        const [east, north] = [xx * x + xy * y, xy * x + yy * y], size = Math.max(Math.sqrt(east * x + north * y), 1e-9);
        return [east / size, north / size];
      };
    };
    const quads = track.band.slice(1).map((b, i) => {
      const a = track.band[i], { east, north } = track, left = [north[a] - north[b], east[b] - east[a]];
      const [one, other] = [sides(a)(...left), sides(b)(...left)], middle = [(east[a] + east[b]) / 2, (north[a] + north[b]) / 2];
      // Sorted by direction, the corners go round counter-clockwise, as those of ellipses do: other rings would be holes.
      const round = ([x, y]) => Math.atan2(y - middle[1], x - middle[0]);
      return [[a, one, -1], [b, other, -1], [b, other, 1], [a, one, 1]]
        .map(([k, side, sign]) => [east[k] + sign * side[0], north[k] + sign * side[1]])
        .sort((p, q) => round(p) - round(q)).map(place => this.at(...place));
    });
    return [...track.band.map(k => this.ellipseOf(k)), ...quads];
  }

  // Show the selected step with its ellipse and its possible positions.
  show(row) {
    const { track, now } = this, shape = { renderer: this.above, weight: 1.2 };
    this.row = row;
    const floor = track.floor?.[row] ?? track.storey;
    for (const [own, picture] of this.pictures) picture.getElement().hidden = own !== floor || this.hidden.has("plan");
    this.walked.setLatLngs(row < 0 ? [] : this.way.slice(0, row + 2));
    this.walkedBy.forEach((line, own) => line.setLatLngs(this.runsUntil(own, row + 1)));
    now.clearLayers();
    if (row < 0) {
      this.walker.remove();
      return;
    }
    now.addLayer(L.polygon(this.ellipseOf(row), { ...shape, className: "within", fillOpacity: 0.16, opacity: 0.9 }));
    if (track.places && !this.hidden.has("places")) {
      // possible positions on the floor plan, with their probabilities
      for (const [percent, east, north, ...of] of track.places[row]) {
        const dashed = { ...shape, className: "maybe", fillOpacity: 0.05, dashArray: "6 4" };
        now.addLayer(L.polygon(this.ellipse([east, north], ...of), dashed));
        now.addLayer(this.mark(this.at(east, north), "percent", `${Number(percent)} %`));
      }
    }
    this.stand(this.way[row + 1], track.heading[row] * Math.PI / 180);
  }
}
