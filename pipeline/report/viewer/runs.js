// The list: found by words, put in order by a column, two of them ticked to be compared.

let rows = [], order = { by: "changed", down: true };
const ticked = new Set(JSON.parse(sessionStorage.getItem("ticked") || "[]")); // kept while a run is looked at

// label: of the column, which is read beside the value where the window is too narrow for a table.
function cell(line, content, kind, label) {
  const made = line.insertCell();
  if (label) made.dataset.label = label;
  if (kind) made.className = kind;
  made.append(content);
  return made;
}

function link(text, href) { return Object.assign(document.createElement("a"), { textContent: text, href }); }

function tick(run) {
  const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: ticked.has(run.name) });
  box.setAttribute("aria-label", `compare ${run.name}`);
  box.disabled = run.status !== "finished";
  box.addEventListener("change", () => {
    if (box.checked) ticked.add(run.name); else ticked.delete(run.name);
    remember();
  });
  return box;
}

function remember() {
  sessionStorage.setItem("ticked", JSON.stringify([...ticked]));
  part("compare").disabled = ticked.size !== 2;
}

function nameCell(run) {
  const box = document.createElement("div"), finished = run.status === "finished";
  box.append(finished ? link(run.name, `/play?run=${encodeURIComponent(run.name)}`) : run.name);
  if (finished) box.append(" · ", link("report", path("report", run.name)));
  if (run.words.length) box.append(folded(run.words));
  return box;
}

function draw() {
  const words = part("find").value.toLowerCase().split(/\s+/);
  const shown = rows.filter(run => words.every(word => `${run.name} ${run.status} ${run.settings} ${run.words.join(" ")}`.toLowerCase().includes(word)));
  const value = run => run[order.by] ?? -Infinity;
  shown.sort((a, b) => (value(a) < value(b) ? -1 : value(a) > value(b) ? 1 : a.name.localeCompare(b.name)) * (order.down ? -1 : 1));
  const body = part("runs").tBodies[0];
  body.replaceChildren();
  for (const run of shown) {
    const line = body.insertRow(), finished = run.status === "finished", pictured = run.picture !== null;
    cell(line, tick(run));
    cell(line, pictured ? Object.assign(new Image(), { src: path("frame", run.name, String(run.picture)), alt: "", loading: "lazy" }) : "");
    cell(line, nameCell(run), "name");
    cell(line, run.warnings ? `${run.status}, ${run.warnings} warning${run.warnings > 1 ? "s" : ""}` : run.status, "", "status");
    cell(line, run.posed === null ? "–" : `${run.posed} of ${run.total}`, "number", "frames posed");
    cell(line, run.seen_percent === null ? (finished ? "not judged" : "–") : `${run.seen_percent.toFixed(0)} %`, "number", "wall seen");
    cell(line, run.area === null ? "–" : `${figure(run.area)} ${run.unit}²`, "number", "surface");
    cell(line, figure(run.submaps), "number", "submaps");
    cell(line, run.settings || "–", "", "settings");
    cell(line, new Date(1000 * run.changed).toLocaleString("en-GB", { dateStyle: "short", timeStyle: "short" }), "", "changed");
  }
  document.querySelectorAll("#runs th button").forEach(head => {
    const here = head.dataset.by === order.by;
    head.parentElement.setAttribute("aria-sort", here ? (order.down ? "descending" : "ascending") : "none");
  });
  part("count").textContent = `${shown.length} of ${rows.length} runs`;
}

part("find").addEventListener("input", draw);
part("tools").addEventListener("submit", event => {
  event.preventDefault();
  const [a, b] = [...ticked];
  if (ticked.size === 2) location.href = `/compare?a=${encodeURIComponent(a)}&b=${encodeURIComponent(b)}`;
});
document.querySelectorAll("#runs th button").forEach(head => head.addEventListener("click", () => {
  order = { by: head.dataset.by, down: head.dataset.by === order.by ? !order.down : false };
  draw();
}));
ask("runs").then(found => {
  rows = found.runs;
  part("about").textContent = found.folder;
  for (const name of ticked) if (!rows.some(run => run.name === name && run.status === "finished")) ticked.delete(name);
  remember();
  draw();
  ready();
}).catch(fault);
