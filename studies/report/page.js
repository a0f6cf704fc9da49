"use strict";
// Draws what stands in the element "data": charts over time, scatters of tables, and the views in space.
const data = JSON.parse(document.getElementById("data").textContent);
const { lines: COLOURS, tissue, tension: TENSION, pressure: PRESSURE, marker: MARKER, arrow: ARROW } = data.colours;
const DASHES = ["solid", "dash", "dot", "dashdot", "longdash"];
const TISSUE = tissue.map((colour, place) => [place / (tissue.length - 1), colour]);
const SIGNED = [[0, "#2166ac"], [0.5, "#f7f7f7"], [1, "#b2182b"]];
const SHADES = 32; // of the colours of a tension
const CHART = 320, ROOM = 2, ROW = 19; // px: of a chart with room for so many rows of its legend, and of one row more
const CONFIG = { displaylogo: false, showSendToCloud: false, responsive: true, modeBarButtonsToRemove: ["select2d", "lasso2d", "autoScale2d"] };
const FONT = { family: 'system-ui, "DejaVu Sans", sans-serif', size: 12, color: "#1c2430" };
const element = (id) => document.getElementById(id);
const withUnit = (name, unit) => (unit ? `${name} [${unit}]` : name);
const unique = (list) => [...new Set(list)];

// -- charts over time -----------------------------------------------------------------------------------------------

function layoutOf(title, x, y) {
  return {
    title: { text: title, font: { size: 14 }, x: 0.02, xanchor: "left" }, font: FONT,
    margin: { l: 64, r: 16, t: 44, b: 10 },
    xaxis: { title: { text: x, standoff: 4 }, zeroline: false, automargin: true }, yaxis: { title: { text: y }, automargin: true, zeroline: false },
    legend: { orientation: "h", x: 0, y: -0.28, yanchor: "top", font: { size: 11 } }, hovermode: "x unified",
    paper_bgcolor: "#fff", plot_bgcolor: "#fff",
  };
}

function traceOf(series, colour, dash, many) {
  return {
    type: "scatter", mode: "lines", name: many ? `${series.run}, ${series.label}` : series.label,
    x: series.x, y: series.y, line: { color: colour, dash, width: 1.8 }, connectgaps: false,
  };
}

function drawChart(where, title, keys) {
  const runs = unique(data.series.map((one) => one.run)), shown = data.series.filter((one) => keys.includes(one.key));
  const traces = shown.map((one) => {
    const quantity = keys.indexOf(one.key), run = runs.indexOf(one.run);
    const colour = COLOURS[(runs.length > 1 ? run : quantity) % COLOURS.length];
    return traceOf(one, colour, DASHES[(runs.length > 1 ? quantity : 0) % DASHES.length], runs.length > 1);
  });
  const unit = shown.length ? shown[0].unit : "", rows = runs.length > 1 ? shown.length : Math.ceil(shown.length / 2);
  element(where).style.height = `${CHART + ROW * Math.max(0, rows - ROOM)}px`;
  return Plotly.react(where, traces, layoutOf(title, "time [s]", unit ? `[${unit}]` : ""), CONFIG);
}

function drawCharts() {
  data.charts.forEach((chart, number) => drawChart(`chart${number}`, chart.title, chart.keys));
  const choice = element("quantity");
  if (!choice) return;
  unique(data.series.map((one) => one.key)).forEach((key) => choice.add(new Option(key, key)));
  const draw = () => drawChart("chosen", choice.value, [choice.value]);
  choice.addEventListener("change", draw);
  draw();
}

// -- tables of studies and sweeps -------------------------------------------------------------------------------------

function drawGrids() {
  data.grids.forEach((grid, number) => {
    const [x, y, by] = ["x", "y", "by"].map((axis) => element(`${axis}${number}`));
    const draw = () => drawGrid(`grid${number}`, grid, x.value, y.value, by.value);
    [x, y, by].forEach((choice) => choice.addEventListener("change", draw));
    draw();
  });
}

function drawGrid(where, grid, x, y, by) {
  const label = by ? grid.columns[by].map(String) : grid.columns[x].map(() => "");
  const traces = unique(label).map((value, number) => {
    const rows = label.flatMap((each, row) => (each === value ? [row] : []));
    return {
      type: "scatter", mode: "markers", name: by ? `${by} ${value}` : y, x: rows.map((row) => grid.columns[x][row]),
      y: rows.map((row) => grid.columns[y][row]), marker: { color: COLOURS[number % COLOURS.length], size: 8 },
    };
  });
  const layout = layoutOf("", withUnit(x, grid.units[x]), withUnit(y, grid.units[y]));
  Plotly.react(where, traces, { ...layout, hovermode: "closest", showlegend: Boolean(by) }, CONFIG);
}

// -- views in space ---------------------------------------------------------------------------------------------------

function unpack(text, Kind) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Kind(bytes.buffer);
}

function unpackOrgan(view) {
  const organ = view.organ;
  if (!organ || organ.rest) return;
  organ.rest = unpack(organ.points, Float32Array);
  organ.moved = unpack(organ.displacement, Int16Array);
  organ.corners = unpack(organ.triangles, Int32Array);
  organ.fields.forEach((field) => { field.numbers = unpack(field.values, Uint16Array); });
}

function places(organ, frame) {
  const n = organ.nodes, axes = [0, 1, 2].map(() => new Float32Array(n)), start = 3 * n * frame;
  for (let node = 0; node < n; node++) {
    for (let axis = 0; axis < 3; axis++) {
      const at = 3 * node + axis;
      axes[axis][node] = 1e3 * (organ.rest[at] + organ.displacement_scale * organ.moved[start + at]);
    }
  }
  return { x: axes[0], y: axes[1], z: axes[2] };
}

/* Triangles behind a plane y = `front` [mm] of the shape without loads: the organ is opaque, because a browser does not
   sort transparent triangles, and opened at the front, so that the thread in it is seen. */
function corners(organ, front) {
  const behind = (place) => 1e3 * organ.rest[3 * organ.corners[place] + 1] > front - 1e-3, out = { i: [], j: [], k: [] };
  for (let at = 0; at < organ.corners.length; at += 3) {
    if ([at, at + 1, at + 2].every(behind)) ["i", "j", "k"].forEach((axis, k) => out[axis].push(organ.corners[at + k]));
  }
  return out;
}

function colouring(field, frame, nodes) {
  const intensity = new Float32Array(nodes);
  for (let node = 0; node < nodes; node++) intensity[node] = field.low + field.step * field.numbers[nodes * frame + node];
  const [low, high] = field.range, signed = low < 0 && high > 0, most = Math.max(Math.abs(low), Math.abs(high));
  return {
    intensity, cmin: signed ? -most : low, cmax: signed ? most : high, colorscale: signed ? SIGNED : TISSUE,
    colorbar: { title: { text: withUnit(field.name, field.unit), side: "right" }, len: 0.7, thickness: 14, x: 1.0 },
  };
}

function organTrace(view, frame, field, front) {
  const organ = view.organ;
  return {
    type: "mesh3d", name: "organ", ...places(organ, frame), ...corners(organ, front), flatshading: true,
    ...colouring(organ.fields[field], frame, organ.nodes), hovertemplate: "%{intensity:.4g}<extra>organ</extra>",
    lighting: { ambient: 0.75, diffuse: 0.45, specular: 0.03, roughness: 1, facenormalsepsilon: 0, vertexnormalsepsilon: 0 },
  };
}

const mix = (a, b, share) => {
  const parts = [1, 3, 5].map((at) => [a, b].map((colour) => parseInt(colour.slice(at, at + 2), 16)));
  return `rgb(${parts.map(([from, to]) => Math.round(from + share * (to - from))).join(",")})`;
};

/* Colours of a tension from `low` to `high`: compression has its own, as strong as a tension of that size. */
function tensionColours(low, high) {
  return Array.from({ length: SHADES + 1 }, (_, shade) => {
    const value = (low + ((high - low) * shade) / SHADES) / Math.max(-low, high), size = Math.abs(value);
    const [none, half, all] = value < 0 ? PRESSURE : TENSION;
    return [shade / SHADES, size < 0.5 ? mix(none, half, 2 * size) : mix(half, all, 2 * size - 1)];
  });
}

function threadTrace(view, frame) {
  const thread = view.thread[frame], all = view.thread.flatMap((one) => one.tension).filter((value) => value !== null);
  const low = Math.min(0, ...sorted(all, 0.005)), most = Math.max(0, ...sorted(all, 0.995));
  const high = most > low ? most : 1;
  return {
    type: "scatter3d", mode: "lines", name: "thread", x: thread.x, y: thread.y, z: thread.z, connectgaps: false,
    line: {
      width: 8, color: thread.tension, colorscale: tensionColours(low, high), cmin: low, cmax: high,
      showscale: true, colorbar: { title: { text: "tension [N]", side: "right" }, len: 0.7, thickness: 14, x: 1.12 },
    },
    customdata: thread.tension.map((value, point) => [value, thread.s[point]]),
    hovertemplate: "tension %{customdata[0]:.4g} N<br>s %{customdata[1]:.4g} mm<extra>thread</extra>",
  };
}

function sorted(values, share) {
  const order = Float64Array.from(values).sort();
  return order.length ? [order[Math.round(share * (order.length - 1))]] : [0];
}

const norm = (vector) => Math.hypot(...vector);
const SIDES = 10; // of an arrow

function arrow(from, force, length) {
  const size = norm(force), along = force.map((part) => part / size);
  const aside = Math.abs(along[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0];
  const u = unit(cross(along, aside)), v = cross(along, u), head = Math.min(0.35 * length, 3), thin = 0.12 * head;
  const rings = [[0, thin], [length - head, thin], [length - head, 0.36 * head], [length, 0]];
  return rings.flatMap(([at, radius]) => Array.from({ length: SIDES }, (_, side) => {
    const angle = (2 * Math.PI * side) / SIDES, [c, s] = [radius * Math.cos(angle), radius * Math.sin(angle)];
    return from.map((x, k) => x + at * along[k] + c * u[k] + s * v[k]);
  }));
}

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((part) => part / norm(a));

function arrowsTrace(holes, largest, reach) {
  const mesh = { x: [], y: [], z: [], i: [], j: [], k: [] };
  holes.filter((hole) => norm(hole.force) > 0.02 * largest).forEach((hole) => {
    const start = mesh.x.length, points = arrow(hole.x, hole.force, (reach * norm(hole.force)) / largest);
    points.forEach((point) => ["x", "y", "z"].forEach((axis, k) => mesh[axis].push(point[k])));
    for (let ring = 0; ring < 3; ring++) {
      for (let side = 0; side < SIDES; side++) {
        const a = start + ring * SIDES + side, b = start + ring * SIDES + ((side + 1) % SIDES);
        mesh.i.push(a, b); mesh.j.push(b, b + SIDES); mesh.k.push(a + SIDES, a + SIDES);
      }
    }
  });
  return { type: "mesh3d", name: "force", ...mesh, color: ARROW, hoverinfo: "skip", lighting: { ambient: 0.9 } };
}

function forceTraces(view, frame, reach) {
  const holes = view.holes[frame], largest = Math.max(1e-300, ...view.holes.flat().map((hole) => norm(hole.force)));
  const middle = holes.reduce((sum, hole) => sum + hole.x[0], 0) / holes.length;
  return [
    arrowsTrace(holes, largest, reach),
    {
      type: "scatter3d", mode: "markers+text", name: "piercings", x: holes.map((hole) => hole.x[0]),
      y: holes.map((hole) => hole.x[1]), z: holes.map((hole) => hole.x[2]),
      textposition: holes.map((hole) => (hole.x[0] < middle ? "middle left" : "middle right")),
      text: holes.map((hole) => ` ${hole.name} ${forceText(norm(hole.force))} `), marker: { color: MARKER, size: 5 },
      textfont: { size: 13, color: "#1c2430" }, hovertemplate: "%{text}<extra></extra>",
    },
  ];
}

const forceText = (force) => (force < 1 ? `${(1e3 * force).toPrecision(3)} mN` : `${force.toPrecision(3)} N`);

function extent(view) {
  const range = ["x", "y", "z"].map((axis, k) => {
    let low = Infinity, high = -Infinity;
    const seen = (value) => { if (value !== null) { low = Math.min(low, value); high = Math.max(high, value); } };
    view.thread.forEach((thread) => thread[axis].forEach(seen));
    if (view.organ) for (let at = k; at < view.organ.rest.length; at += 3) seen(1e3 * view.organ.rest[at]);
    const margin = 0.03 * (high - low) + 0.5;
    return [low - margin, high + margin];
  });
  return range;
}

function spaceLayout(range) {
  const axis = (name, k) => ({ title: { text: `${name} [mm]` }, range: range[k], backgroundcolor: "#fff" });
  const size = range.map(([low, high]) => high - low), most = Math.max(...size);
  return {
    font: FONT, margin: { l: 0, r: 0, t: 8, b: 0 }, showlegend: false, uirevision: "kept", paper_bgcolor: "#fff",
    scene: {
      xaxis: axis("x", 0), yaxis: axis("y", 1), zaxis: axis("z", 2), aspectmode: "manual",
      aspectratio: { x: (1.3 * size[0]) / most, y: (1.3 * size[1]) / most, z: (1.3 * size[2]) / most },
      camera: { eye: { x: 0.55, y: -1.6, z: 0.75 } }, dragmode: "orbit",
    },
  };
}

function drawView() {
  if (!data.views.length) return;
  const [which, time, field, front] = ["which", "time", "field", "front"].map(element);
  data.views.forEach((view, number) => which.add(new Option(view.name, number)));
  const shown = () => data.views[Number(which.value)];
  let range, reach;
  const traces = () => {
    const view = shown(), frame = Number(time.value);
    const organ = view.organ ? [organTrace(view, frame, Number(field.value), Number(front.value))] : [];
    return [...organ, threadTrace(view, frame), ...forceTraces(view, frame, reach)];
  };
  const draw = () => {
    element("moment").textContent = `t = ${shown().times[Number(time.value)]} s`;
    return Plotly.react("view", traces(), spaceLayout(range), CONFIG);
  };
  const choose = () => {
    const view = shown();
    unpackOrgan(view);
    range = extent(view);
    reach = 0.16 * Math.max(...range.map(([low, high]) => high - low));
    time.max = view.times.length - 1;
    time.value = view.times.length - 1;
    field.replaceChildren(...(view.organ ? view.organ.fields : []).map((one, k) => new Option(withUnit(one.name, one.unit), k)));
    const middle = view.holes[0].map((hole) => hole.x[1]).sort((a, b) => a - b)[view.holes[0].length >> 1] ?? 0;
    [front.min, front.max] = range[1];
    front.value = middle;
    [field, front].forEach((control) => { control.disabled = !view.organ; });
    return draw();
  };
  which.addEventListener("change", choose);
  [time, front].forEach((control) => control.addEventListener("input", draw));
  field.addEventListener("change", draw);
  play(time, draw);
  choose();
}

function play(time, draw) {
  const button = element("play");
  let timer = null;
  const stop = () => { clearInterval(timer); timer = null; button.textContent = "play"; };
  button.addEventListener("click", () => {
    if (timer) { stop(); return; }
    if (Number(time.value) >= Number(time.max)) time.value = 0;
    button.textContent = "stop";
    timer = setInterval(() => {
      if (Number(time.value) >= Number(time.max)) { stop(); return; }
      time.value = Number(time.value) + 1;
      draw();
    }, 120);
  });
}

drawCharts();
drawGrids();
drawView();
