"use strict";
// The list of walks, with files that are dropped onto it.

const AT_ONCE = 300; // rows that are drawn; a button shows more
const walks = new Map(), rows = new Map();
let nShown = AT_ONCE;

// --- the list --------------------------------------------------------------------------------------------------------

function picture(walk) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", text("picture_of", { name: walk.name }));
  const { path } = walk;
  if (!path?.length) return svg;
  const [easts, norths] = [0, 1].map(k => path.map(point => point[k]));
  const low = [Math.min(...easts), Math.min(...norths)], high = [Math.max(...easts), Math.max(...norths)];
  const size = Math.max(high[0] - low[0], high[1] - low[1], 4), margin = 0.06 * size;
  const corner = [(low[0] + high[0] - size) / 2 - margin, -(low[1] + high[1] + size) / 2 - margin];
  svg.setAttribute("viewBox", `${corner[0]} ${corner[1]} ${size + 2 * margin} ${size + 2 * margin}`);
  const line = document.createElementNS(svg.namespaceURI, "polyline");
  line.setAttribute("points", path.map(([east, north]) => `${east},${-north}`).join(" "));
  svg.append(line);
  return svg;
}

function facts(walk) {
  if (walk.state === "failed") return `${text("state_failed")}: ${walk.reason}`;
  if (walk.n_steps === undefined) return text(`state_${walk.state}`);
  const date = new Date(1000 * (walk.epoch_s ?? walk.changed_s)).toLocaleString(about.texts.language, { dateStyle: "medium", timeStyle: "short" });
  const found = [walk.epoch_s ? date : text("file_of", { date }), clock(walk.duration_s), text("steps", { n: walk.n_steps }), `${number(walk.distance_m, 0)} m`];
  if (walk.subject) found.unshift(walk.subject);
  if (walk.state !== "done") found.push(text(`state_${walk.state}`));
  return found.join(" · ");
}

function row(walk) {
  const notes = walk.notes ?? [], name = element("span", { className: "name" }, walk.name);
  const link = walk.state === "failed" ? name : element("a", { href: `/walk/${walk.id}` }, name);
  const made = element("li", { id: `walk-${walk.id}`, className: walk.state }, picture(walk),
    element("div", {}, link, element("p", { className: "faint" }, facts(walk))));
  if (walk.state === "working") made.lastChild.append(element("progress", { max: 1, value: walk.done ?? 0, ariaLabel: text("state_working") }));
  if (notes.length) {
    const words = notes.length === 1 ? text("one_warning") : text("n_warnings", { n: notes.length });
    made.lastChild.append(element("details", {}, element("summary", {}, words), element("ul", {}, ...notes.map(note => element("li", {}, note)))));
  }
  return made;
}

function draw() {
  const wanted = byId("filter").value.toLowerCase(), all = [...walks.values()];
  const found = all.filter(walk => `${walk.name} ${walk.subject}`.toLowerCase().includes(wanted));
  rows.clear();
  for (const walk of found.slice(0, nShown)) rows.set(walk.id, row(walk));
  byId("list").replaceChildren(...rows.values());
  byId("more").hidden = found.length <= nShown;
  byId("more").textContent = text("more", { n: found.length - nShown });
  byId("empty").hidden = all.length > 0;
  count();
}

function count() {
  const all = [...walks.values()], nDone = all.filter(walk => ["done", "failed"].includes(walk.state)).length;
  byId("done").textContent = text("n_done", { done: nDone, n: all.length });
}

onEvents(event => {
  if (event.event === "all") {
    walks.clear();
    for (const walk of event.walks) walks.set(walk.id, walk);
    draw();
  } else if (event.event === "walk") {
    const isNew = !walks.has(event.id);
    walks.set(event.id, event);
    if (isNew) draw();
    const old = rows.get(event.id);
    if (!old) return count();
    rows.set(event.id, row(event));
    old.replaceWith(rows.get(event.id));
    count();
  } else if (event.event === "progress") {
    const bar = rows.get(event.id)?.querySelector("progress");
    if (bar) bar.value = event.done;
  } else if (event.event === "gone") {
    walks.delete(event.id);
    draw();
  }
});
byId("filter").addEventListener("input", draw);
byId("more").addEventListener("click", () => {
  nShown += AT_ONCE;
  draw();
});

// --- dropped files ---------------------------------------------------------------------------------------------------

// Files of an entry that is dropped, with their paths in it.
async function filesOf(entry, path = "") {
  if (entry.name.startsWith(".")) return [];
  if (entry.isFile) return [[path + entry.name, await new Promise((done, failed) => entry.file(done, failed))]];
  const reader = entry.createReader(), found = [];
  for (;;) { // a reader gives a hundred at a time
    const some = await new Promise((done, failed) => reader.readEntries(done, failed));
    if (!some.length) return found;
    for (const each of some) found.push(...await filesOf(each, `${path}${entry.name}/`));
  }
}

function send(address, file, onProgress) {
  return new Promise((done, failed) => {
    const request = new XMLHttpRequest(); // fetch does not tell the progress
    request.open("POST", address);
    request.upload.onprogress = event => onProgress(event.loaded / event.total);
    request.onload = () => request.status === 200 ? done() : failed(new Error(JSON.parse(request.responseText).error));
    request.onerror = () => failed(new Error(text("not_reached")));
    request.send(file);
  });
}

// Files that are one recording or one folder of recordings.
async function take(name, files) {
  const token = [...crypto.getRandomValues(new Uint8Array(8))].map(byte => byte.toString(16).padStart(2, "0")).join("");
  const state = element("span", {}), bar = element("progress", { max: files.length, value: 0, ariaLabel: name });
  byId("drops").append(element("li", {}, element("b", {}, name), " ", state, " ", bar));
  state.textContent = text("uploading");
  try {
    for (const [k, [path, file]] of files.entries()) {
      await send(`/drops/${token}?name=${encodeURIComponent(path)}`, file, part => { bar.value = k + part; });
    }
    state.textContent = text("checking");
    await ask(`/drops/${token}/end?name=${encodeURIComponent(name)}`, {});
    state.textContent = text("added");
  } catch (error) {
    state.textContent = text("refused", { reason: error.message });
    state.className = "wrong";
  }
  bar.remove();
}

addEventListener("dragover", event => {
  event.preventDefault();
  byId("drop").classList.add("over");
});
addEventListener("dragleave", () => byId("drop").classList.remove("over"));
addEventListener("drop", async event => {
  event.preventDefault();
  byId("drop").classList.remove("over");
  const entries = [...event.dataTransfer.items].map(item => item.webkitGetAsEntry()).filter(entry => entry);
  for (const entry of entries) await take(entry.name, await filesOf(entry));
});
byId("files").addEventListener("change", async event => {
  for (const file of [...event.target.files]) await take(file.name, [[file.name, file]]);
  event.target.value = "";
});
byId("folder").addEventListener("change", async event => {
  const files = [...event.target.files].filter(file => !file.name.startsWith("."));
  if (files.length) await take(files[0].webkitRelativePath.split("/")[0], files.map(file => [file.webkitRelativePath, file]));
  event.target.value = "";
});

// --- floor plans, phones, other browsers -----------------------------------------------------------------------------

attempt(async () => {
  const found = await ask("/walks");
  byId("folder-name").textContent = found.folder;
  byId("plan-list").replaceChildren(...found.plans.map(name => element("li", {}, element("a", { href: `/plan/${encodeURIComponent(name)}` }, name))));
  byId("link").value = found.address;
  byId("phone-off").hidden = Boolean(found.phone);
  byId("phone-on").hidden = !found.phone;
  if (found.phone) {
    byId("phone-address").textContent = found.phone.address;
    byId("phone-code").innerHTML = found.phone.code; // made by the server from the address alone
  }
});
byId("copy").addEventListener("click", async () => {
  byId("link").select();
  await navigator.clipboard.writeText(byId("link").value);
  say(text("copied"));
});
const addPlan = content => attempt(async () => {
  const { name } = await ask("/plans", content);
  location.href = `/plan/${encodeURIComponent(name)}`;
});
byId("new-plan").addEventListener("submit", event => {
  event.preventDefault();
  addPlan({ name: byId("plan-name").value });
});
byId("plan-file").addEventListener("change", async ({ target }) => {
  const [file] = target.files;
  await addPlan({ name: file.name.replace(/\.(geo)?json$/i, ""), file: await file.text() });
  target.value = "";
});
