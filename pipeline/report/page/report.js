// The page: which keyframe is looked at, and everything that shows or changes it.

const page = name => document.getElementById(name);
const run = JSON.parse(page("run-data").textContent);
const articles = [...document.querySelectorAll(".keyframe")];
let current = -1, submap = 0, scene = null;

// Show a keyframe everywhere: pictures, slider, timeline, and the 3-D view of its submap. region: the number, as text, of
// a missed region that it was opened for; the rings of others are pale then.
function select(number, region) {
  document.querySelectorAll(".ring").forEach(ring => ring.classList.toggle("pale", region !== undefined && ring.textContent !== region));
  const wanted = Math.max(0, Math.min(articles.length - 1, number));
  if (!articles.length || wanted === current) return;
  current = wanted;
  const shown = run.shown[current];
  articles.forEach((article, k) => article.classList.toggle("current", k === current));
  document.querySelectorAll(".legend").forEach(bar => bar.classList.toggle("current", Number(bar.dataset.submap) === shown.submap));
  document.querySelectorAll("#timeline .shown").forEach((mark, k) => mark.classList.toggle("current", k === current));
  page("slider").value = current;
  page("cursor").setAttribute("x", 1000 * (shown.seconds - run.seconds[0]) / (run.seconds[1] - run.seconds[0]) + 1);
  if (!scene) return;
  if (shown.submap !== submap) showSubmap(shown.submap).then(() => scene.select(current));
  else scene.select(current);
}

// The keyframe of the page that is nearest in `value`, within a submap if one is named.
function nearest(value, of, within) {
  const distance = shown => (within === undefined || shown.submap === within ? 0 : 1e12) + Math.abs(of(shown) - value);
  return run.shown.reduce((best, shown, k) => distance(shown) < distance(run.shown[best]) ? k : best, 0);
}

// Rings in the keyframes' pictures in the direction of missed regions, whatever wall hides them there.
function markRegions() {
  run.submaps.forEach(map => map.missed.regions.filter(region => region.at).forEach(region => {
    const image = articles[region.keyframe].querySelector("img"), figure = image.closest("figure");
    if (image.parentElement === figure) {
      const frame = Object.assign(document.createElement("div"), { className: "marked" });
      image.replaceWith(frame);
      frame.append(image);
      figure.querySelector("figcaption").append("; rings: missed wall lies in this direction, often behind what is seen here");
    }
    const ring = Object.assign(document.createElement("span"), { className: "ring", textContent: region.number, title: region.words });
    [ring.style.left, ring.style.top] = region.at.map(share => `${100 * share}%`);
    image.parentElement.append(ring);
  }));
}

function showSubmap(number) {
  submap = number;
  const map = run.submaps[number];
  page("submap").value = number;
  page("mesh-note").textContent = map.triangles < map.all_triangles
    ? `${map.triangles.toLocaleString("en")} of ${map.all_triangles.toLocaleString("en")} triangles` : "";
  page("scale-bar").textContent = `box ${map.high.map((high, k) => Number((high - map.low[k]).toPrecision(3)).toLocaleString("en")).join(" × ")} ${map.unit}`;
  return scene.show(number);
}

function startScene() {
  const probe = document.createElement("canvas");
  if (!probe.getContext("webgl2") && !probe.getContext("webgl")) {
    page("no-webgl").hidden = false;
    return Promise.resolve();
  }
  scene = new Scene(page("view3d"), run.submaps, frame => {
    // Of a small submap the page shows no keyframes.
    if (run.shown.some(shown => shown.submap === submap)) select(nearest(frame, shown => shown.frame, submap));
  }, select);
  run.submaps.forEach((map, k) => page("submap").add(new Option(String(k), k)));
  page("submap-choice").hidden = run.submaps.length < 2;
  page("static").open = false;
  page("wall").addEventListener("change", event => scene.setWall(event.target.value));
  page("paint").addEventListener("change", event => scene.setPaint(event.target.value));
  page("layers").addEventListener("change", event => scene.setLayer(event.target.value, event.target.checked));
  page("view-outside").addEventListener("click", () => scene.fromOutside());
  page("view-keyframe").addEventListener("click", () => scene.fromKeyframe());
  page("submap").addEventListener("change", event => {
    const number = Number(event.target.value), first = run.shown.findIndex(shown => shown.submap === number);
    if (first >= 0) select(first); else showSubmap(number);
  });
  return showSubmap(0);
}

function listen() {
  page("slider").max = Math.max(0, articles.length - 1);
  page("slider").addEventListener("input", event => select(Number(event.target.value)));
  page("previous").addEventListener("click", () => select(current - 1));
  page("next").addEventListener("click", () => select(current + 1));
  document.addEventListener("keydown", event => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (step && !/^(INPUT|SELECT)$/.test(event.target.tagName)) select(current + step);
  });
  page("timeline").addEventListener("click", event => {
    const box = page("timeline").getBoundingClientRect(), [start, end] = run.seconds;
    select(nearest(start + (event.clientX - box.left) / box.width * (end - start), shown => shown.seconds));
  });
  document.querySelectorAll(".goto").forEach(anchor => anchor.addEventListener("click", event => {
    event.preventDefault();
    select(Number(anchor.hash.replace("#keyframe-", "")), anchor.dataset.region);
    document.querySelector(".viewer").scrollIntoView({ block: "start" });
  }));
}

document.documentElement.classList.add("js");
listen();
markRegions();
startScene().then(() => {
  select(0);
  document.documentElement.dataset.ready = "yes"; // for those who wait for the first picture
});
