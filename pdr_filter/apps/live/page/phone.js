"use strict";
// Send the DeviceMotion events of this phone over WebSocket. The docstring of messages.py describes the messages.

const PART_MS = 200;
const KEPT = 600; // maximum number of messages that wait for a connection, two minutes
const say = (words, wrong = false) => {
  document.getElementById("said").textContent = words;
  document.getElementById("said").className = wrong ? "wrong" : "";
};
const isApple = () => /iPhone|iPad|iPod/.test(navigator.userAgent) || (navigator.platform === "MacIntel" && navigator.maxTouchPoints > 1);
const RADIANS = Math.PI / 180;

let running = null;

class Sender {
  constructor(name, height) {
    this.device = name;
    this.about = height ? { meta: { subject: { height_m: height } } } : {};
    this.session = Array.from(crypto.getRandomValues(new Uint8Array(6)), b => b.toString(16).padStart(2, "0")).join("");
    this.number = 0;
    this.waiting = []; // messages without acknowledgement
    this.samples = this.empty();
    this.seen = 0;
    this.hear = event => this.heard(event);
    addEventListener("devicemotion", this.hear);
    this.timer = setInterval(() => this.send(), PART_MS);
    this.connect();
  }

  empty() {
    return { accelerometer: [], gyroscope: [] };
  }

  heard(event) {
    const time = event.timeStamp / 1000, force = event.accelerationIncludingGravity, rate = event.rotationRate;
    if (force && force.x !== null) this.samples.accelerometer.push([time, force.x, force.y, force.z]);
    // alpha is about z, beta about x, gamma about y, in degrees per second
    if (rate && rate.alpha !== null) {
      this.samples.gyroscope.push([time, rate.beta * RADIANS, rate.gamma * RADIANS, rate.alpha * RADIANS]);
    }
    this.seen += 1;
  }

  send(end = false) {
    if (this.samples.accelerometer.length || this.samples.gyroscope.length || end) {
      this.waiting.push(JSON.stringify({
        device: this.device, session: this.session, number: this.number++, platform: isApple() ? "ios" : "android",
        samples: this.samples, ...this.about, ...(end ? { end: true } : {}),
      }));
      this.samples = this.empty();
      if (this.waiting.length > KEPT) this.waiting.shift();
      if (this.socket.readyState === WebSocket.OPEN) this.socket.send(this.waiting.at(-1));
    }
    if (!this.seen && performance.now() - this.begun > 3000) {
      say("No motion comes from this browser. It needs https and, on iOS, the permission that Start asks for.", true);
    }
  }

  connect() {
    this.begun ??= performance.now();
    const address = new URL("stream" + location.search, location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    this.socket = new WebSocket(address);
    const shown = document.getElementById("connection");
    this.socket.onopen = () => {
      shown.textContent = "connected";
      this.waiting.forEach(message => this.socket.send(message)); // the server recognises duplicates by their number
    };
    this.socket.onmessage = event => {
      const answer = JSON.parse(event.data);
      if (answer.status === 503 || answer.status === 429) return this.socket.close(); // close, and retry later from the same message
      this.waiting.shift();
      if (answer.error) say(answer.error, true);
      else say(`${this.number} messages sent`);
      return undefined;
    };
    this.socket.onclose = () => {
      shown.textContent = "not connected, trying again";
      if (!this.ended) setTimeout(() => this.connect(), 1000);
    };
  }

  end() {
    removeEventListener("devicemotion", this.hear);
    clearInterval(this.timer);
    this.send(true);
    this.ended = true;
    setTimeout(() => this.socket.close(), 1000);
  }
}

async function start() {
  const button = document.getElementById("start");
  if (running) {
    running.end();
    running = null;
    button.textContent = "Start";
    return;
  }
  const height = document.getElementById("height");
  if (!height.reportValidity()) return;
  if (typeof DeviceMotionEvent === "undefined" || !isSecureContext) {
    say("This browser provides motion sensors only to https pages: start the server with --https, or use an app.", true);
    return;
  }
  if (DeviceMotionEvent.requestPermission && await DeviceMotionEvent.requestPermission() !== "granted") {
    say("Access to the motion sensors was denied: close the page, open it again, tap Start and allow access.", true);
    return;
  }
  navigator.wakeLock?.request("screen").catch(() => {});
  running = new Sender(document.getElementById("name").value.trim() || "browser", height.valueAsNumber);
  button.textContent = "Stop";
}

document.getElementById("start").addEventListener("click", start);
document.getElementById("name").value = `browser ${isApple() ? "iOS" : navigator.userAgentData?.platform ?? ""}`.trim();
