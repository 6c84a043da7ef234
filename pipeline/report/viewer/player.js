// One run: its film, the last keyframe's depth and confidence, the camera in the surface, and what was missed near here.

const name = new URLSearchParams(location.search).get("run");
let run = null, scene = null, submap = 0, current = -1, key = -1, playing = null, riding = false, maps = [];

const last = (sorted, value) => {
  let low = 0, high = sorted.length;
  while (low < high) { const middle = (low + high) >> 1; if (sorted[middle] <= value) low = middle + 1; else high = middle; }
  return low - 1;
};

function show(number) {
  const wanted = Math.max(0, Math.min(run.frames.length - 1, number));
  if (wanted === current) return;
  current = wanted;
  const [index, seconds] = run.frames[current];
  part("frame").src = path("frame", name, String(index));
  part("slider").value = current;
  part("clock").textContent = `${clockWords(seconds)} / ${clockWords(run.frames[run.frames.length - 1][1])}`;
  showKeyframe(run.keyframes[Math.max(0, last(run.keyframes, index))]);
  showPlace(index);
  showMissed(seconds);
}

function showKeyframe(frame) {
  if (frame === undefined || frame === key) return;
  key = frame;
  part("depth").src = path("depth", name, String(frame));
  part("confidence").src = path("confidence", name, String(frame));
  const scale = run.depths.find(one => one.keyframes.includes(frame));
  part("depth-scale").replaceChildren(scale ? bar(run.ramps.depth, figure(scale.low), `depth [${scale.unit}]`, figure(scale.high)) : "depth");
}

// Colours with what their ends mean, as the report has them.
function bar(ramp, ...words) {
  const made = Object.assign(document.createElement("div"), { className: "bar" });
  const colours = Object.assign(document.createElement("span"), { className: "ramp" });
  colours.style.background = ramp;
  made.append(colours, ...words.map(text => Object.assign(document.createElement("span"), { textContent: text })));
  return made;
}

// The submap that has the frame, a dot where the camera was, and the nearest keyframe's pyramid of view.
function showPlace(index) {
  const home = maps.findIndex(map => map.path.frames.length && index >= map.path.frames[0] && index <= map.path.frames[map.path.frames.length - 1]);
  part("frame-words").textContent = `frame ${index}${home < 0 ? ", without a pose" : maps.length > 1 ? `, submap ${home}` : ""}`;
  if (!scene || home < 0) return;
  const draw = () => {
    const near = maps[home].shown.reduce((best, shown) => Math.abs(frameOf(shown) - index) < Math.abs(frameOf(best) - index) ? shown : best, maps[home].shown[0]);
    if (near && near !== scene.current) { scene.select(near.keyframe); if (riding) scene.fromKeyframe(); }
  };
  if (home !== submap) { submap = home; scene.show(home).then(draw); } else draw();
}

let shownFrames = [];
const frameOf = shown => shownFrames[shown.keyframe].frame;

function showMissed(seconds) {
  const here = run.regions.filter(region => Math.abs(region.seconds - seconds) <= run.near);
  part("missed").textContent = here.length
    ? `near here wall was missed: ${here.map(region => `region ${region.number} (${figure(region.diameter)} ${run.unit} across)`).join(", ")}` : "";
  document.querySelectorAll("#regions li").forEach((item, k) => item.classList.toggle("here", here.includes(run.regions[k])));
}

function pause() {
  cancelAnimationFrame(playing);
  playing = null;
  part("play").textContent = "▶ play";
  part("play").setAttribute("aria-pressed", "false");
}

// By the film's own clock: frames that cannot be shown in time are passed over.
function play() {
  if (playing !== null) return pause();
  if (current >= run.frames.length - 1) show(0);
  part("play").textContent = "❚❚ pause";
  part("play").setAttribute("aria-pressed", "true");
  let before = null, seconds = run.frames[current][1];
  const times = run.frames.map(frame => frame[1]);
  const step = now => {
    seconds += before === null ? 0 : Number(part("speed").value) * (now - before) / 1000;
    before = now;
    if (part("frame").complete) show(Math.max(current, last(times, seconds)));
    if (current >= run.frames.length - 1) return pause();
    playing = requestAnimationFrame(step);
  };
  playing = requestAnimationFrame(step);
}

function goTo(frame) {
  pause();
  const indices = run.frames.map(one => one[0]);
  show(Math.max(0, last(indices, frame)));
}

function regionWords(region) {
  const clock = region.clock === null ? "all round" : `${region.clock.toFixed(1)} o'clock`;
  return ` ${figure(region.area)} ${run.unit}², ${figure(region.arc)} ${run.unit} along, ${clock}; nearest frame ${region.frame} (${region.seconds.toFixed(2)} s)`;
}

function listRegions() {
  const [start, end] = [run.frames[0][1], run.frames[run.frames.length - 1][1]];
  for (const region of run.regions) {
    const jump = text => {
      const button = Object.assign(document.createElement("button"), { type: "button", textContent: text });
      button.setAttribute("aria-label", `to missed region ${region.number}`);
      button.addEventListener("click", () => goTo(region.frame));
      return button;
    };
    const mark = jump(String(region.number));
    mark.style.left = `${100 * (region.seconds - start) / Math.max(end - start, 1e-9)}%`;
    part("marks").append(mark);
    const item = document.createElement("li");
    item.value = region.number;
    const look = jump("look");
    look.addEventListener("click", () => document.querySelector(".player").scrollIntoView({ block: "start" }));
    item.append(look, regionWords(region));
    part("regions").append(item);
  }
}

function listen() {
  part("slider").max = run.frames.length - 1;
  part("slider").addEventListener("input", event => { pause(); show(Number(event.target.value)); });
  part("play").addEventListener("click", play);
  part("previous").addEventListener("click", () => { pause(); show(current - 1); });
  part("next").addEventListener("click", () => { pause(); show(current + 1); });
  document.addEventListener("keydown", event => {
    if (/^(INPUT|SELECT|BUTTON)$/.test(event.target.tagName)) return;
    const to = { ArrowLeft: current - 1, ArrowRight: current + 1, Home: 0, End: run.frames.length - 1 }[event.key];
    if (event.key === " ") { event.preventDefault(); play(); } else if (to !== undefined) { event.preventDefault(); pause(); show(to); }
  });
  part("outside").addEventListener("click", () => { ride(false); if (scene) scene.fromOutside(); });
  part("inside").addEventListener("click", () => { ride(!riding); if (riding && scene) scene.fromKeyframe(); });
}

function ride(on) {
  riding = on;
  part("inside").setAttribute("aria-pressed", String(on));
}

async function start() {
  backToList();
  run = await ask("player", name);
  const data = await ask("scene", name);
  maps = data.submaps;
  shownFrames = data.shown;
  part("title").textContent = name;
  document.title = `${name} · haustra`;
  part("about").textContent = run.warnings.join("; ");
  part("coverage-words").textContent = run.coverage === null || run.coverage === undefined ? `not judged${ofLargest(run)}: ${run.reason}`
    : `${run.coverage.toFixed(0)} % of the wall along the visited lumen was seen${ofLargest(run)}; ${run.regions.length === 1 ? "1 missed region is" : `${run.regions.length} missed regions are`} listed`;
  if (run.coverage !== null && run.coverage !== undefined) Object.assign(part("coverage"), { src: path("coverage", name), hidden: false });
  part("confidence-scale").replaceChildren(bar(run.ramps.confidence, "0", "confidence", "1"));
  listRegions();
  listen();
  if (hasWebGL()) {
    scene = new Scene(part("view3d"), maps, frame => goTo(frame));
    await scene.show(0);
  } else part("no-webgl").hidden = false;
  show(0);
  ready();
}

// Why a run cannot be played, by what the list says of it.
async function refuse(error) {
  const row = (await ask("runs")).runs.find(one => one.name === name);
  if (!row) throw new Error(`the run ${name} is not there`);
  if (row.status === "finished") throw error;
  throw new Error(`the run ${name} has no surface to show (${row.status})${row.words.length ? `: ${row.words.join("; ")}` : ""}`);
}

start().catch(refuse).catch(error => {
  part("title").textContent = name || "no run";
  document.querySelectorAll("body > section, body > p:not(#fault)").forEach(one => { one.hidden = true; });
  fault(error);
});
