"use strict";
// Parts of all pages of the workbench: texts, requests, messages.

const about = JSON.parse(byId("about").textContent);
const text = (key, values = {}) => about.texts[key].replace(/\{(\w+)\}/g, (_, name) => values[name]);
const number = (value, digits = 1) => Number(value).toFixed(digits);

// Show a message; a change that can be made again has a button for it.
function say(words, isWrong = false, again = null) {
  const box = byId("said");
  box.className = isWrong ? "wrong" : "";
  box.replaceChildren(...words ? [words] : []);
  if (again) box.append(" ", element("button", { type: "button", onclick: again }, text("again")));
}

// The answer of the server; an Error with its words and its status otherwise.
async function ask(address, content) {
  let answer;
  try {
    const isFile = content instanceof Blob;
    answer = await fetch(address, content === undefined ? {} : { method: "POST", body: isFile ? content : JSON.stringify(content) });
  } catch {
    throw new Error(text("not_reached"));
  }
  const found = await answer.json();
  if (!answer.ok) throw Object.assign(new Error(found.error), { status: answer.status });
  return found;
}

// Do something that may fail; its error becomes a message.
async function attempt(work) {
  try {
    return await work();
  } catch (error) {
    say(error.message, true);
    return null;
  }
}

// Changes are saved one after the other: each begins from what the one before has left.
let lastTurn = Promise.resolve();
const inTurn = work => (lastTurn = lastTurn.then(work, work));

function onEvents(take) {
  const events = new EventSource("/events");
  events.onmessage = message => take(JSON.parse(message.data));
  events.onerror = () => say(text("not_reached"), true);
  events.onopen = () => { if (byId("said").textContent.trim() === text("not_reached")) say(""); };
}
