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

// Of which submap figures are that are of the largest one alone.
function ofLargest(run) { return run.submaps > 1 ? ` (largest of ${run.submaps} submaps)` : ""; }

function figure(value, digits = 3) {
  return value === null || value === undefined ? "–" : Number(value.toPrecision(digits)).toLocaleString("en");
}

function clockWords(seconds) {
  return `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(1).padStart(4, "0")}`;
}

// Warnings in one line: the first one's first clause and how many there are; all of them when it is opened.
function folded(words) {
  const clause = words[0].split(/[:;] /)[0];
  if (words.length === 1 && clause === words[0]) return Object.assign(document.createElement("div"), { className: "words", textContent: clause });
  const box = Object.assign(document.createElement("details"), { className: "words" });
  const line = document.createElement("summary"), list = document.createElement("ul");
  line.append(Object.assign(document.createElement("span"), { className: "clause", textContent: clause }));
  if (words.length > 1) line.append(Object.assign(document.createElement("span"), { textContent: ` and ${words.length - 1} more` }));
  list.append(...words.map(text => Object.assign(document.createElement("li"), { textContent: text })));
  box.append(line, list);
  return box;
}

function hasWebGL() {
  const probe = document.createElement("canvas");
  return Boolean(probe.getContext("webgl2") || probe.getContext("webgl"));
}

document.documentElement.classList.add("js");
