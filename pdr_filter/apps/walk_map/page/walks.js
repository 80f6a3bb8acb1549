"use strict";
// Map of many walks, one storey of one group at a time.
const { storeys, walks } = JSON.parse(byId("data").textContent);
const map = new PlaneMap(byId("map")), lines = L.layerGroup().addTo(map.leaflet);
let storey = storeys[0];

const whole = () => map.fit(storey.paths.flatMap(path => path.east), storey.paths.flatMap(path => path.north), 10);

// Draw the walks of the storey; one of them is on top if it is pointed at.
function draw(pointed = null) {
  lines.clearLayers();
  for (const { walk, east, north } of storey.paths) {
    const [color, isFaint] = [walks[walk], pointed !== null && walk !== pointed];
    const line = L.polyline(east.map((_, k) => map.at(east[k], north[k])), { color, weight: walk === pointed ? 4 : 2, opacity: isFaint ? 0.25 : 0.9 });
    lines.addLayer(line);
  }
}

function choose(number) {
  storey = storeys[number];
  draw();
  whole();
}

document.querySelectorAll("[name=storey]").forEach(input => input.addEventListener("change", () => choose(Number(input.value))));
document.querySelectorAll("[data-walk]").forEach(row => {
  const walk = Number(row.dataset.walk);
  row.addEventListener("mouseenter", () => draw(walk));
  row.addEventListener("mouseleave", () => draw());
});
byId("closer").addEventListener("click", () => map.zoom(1.5));
byId("farther").addEventListener("click", () => map.zoom(1 / 1.5));
byId("whole").addEventListener("click", whole);
map.leaflet.on("resize", whole);
if (storey) choose(0);
