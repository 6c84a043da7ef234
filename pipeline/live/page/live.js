"use strict";
// The page of a live session: asks for the state several times a second and says it in few words.

const JUST_S = 15; // since a missed place was passed
const ASK_MS = 400, RETRY_MS = 1000;
const $ = id => document.getElementById(id);
const WORDS = {
  waiting: ["…", "Waiting for pictures"], starting: ["◌", "Starting"], tracking: ["✓", "Tracking"],
  lost: ["✕", "Lost"], "no view": ["◍", "No view"], "no pictures": ["◍", "No pictures"], done: ["■", "Finished"], failed: ["✕", "Stopped"],
};
const scene = new LiveScene($("view3d"));
let latest = null;

function headline(state) {
  if (state.phase === "opening") return ["…", "Getting ready", "the network is being loaded", "waiting"];
  if (state.phase === "finishing") {
    const { label, done, total } = state.finishing, share = total ? ` ${Math.round(100 * done / total)} %` : "";
    return ["■", "Recording ended", `the whole film is being reconstructed: ${label}${share}`, "done"];
  }
  if (state.phase === "ending") return ["■", "Recording ended", "the last keyframes are being completed", "done"];
  if (state.phase === "recorded") return ["■", "Recorded", "haustra live --resume makes the run of it", "done"];
  if (state.phase === "done") return [...WORDS.done, "the run is complete: open its report with haustra view", "done"];
  if (state.phase === "failed") return [...WORDS.failed, state.advice, "failed"];
  const advice = state.fault ? `${state.advice ? `${state.advice}; ` : ""}${state.fault}` : state.advice;
  return [...WORDS[state.view], advice, state.view];
}

function say(id, text) { if ($(id).textContent !== text) $(id).textContent = text; }

function show(state) {
  latest = state;
  const [sign, words, advice, view] = headline(state);
  $("banner").dataset.view = view;
  say("sign", sign); say("headline", words); say("advice", advice); say("time", clock(state.seconds));
  $("stop").disabled = state.phase !== "live";
  $("back-to").hidden = !(state.phase === "live" && state.view === "lost" && state.pictures.includes("back.jpg"));
  const shown = new Set(state.pictures), stamp = `?${Date.now()}`;
  if (shown.has("frame.jpg")) $("frame").src = `/frame.jpg${stamp}`;
  if (shown.has("depth.png")) $("depth").src = `/depth.png?${state.counts.shown}`;
  if (!$("back-to").hidden) $("back").src = `/back.jpg?${state.counts.shown}`;
  showCoverage(state);
  showCounts(state);
  const said = state.sentences.map(sentence => { const li = document.createElement("li"); li.textContent = sentence; return li; });
  $("sentences").replaceChildren(...said);
  $("empty").hidden = state.parts.length > 0 || !scene.empty;
  const earlier = state.earlier ? `; ${state.earlier} ${state.earlier === 1 ? "part" : "parts"} from before the camera was lost not shown` : "";
  say("mesh-note", state.parts.length ? `${state.faces.toLocaleString("en")} triangles, scene units${earlier}` : "");
  return scene.update(state);
}

function clock(seconds) { return `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`; }

function hours(hour) { return hour === null ? "all round" : `${Math.round(hour) || 12} o'clock`; }

function counted(count, noun, what) { return count ? `; ${count} ${noun}${count === 1 ? "" : "s"} ${what}` : ""; }

function showCoverage(state) {
  const seen = state.coverage, missed = seen ? seen.missed : [];
  say("covered", seen && seen.covered !== null ? `${seen.covered.toFixed(0)} %` : "–");
  say("covered-words", !seen ? "not measured yet" : seen.covered === null ? seen.reason
    : `of the wall passed from ${clock(seen.since)} to ${clock(seen.until)}`
    + counted(seen.loops, "loop", "closed") + counted(seen.joined, "earlier map", "recognised"));
  drawDial(Boolean(seen && seen.covered !== null), missed);
  const items = missed.map((place, k) => {
    const li = document.createElement("li"), ago = Math.max(0, state.seconds - place.seconds).toFixed(0);
    li.textContent = `${k || ago > JUST_S ? "" : "just missed: "}${hours(place.clock)}, ${place.diameter.toFixed(1)} lumen diameters wide, passed ${ago} s ago`;
    return li;
  });
  if (seen && seen.more) {
    const rest = document.createElement("li");
    rest.textContent = `and ${seen.more} more before`;
    items.push(rest);
  }
  $("missed").replaceChildren(...items);
}

function drawDial(known, missed) {
  const ring = `<circle r="44" class="${known ? "" : "unknown"}"/>`;
  const arcs = missed.map(place => {
    if (place.clock === null) return '<path d="M 0 -44 A 44 44 0 1 1 -0.1 -44"/>';
    const half = Math.min(Math.PI / 2, Math.max(0.2, place.diameter)), middle = place.clock / 12 * 2 * Math.PI;
    const at = angle => `${44 * Math.sin(angle)} ${-44 * Math.cos(angle)}`;
    return `<path d="M ${at(middle - half)} A 44 44 0 0 1 ${at(middle + half)}"/>`;
  });
  const hour = (text, x, y) => `<text x="${x}" y="${y}">${text}</text>`;
  $("dial").innerHTML = ring + arcs.join("") + hour("12", 0, -28) + hour("3", 28, 0) + hour("6", 0, 28) + hour("9", -28, 0);
}

function showCounts({ counts, rate, latency, phase }) {
  const rows = [
    ["tracked", `${rate.toFixed(0)} frames/s; ${counts.posed} of ${counts.came} frames posed`],
    ["not kept up with", `${counts.skipped} frames, ${counts.dropped} keyframes skipped`, counts.skipped + counts.dropped > 0],
    ["unusable", `${counts.unusable} frames: black, blurred, still or without texture`],
    ["surface", `${counts.shown} keyframes` + (latency ? `, ${latency.median.toFixed(1)} s after their picture (worst ${latency.worst.toFixed(1)} s)` : "")],
    ["maps", String(counts.maps)],
  ];
  $("counts").replaceChildren(...rows.flatMap(([name, text, loss]) => {
    const dt = document.createElement("dt"), dd = document.createElement("dd");
    dt.textContent = name; dd.textContent = text; dd.className = loss ? "loss" : "";
    return [dt, dd];
  }));
}

async function ask() {
  let wait = ASK_MS;
  let state = null;
  try {
    state = await (await fetch("/state")).json();
  } catch {
    wait = RETRY_MS;
    if (latest) ended();
  }
  if (state) await show(state).catch(error => console.error(error));
  setTimeout(ask, wait);
}

// No answer any more: the last words stay, but for a session that was cut off.
function ended() {
  $("stop").disabled = true;
  if (["done", "recorded", "failed"].includes(latest.phase)) return;
  $("banner").dataset.view = "failed";
  say("sign", "✕"); say("headline", "No answer"); say("advice", "the session was ended; haustra live --resume goes on with it");
}

function stop() {
  if (!latest || latest.phase !== "live") return;
  fetch("/stop", { method: "POST", headers: { "X-Haustra": "stop" } });
  $("stop").disabled = true;
}

$("stop").addEventListener("click", stop);
document.addEventListener("keydown", event => { if (event.key === "q" && !event.ctrlKey && !event.metaKey) stop(); });
$("follow").addEventListener("click", () => { scene.setFollowing(true); scene.changed = true; if (latest && scene.ready) scene.draw(latest); });
$("outside").addEventListener("click", () => latest && scene.ready && scene.outside(latest));
$("view3d").addEventListener("following", ({ detail }) => {
  $("follow").setAttribute("aria-pressed", detail);
  $("outside").setAttribute("aria-pressed", !detail);
});
$("theme").addEventListener("click", () => {
  const dark = document.documentElement.dataset.theme === "dark" || (!document.documentElement.dataset.theme && matchMedia("(prefers-color-scheme: dark)").matches);
  document.documentElement.dataset.theme = dark ? "light" : "dark";
});
ask();
