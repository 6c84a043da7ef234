"use strict";
// The growing surface: parts as they come, the camera's path, and the camera. Drawn by plotly.

const CAMERA_COLOUR = "#ffd166", MISSED_COLOUR = "#d55e00";
const BEHIND = 0.4; // units of the map from which the camera is followed
// Between two drawings. Without a graphics card each takes the processors that the tracker needs: then fewer.
const DRAW_MS = 900, MOST_DRAW_MS = 3000, DRAW_SHARE = 0.15;
const PIXELS = 1; // of the canvas for each of the page; plotly takes two

class LiveScene {
  constructor(element) {
    Object.assign(this, { element, parts: new Map(), map: -1, following: true, drawn: 0 });
    element.addEventListener("pointerdown", () => this.setFollowing(false));
    new ResizeObserver(() => this.ready && Plotly.Plots.resize(element)).observe(element);
  }

  get empty() { return this.parts.size === 0; }

  // Keep what is current; fetch what changed. state: as /state answers.
  async update(state) {
    if (state.map !== this.map) {
      this.map = state.map;
      this.parts.clear();
      this.trace = null;
    }
    const shown = new Set(state.parts.map(([number]) => number));
    for (const number of this.parts.keys()) if (!shown.has(number)) this.parts.delete(number);
    let changed = false;
    for (const [number, version, correction] of state.parts) {
      const known = this.parts.get(number), key = JSON.stringify(correction);
      if (known && known.version === version && known.key === key) continue;
      const raw = known && known.version === version ? known.raw : await fetchPart(number);
      if (!raw) continue;
      this.parts.set(number, { version, key, raw, ...moved(raw, correction) });
      changed = true;
    }
    this.changed = this.changed || changed;
    const now = performance.now();
    if (this.parts.size === 0 || now < (this.drawNext || 0)) return;
    if (this.changed || this.following) this.draw(state);
    const took = await drawn() - now;
    this.element.dataset.drawMs = Math.round(took);
    this.drawNext = performance.now() + Math.min(MOST_DRAW_MS, Math.max(DRAW_MS, took / DRAW_SHARE));
  }

  // One call of plotly's: each one draws everything.
  draw(state) {
    if (this.changed || !this.trace) this.trace = this.mesh();
    this.changed = false;
    const traces = [this.trace, ...this.cameraTraces(state)], box = this.box();
    const camera = this.following ? this.behind(state) : this.camera;
    const scene = { ...this.axes(box), dragmode: "orbit", aspectmode: "data", ...(camera ? { camera } : {}) };
    const layout = { margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", showlegend: false, scene };
    Plotly.react(this.element, traces, layout, { displayModeBar: false, plotGlPixelRatio: PIXELS });
    if (!this.ready) this.element.on("plotly_relayout", change => { if (change["scene.camera"]) this.camera = change["scene.camera"]; });
    this.ready = true;
    this.drawn++;
    this.element.dataset.drawn = this.drawn;
    this.element.dataset.faces = this.surface.faces.length / 3;
  }

  axes(box) {
    const axis = k => ({ visible: false, range: [box.low[k], box.high[k]] });
    return { xaxis: axis(0), yaxis: axis(1), zaxis: axis(2) };
  }

  box() {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (const { vertices } of this.parts.values())
      for (let k = 0; k < vertices.length; k++) {
        low[k % 3] = Math.min(low[k % 3], vertices[k]);
        high[k % 3] = Math.max(high[k % 3], vertices[k]);
      }
    return { low, high };
  }

  mesh() {
    const vertices = [], faces = [], colours = [];
    for (const part of this.parts.values()) {
      const first = vertices.length / 3;
      for (const value of part.vertices) vertices.push(value);
      for (const corner of part.raw.faces) faces.push(first + corner);
      for (let k = 0; k < part.raw.colours.length; k += 3)
        colours.push(`rgb(${part.raw.colours[k]},${part.raw.colours[k + 1]},${part.raw.colours[k + 2]})`);
    }
    this.surface = { vertices, faces };
    const open = this.following || !this.eye ? faces : inwardFaces(this.surface, this.eye);
    const light = { ambient: 0.75, diffuse: 0.4, specular: 0.03, roughness: 0.9, fresnel: 0, vertexnormalsepsilon: 0, facenormalsepsilon: 0 };
    return { type: "mesh3d", hoverinfo: "skip", lighting: light, x: column(vertices, 0), y: column(vertices, 1), z: column(vertices, 2), ...triangles(open), vertexcolor: colours };
  }

  cameraTraces(state) {
    const path = state.path.flat(), missed = state.coverage ? state.coverage.missed.map(place => place.centre).flat() : [];
    const xyz = flat => ({ x: column(flat, 0), y: column(flat, 1), z: column(flat, 2) });
    return [
      { type: "scatter3d", mode: "lines", hoverinfo: "skip", ...xyz(path), line: { color: "#56b4e9", width: 5 } },
      { type: "scatter3d", mode: "lines", hoverinfo: "skip", ...xyz(frustum(state.pose, this.size())), line: { color: CAMERA_COLOUR, width: 5 } },
      { type: "scatter3d", mode: "markers", hoverinfo: "skip", ...xyz(missed), marker: { size: 9, color: MISSED_COLOUR, symbol: "diamond", line: { color: "#fff", width: 1 } } },
    ];
  }

  size() {
    const { low, high } = this.box();
    return Math.hypot(...high.map((value, k) => value - low[k])) || 1;
  }

  // plotly's own unit: the box's sides, under aspectmode "data", have a geometric mean of one.
  toView(point) {
    const { low, high } = this.box(), side = high.map((value, k) => Math.max(value - low[k], 1e-9));
    const unit = Math.cbrt(side[0] * side[1] * side[2]);
    return point.map((value, k) => (value - (low[k] + high[k]) / 2) / unit);
  }

  // The eye behind the camera, looking where it looks.
  behind({ pose }) {
    if (pose.length < 16) return null;
    const turned = k => [pose[k], pose[4 + k], pose[8 + k]];
    const centre = turned(3), ahead = turned(2), up = turned(1).map(value => -value);
    const eye = this.toView(centre.map((value, k) => value - BEHIND * ahead[k]));
    const target = this.toView(centre.map((value, k) => value + ahead[k]));
    return { eye: point(eye), center: point(target), up: point(up), projection: { type: "perspective" } };
  }

  // From the side, far enough away for everything, with the wall towards the eye left out.
  outside(state) {
    this.setFollowing(false);
    const { low, high } = this.box(), path = state.path;
    const along = path.length > 1 ? path[path.length - 1].map((value, k) => value - path[0][k]) : [0, 0, 1];
    const length = Math.hypot(...along) || 1, axis = along.map(value => value / length);
    const helper = Math.abs(axis[1]) < 0.9 ? [0, 1, 0] : [1, 0, 0];
    const side = cross(axis, helper), width = Math.hypot(...side), eyeSide = side.map(value => value / width);
    const middle = low.map((value, k) => (value + high[k]) / 2), reach = this.size();
    this.eye = middle.map((value, k) => value + reach * eyeSide[k]);
    this.camera = { eye: point(this.toView(this.eye)), center: point(this.toView(middle)), up: point(helper.map(value => -value)), projection: { type: "perspective" } };
    this.changed = true;
    this.draw(state);
  }

  setFollowing(following) {
    this.following = following;
    this.element.dispatchEvent(new CustomEvent("following", { detail: following }));
  }
}

// When what was asked for is on the screen.
function drawn() { return new Promise(resolve => requestAnimationFrame(() => requestAnimationFrame(resolve))); }

async function fetchPart(number) {
  const answer = await fetch(`/surface/${number}`);
  if (!answer.ok) return null;
  const buffer = await answer.arrayBuffer(), [vertexCount, faceCount] = new Uint32Array(buffer, 0, 2);
  return {
    vertices: new Float32Array(buffer, 8, 3 * vertexCount),
    faces: new Uint32Array(buffer, 8 + 12 * vertexCount, 3 * faceCount),
    colours: new Uint8Array(buffer, 8 + 12 * vertexCount + 12 * faceCount, 3 * vertexCount),
  };
}

function moved(raw, m) {
  if (!m) return { vertices: raw.vertices };
  const vertices = new Float32Array(raw.vertices.length);
  for (let v = 0; v < vertices.length; v += 3)
    for (let k = 0; k < 3; k++)
      vertices[v + k] = m[4 * k] * raw.vertices[v] + m[4 * k + 1] * raw.vertices[v + 1] + m[4 * k + 2] * raw.vertices[v + 2] + m[4 * k + 3];
  return { vertices };
}

function cross(a, b) { return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]; }

// Lines of a pyramid at the camera's pose (16 numbers by rows).
function frustum(pose, size) {
  if (pose.length < 16) return [];
  const depth = 0.06 * size;
  const corner = (u, v) => [0, 1, 2].map(k => pose[4 * k + 3] + depth * (0.8 * u * pose[4 * k] + 0.8 * v * pose[4 * k + 1] + pose[4 * k + 2]));
  const tip = [pose[3], pose[7], pose[11]], [a, b, c, d] = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
  return [tip, a, b, tip, c, d, tip, a, d, c, b].flat();
}
