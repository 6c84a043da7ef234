"use strict";
// The 3-D view: one submap's mesh, camera path, keyframes and missed regions, drawn by plotly.

const TRACE = { mesh: 0, path: 1, keyframes: 2, missed: 3, numbers: 4, frustum: 5 };
const LAYERS = { path: ["path"], keyframes: ["keyframes"], missed: ["missed", "numbers"], frustum: ["frustum"] };
const MISSED = "#4a8bff"; // no tissue is blue
const EXTENT = 2; // of the box's diagonal in plotly's own unit
const ROOM = 1.12; // around the object in the first view
const TILT = 0.3; // of the first view, from above
const HALF_FOV = Math.tan(Math.PI / 8); // plotly's view is 45 degrees high

const bytes = text => Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
const floats = text => new Float32Array(bytes(text).buffer);
const column = (flat, k) => Float32Array.from({ length: flat.length / 3 }, (_, row) => flat[3 * row + k]);
const add = (a, b, s) => [0, 1, 2].map(k => a[k] + s * b[k]);
const point = ([x, y, z]) => ({ x, y, z });

class Scene {
  // onFrame, onKeyframe: what a click on a frame of the path, and one on a missed region, calls.
  constructor(element, submaps, onFrame, onKeyframe) {
    Object.assign(this, { element, submaps, onFrame, onKeyframe, wall: "open", paint: "tissue", hidden: new Set() });
    new ResizeObserver(() => this.map && Plotly.Plots.resize(element)).observe(element);
  }

  // Draw a submap anew, seen from outside.
  show(number) {
    const map = this.map = this.submaps[number];
    const size = map.high.map((high, k) => Math.max(high - map.low[k], 1e-6));
    this.middle = map.low.map((low, k) => (low + map.high[k]) / 2);
    this.unit = EXTENT / Math.hypot(...size); // plotly's unit per unit of length
    this.mesh = map.mesh && unpackMesh(map.mesh);
    this.missed = { vertices: floats(map.missed.vertices), faces: new Uint32Array(bytes(map.missed.faces).buffer) };
    const axis = k => ({ visible: false, range: [map.low[k], map.low[k] + size[k]] });
    const layout = {
      margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: "rgba(0,0,0,0)", showlegend: false, uirevision: number,
      font: { color: "#e4e9f0" }, hoverlabel: { align: "left", bgcolor: "#1c232e", bordercolor: "#3a4656" },
      scene: {
        xaxis: axis(0), yaxis: axis(1), zaxis: axis(2), dragmode: "orbit", camera: this.outside(),
        aspectmode: "manual", aspectratio: point(size.map(length => length * this.unit)),
      },
    };
    const ready = Plotly.newPlot(this.element, this.traces(), layout, { displayModeBar: false, responsive: true });
    this.element.on("plotly_relayout", change => { if (change["scene.camera"]) this.openSoon(); });
    // Later, and not from within: plotly tells of a click at every redraw while the button is down.
    this.element.on("plotly_click", event => setTimeout(() => this.clicked(event.points[0])));
    return ready.then(() => this.open());
  }

  traces() {
    const { map, mesh } = this, path = floats(map.path.places), keys = floats(map.keyframes.places);
    const missed = this.missed;
    const xyz = flat => ({ x: column(flat, 0), y: column(flat, 1), z: column(flat, 2) });
    const near = new Set(map.shown.map(shown => shown.frame));
    const centres = map.missed.regions.map(region => region.centre);
    const light = { ambient: 0.7, diffuse: 0.5, specular: 0.04, roughness: 0.9, fresnel: 0, vertexnormalsepsilon: 0, facenormalsepsilon: 0 };
    return [
      { type: "mesh3d", hoverinfo: "skip", lighting: light, ...(mesh ? { ...xyz(mesh.vertices), ...triangles(mesh.faces), vertexcolor: mesh.tissue } : { x: [], y: [], z: [], i: [], j: [], k: [] }) },
      { type: "scatter3d", mode: "lines", ...xyz(path), customdata: map.path.frames, hovertemplate: "frame %{customdata}, %{text} s<extra></extra>", text: map.path.seconds,
        line: { color: map.path.seconds, colorscale: "Viridis", width: 5, showscale: map.path.seconds.length > 1,
          colorbar: { title: { text: "time [s]", font: { size: 11 } }, len: 0.35, thickness: 8, x: 1, xanchor: "right", xpad: 12, y: 0.7, yanchor: "top", tickfont: { size: 10 }, outlinewidth: 0 } } },
      { type: "scatter3d", mode: "markers", ...xyz(keys), customdata: map.keyframes.frames, hovertemplate: "keyframe %{customdata}: click to see it<extra></extra>",
        marker: { size: map.keyframes.frames.map(frame => near.has(frame) ? 7 : 3.5), color: "#ffffff", line: { width: 0 } } },
      { type: "mesh3d", hoverinfo: "skip", ...xyz(missed.vertices), ...triangles(missed.faces), color: MISSED, opacity: 0.55, lighting: { ambient: 0.85, diffuse: 0.25, specular: 0, fresnel: 0 } },
      { type: "scatter3d", mode: "markers+text", x: centres.map(c => c[0]), y: centres.map(c => c[1]), z: centres.map(c => c[2]),
        text: map.missed.regions.map(region => String(region.number)), textposition: "middle center", textfont: { size: 10, color: "#ffffff" },
        customdata: map.missed.regions.map(region => [region.keyframe, region.words.replace(/; /g, "<br>"), String(region.number)]),
        hovertemplate: "%{customdata[1]}<extra></extra>", marker: { size: 9, color: "#1d4fb8", line: { color: "#ffffff", width: 1 } } },
      { type: "scatter3d", mode: "lines", x: [], y: [], z: [], hoverinfo: "skip", line: { color: "#ffd166", width: 4 } },
    ].map((trace, k) => ({ ...trace, visible: !this.hidden.has(k) }));
  }

  clicked(picked) {
    const data = picked.data.customdata && picked.data.customdata[picked.pointNumber];
    if (Array.isArray(data)) { if (data[0] !== null) this.onKeyframe(data[0], data[2]); } else if (data !== undefined) this.onFrame(data);
  }

  // A camera square to the longest axis, far enough away for everything; the path runs from left to right.
  outside() {
    const [, up, towards] = this.map.axes, box = this.element.getBoundingClientRect();
    const [length, height, depth] = this.map.first_view.size.map(size => size * this.unit / 2);
    const wide = box.width / Math.max(box.height, 1) || 1;
    const distance = ROOM * Math.max(length / wide, height) / HALF_FOV + depth;
    const centre = this.inBox(this.map.first_view.middle), slope = Math.hypot(1, TILT);
    const eye = add(centre, add(towards, up, TILT), distance / slope);
    return { eye: point(eye), center: point(centre), up: point(up), projection: { type: "perspective" } };
  }

  inBox(place) { return place.map((value, k) => (value - this.middle[k]) * this.unit); }

  look(camera) { return Plotly.relayout(this.element, { "scene.camera": camera }); }

  fromOutside() { return this.look(this.outside()); }

  fromKeyframe() {
    const pose = this.current && this.current.pose;
    if (!pose) return;
    const turned = k => [pose[k], pose[4 + k], pose[8 + k]];
    const eye = this.inBox(turned(3)), ahead = turned(2);
    this.look({ eye: point(eye), center: point(add(eye, ahead, 0.4)), up: point(turned(1).map(v => -v)) });
  }

  // Faces that show the eye their outer side are left out, so that one looks into the lumen from everywhere.
  open() {
    const { x, y, z } = this.element.layout.scene.camera.eye;
    const eye = [x, y, z].map((v, k) => this.middle[k] + v / this.unit);
    const corners = surface => {
      const faces = triangles(this.wall === "open" ? inwardFaces(surface, eye) : surface.faces);
      return { i: [faces.i], j: [faces.j], k: [faces.k] };
    };
    Plotly.restyle(this.element, corners(this.missed), [TRACE.missed]);
    if (!this.mesh) return;
    const style = { visible: this.wall !== "none", opacity: this.wall === "glass" ? 0.28 : 1 };
    Plotly.restyle(this.element, { ...style, ...corners(this.mesh), vertexcolor: [this.mesh[this.paint]] }, [TRACE.mesh]);
  }

  // Once for many turns; and plotly tells of the camera again while it redraws, which must not start another round.
  openSoon() {
    if (this.opening) return;
    this.opening = true;
    requestAnimationFrame(() => {
      try { this.open(); } finally { this.opening = false; }
    });
  }

  setWall(wall) { this.wall = wall; this.open(); }

  setPaint(paint) { this.paint = paint; this.open(); }

  setLayer(name, visible) {
    const rows = LAYERS[name].map(trace => TRACE[trace]);
    rows.forEach(row => visible ? this.hidden.delete(row) : this.hidden.add(row));
    Plotly.restyle(this.element, { visible }, rows);
  }

  // Draw the pyramid of a keyframe's view.
  select(keyframe) {
    this.current = this.map.shown.find(shown => shown.keyframe === keyframe);
    if (!this.current) return;
    const pose = this.current.pose, depth = 0.22 / this.unit, [left, right, top, bottom] = this.map.view;
    const corner = (x, y) => [0, 1, 2].map(k => pose[4 * k + 3] + depth * (x * pose[4 * k] + y * pose[4 * k + 1] + pose[4 * k + 2]));
    const tip = [pose[3], pose[7], pose[11]], [a, b, c, d] = [corner(left, top), corner(right, top), corner(right, bottom), corner(left, bottom)];
    const line = [tip, a, b, tip, c, d, tip, a, d, c, b];
    Plotly.restyle(this.element, { x: [line.map(p => p[0])], y: [line.map(p => p[1])], z: [line.map(p => p[2])] }, [TRACE.frustum]);
  }
}

function unpackMesh(packed) {
  const steps = new Uint16Array(bytes(packed.vertices).buffer), rgb = bytes(packed.colours), trust = bytes(packed.confidence);
  const vertices = Float32Array.from(steps, (step, k) => packed.low[k % 3] + packed.span[k % 3] * step / 65535);
  const tissue = [], confidence = [];
  for (let row = 0; row < trust.length; row++) {
    tissue.push(`rgb(${rgb[3 * row]},${rgb[3 * row + 1]},${rgb[3 * row + 2]})`);
    const t = trust[row] / 255; // dark violet to light yellow, as the pictures of confidence
    confidence.push(`rgb(${Math.round(255 * Math.min(1, 0.15 + 1.25 * t))},${Math.round(255 * t * t)},${Math.round(255 * (0.3 + 0.4 * t))})`);
  }
  return { vertices, tissue, confidence, faces: new Uint32Array(bytes(packed.faces).buffer) };
}

function triangles(faces) {
  const corner = k => Uint32Array.from({ length: faces.length / 3 }, (_, row) => faces[3 * row + k]);
  return { i: corner(0), j: corner(1), k: corner(2) };
}

function inwardFaces({ vertices, faces }, eye) {
  const kept = [];
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    const ux = vertices[b] - vertices[a], uy = vertices[b + 1] - vertices[a + 1], uz = vertices[b + 2] - vertices[a + 2];
    const vx = vertices[c] - vertices[a], vy = vertices[c + 1] - vertices[a + 1], vz = vertices[c + 2] - vertices[a + 2];
    const facing = (uy * vz - uz * vy) * (eye[0] - vertices[a]) + (uz * vx - ux * vz) * (eye[1] - vertices[a + 1])
      + (ux * vy - uy * vx) * (eye[2] - vertices[a + 2]);
    if (facing > 0) kept.push(faces[f], faces[f + 1], faces[f + 2]);
  }
  return Uint32Array.from(kept);
}
