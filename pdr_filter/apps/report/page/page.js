"use strict";
// Parts of all pages: elements, times, and the theme, which is that of the system until the user changes it.

const byId = id => document.getElementById(id);

// A clock time of seconds, such as 1:05 or 2:03:04.
const clock = (s, digits = 0) => {
  const whole = Math.floor(s / 60), rest = (s - 60 * whole).toFixed(digits).padStart(digits ? 3 + digits : 2, "0");
  return whole >= 60 ? `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}:${rest}` : `${whole}:${rest}`;
};

// An element with properties and children; texts are never taken for HTML.
function element(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name in made && name !== "list") made[name] = value; else made.setAttribute(name, value);
  }
  made.append(...children);
  return made;
}

// Colour of a CSS variable of the page.
const styleColour = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// Canvases are redrawn on the event "themed".
function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  dispatchEvent(new Event("themed"));
}
const isDark = () => document.documentElement.dataset.theme === "dark";
const scheme = matchMedia("(prefers-color-scheme: dark)");
const followScheme = () => setTheme(scheme.matches ? "dark" : "light");
scheme.addEventListener("change", followScheme);
document.addEventListener("click", ({ target }) => { if (target.id === "theme") setTheme(isDark() ? "light" : "dark"); });
followScheme();
