"use strict";
// What the viewer's pages share: their parts by name, answers of the server, figures in words.

const part = name => document.getElementById(name);
const path = (...parts) => "/" + parts.map((text, k) => k ? text.split("/").map(encodeURIComponent).join("/") : text).join("/");

async function ask(...parts) {
  const answer = await fetch(path(...parts));
  if (!answer.ok) throw new Error(`${parts.join(" ")}: not there`);
  return answer.json();
}

function fault(error) {
  part("fault").textContent = String(error.message || error);
  part("fault").hidden = false;
  ready();
}

function ready() { document.documentElement.dataset.ready = "yes"; }

function backToList() {
  part("back").append(Object.assign(document.createElement("a"), { href: "/", textContent: "all runs" }));
}

function figure(value, digits = 3) {
  return value === null || value === undefined ? "–" : Number(value.toPrecision(digits)).toLocaleString("en");
}

function clockWords(seconds) {
  return `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(1).padStart(4, "0")}`;
}

function hasWebGL() {
  const probe = document.createElement("canvas");
  return Boolean(probe.getContext("webgl2") || probe.getContext("webgl"));
}

document.documentElement.classList.add("js");
