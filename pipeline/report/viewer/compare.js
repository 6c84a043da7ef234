// Two runs beside each other, seen by one camera: what turns one turns the other, from the same side of the colon.

const wanted = new URLSearchParams(location.search);
const names = { a: wanted.get("a"), b: wanted.get("b") };
const scenes = {};
let turn = null, moving = false;

const times = (m, v) => m.map(row => row.reduce((sum, value, k) => sum + value * v[k], 0));
const transposed = m => m[0].map((_, k) => m.map(row => row[k]));
const list = ({ x, y, z }) => [x, y, z];

// Directions of A's view in B's axes, and the other way. Without a common film each run's own first view is the measure.
function turned(from, camera) {
  const rotation = from === "a" ? transposed(turn) : turn;
  const moved = name => point(times(rotation, list(camera[name])));
  return { eye: moved("eye"), center: moved("center"), up: moved("up"), projection: camera.projection };
}

function follow(from) {
  const other = from === "a" ? "b" : "a";
  if (moving || !part("link").checked) return;
  moving = true;
  const camera = turned(from, scenes[from].element.layout.scene.camera);
  Promise.resolve(scenes[other].look(camera)).finally(() => { moving = false; });
}

async function open(side) {
  const data = await ask("scene", names[side]);
  scenes[side] = new Scene(part(`view-${side}`), data.submaps, () => {});
  await scenes[side].show(0);
  scenes[side].element.on("plotly_relayout", change => { if (change["scene.camera"]) follow(side); });
  scenes[side].element.on("plotly_relayouting", change => { if (change["scene.camera"]) follow(side); });
  return data;
}

// Rows of a run's axes as its first view shows them: along, up, towards the eye.
function between(first, second) {
  return transposed(first).map(column => times(transposed(second), column));
}

function table(rows) {
  const body = part("figures").tBodies[0];
  const kinds = [
    ["frames posed", run => `${run.posed} of ${run.total}`],
    ["wall seen", run => (run.seen_percent === null ? "not judged" : `${run.seen_percent.toFixed(1)} %`) + ofLargest(run)],
    ["surface", run => `${figure(run.area, 4)} ${run.unit}²${ofLargest(run)}`],
    ["submaps", run => String(run.submaps)],
    ["settings", run => run.settings],
    ["warnings", run => run.words.length ? folded(run.words) : "none"],
  ];
  for (const [title, words] of kinds) {
    const line = body.insertRow();
    line.append(Object.assign(document.createElement("th"), { scope: "row", textContent: title }));
    for (const run of rows) line.insertCell().append(words(run));
  }
}

async function start() {
  backToList();
  const listed = (await ask("runs")).runs;
  const rows = ["a", "b"].map(side => listed.find(run => run.name === names[side]));
  if (rows.some(run => !run || run.status !== "finished")) throw new Error("two finished runs of this folder are needed");
  part("title").textContent = "Two runs";
  for (const side of ["a", "b"]) {
    part(`name-${side}`).textContent = part(`head-${side}`).textContent = names[side];
    const map = part(`map-${side}`), row = rows[side === "a" ? 0 : 1];
    if (row.seen_percent === null) {
      map.replaceWith(Object.assign(document.createElement("p"), { className: "fine", textContent: `coverage of ${names[side]} was not judged` }));
      continue;
    }
    Object.assign(map, { src: path("coverage", names[side]), alt: `coverage of ${names[side]}`, hidden: false });
  }
  table(rows);
  if (!hasWebGL()) throw new Error("this browser shows no WebGL, so the surfaces cannot be turned; figures are below");
  const [first, second] = [await open("a"), await open("b")];
  turn = await ask("turn", `${names.a}::${names.b}`);
  part("linked").textContent = turn ? "Both are of one film: the camera looks at both from the same side."
    : "These are different films, or they share too few poses: the camera turns both from their own first views.";
  turn = turn || between(first.submaps[0].axes, second.submaps[0].axes);
  part("outside").addEventListener("click", () => scenes.a.fromOutside().then(() => follow("a")));
  part("link").addEventListener("change", () => follow("a"));
  for (const [name, set] of [["wall", "setWall"], ["paint", "setPaint"]])
    part(name).addEventListener("change", event => { scenes.a[set](event.target.value); scenes.b[set](event.target.value); });
  follow("a");
  ready();
}

start().catch(fault);
