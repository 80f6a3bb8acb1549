"use strict";
// Map of a growing path: position with 95 % ellipse, heading, provisional steps, fixes and anchors, on map tiles if given.

const MARGIN = 20; // pixels between the path and the edge of the map
const FADE_MS = 1500; // duration of the animation of .former in live.css
const ELLIPSE_95 = Math.sqrt(5.991); // chi-square of two degrees of freedom

class LiveMap extends PlaneMap {
  constructor(box, onPlace) {
    super(box);
    this.onPlace = onPlace; // called with east and north of a position from "I am here"
    this.tiles = "";
    this.way = null;
    this.origin = ""; // geographic origin of the layers on tiles
    this.drawn = { path: null, n: 0, last: null }; // drawn state, to detect changes
    this.path = L.polyline([], { weight: 3 }).addTo(this.leaflet);
    this.start = L.circleMarker(this.at(0, 0), { radius: 5, stroke: false, fillOpacity: 1 });
    this.provisional = L.polyline([], { renderer: this.above, className: "provisional", weight: 3, dashArray: "4 5" }).addTo(this.leaflet);
    this.within = L.polygon([], { renderer: this.above, className: "within", weight: 1.2, opacity: 0.7, fillOpacity: 0.12 }).addTo(this.leaflet);
    this.fixes = L.layerGroup().addTo(this.leaflet);
    this.cross = L.DomUtil.create("div", "cross middle", box);
    this.isWhole = true; // the whole path stays in view until the user zooms or drags
    this.setFollow(true);
    this.setPlacing(false);
    this.leaflet.on("click", event => { if (this.placing) this.onPlace(...this.frame.place(event.latlng)); });
    const leave = () => {
      this.isWhole = false;
      this.setFollow(false);
    };
    this.leaflet.on("dragstart", leave);
    this.leaflet.on("zoomstart zoomend", event => {
      this.isZooming = event.type === "zoomstart";
      if (!this.isFitting) this.isWhole = false;
    });
    box.addEventListener("keydown", event => { if (event.key.startsWith("Arrow")) leave(); });
    addEventListener("themed", () => this.paint());
    this.paint();
  }

  paint() {
    this.path.setStyle({ color: styleColour("--accent") });
    this.start.setStyle({ color: styleColour("--faint") });
  }

  setFollow(follow) {
    this.follow = follow;
    // zooming while the map follows keeps the position at the centre
    Object.assign(this.leaflet.options, follow ? { scrollWheelZoom: "center", touchZoom: "center" } : { scrollWheelZoom: true, touchZoom: true });
    this.box.dispatchEvent(new Event("followed"));
    this.keepUp();
  }

  setPlacing(placing) {
    this.placing = placing;
    this.cross.hidden = !placing;
  }

  whole() {
    if (!this.way?.path.length) return;
    this.isWhole = true;
    this.setFollow(false);
    this.fitting(() => this.fit(...this.reach(), 10));
  }

  fitting(change) {
    this.isFitting = true;
    change();
    this.isFitting = false;
  }

  // Return east and north of the bounding box of the path, with start and position.
  reach() {
    const [east, north] = this.position, { path } = this.way;
    const along = (k, ...more) => path.reduce(([low, high], row) => [Math.min(low, row[k]), Math.max(high, row[k])], [Math.min(0, ...more), Math.max(0, ...more)]);
    return [along(1, east), along(2, north)];
  }

  get position() {
    return this.way?.now ? this.way.now.position_m : this.way?.path.at(-1)?.slice(1, 3) ?? [0, 0];
  }

  keepUp() {
    if (this.isZooming || !this.way) return;
    if (this.isWhole) this.fitting(() => this.showAll());
    if (!this.follow) return;
    const place = this.at(...this.position), middle = this.leaflet.getSize().divideBy(2);
    if (this.leaflet.latLngToContainerPoint(place).distanceTo(middle) > 1) this.leaflet.panTo(place, { animate: false });
  }

  // Zoom out if the path does not fit, by a fifth more than needed, so that it happens rarely.
  showAll() {
    const [easts, norths] = this.reach(), middle = this.follow ? this.position : this.place();
    const half = (values, at) => Math.max(...values.map(v => Math.abs(v - at)));
    const { x, y } = this.leaflet.getSize();
    const share = Math.min((x / 2 - MARGIN) / half(easts, middle[0]), (y / 2 - MARGIN) / half(norths, middle[1])) / this.scale;
    if (share >= 1 || !(share > 0)) return;
    if (this.follow) this.leaflet.setView(this.at(...middle), this.leaflet.getZoom() + Math.log2(0.8 * share), { animate: false });
    else this.fit(easts, norths, 10);
  }

  show(way, hasNorth) {
    if (way !== this.way) { // another phone: reset the view
      this.isWhole = true;
      this.fitting(() => this.leaflet.setView(this.at(0, 0), Math.log2(10), { animate: false }));
    }
    this.way = way;
    this.box.querySelector(".north").hidden = !hasNorth;
    this.settle(this.tiles && way.origin ? way.origin : "");
    this.keepUp();
    const { now, path } = way;
    this.drawPath(path);
    this.drawFixes(way.fixes);
    for (const place of way.anchors.values()) this.fixes.addLayer(this.mark(this.at(...place), "anchor", "", 12));
    const steps = (now?.provisional_steps ?? []).map(step => this.at(...step.position_m));
    this.provisional.setLatLngs(steps.length && path.length ? [this.at(...path.at(-1).slice(1, 3)), ...steps] : steps);
    if (!now) {
      this.within.setLatLngs([]);
      this.walker.remove();
      return;
    }
    const [[ee, en], [, nn]] = now.position_cov_m2;
    const mean = (ee + nn) / 2, root = Math.hypot((ee - nn) / 2, en);
    const axes = [mean + root, Math.max(mean - root, 0)].map(v => Math.sqrt(v) * ELLIPSE_95);
    this.within.setLatLngs(this.ellipse(this.position, ...axes, 0.5 * Math.atan2(2 * en, ee - nn)));
    this.stand(this.at(...this.position), now.walking_heading_rad);
  }

  // Draw again in other coordinates if the geographic origin has changed.
  settle(origin) {
    if (String(origin) === this.origin) return;
    this.origin = String(origin);
    this.drawn.path = null;
    this.lieOn(this.tiles, origin);
  }

  drawPath(path) {
    const { drawn } = this, last = path.at(-1);
    if (path === drawn.path && path.length === drawn.n && last === drawn.last) return;
    const isCorrected = drawn.path && path !== drawn.path && drawn.way === this.way && drawn.n > 1;
    this.drawn = { path, n: path.length, last, way: this.way };
    const places = path.map(row => this.at(row[1], row[2]));
    if (isCorrected) this.fadeOut(this.path.getLatLngs());
    this.path.setLatLngs(places);
    if (last) this.start.setLatLng(places[0]).addTo(this.leaflet);
    else this.start.remove();
  }

  // Show the path before a correction on top of the new path, until it has faded.
  fadeOut(places) {
    const former = L.polyline(places, { renderer: this.above, className: "former", weight: 3, interactive: false }).addTo(this.leaflet);
    setTimeout(() => former.remove(), FADE_MS);
  }

  // Draw a fix as a cross, faint while it waits and red if it was rejected.
  drawFixes(fixes) {
    this.fixes.clearLayers();
    for (const { place, outcome } of fixes) {
      const name = { waiting: "waiting", rejected: "rejected", frozen: "rejected", "nothing to compare": "waiting" }[outcome] ?? "used";
      this.fixes.addLayer(this.mark(this.at(...place), `cross ${name}`, "", 12));
    }
  }
}
