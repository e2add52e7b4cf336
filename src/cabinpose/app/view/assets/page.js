"use strict";
// Everything the page shows is in the JSON beside this script; nothing is fetched.
const data = JSON.parse(document.getElementById("data").textContent);
const $ = (id) => document.getElementById(id);
const W = data.width, H = data.height;
const state = { frame: 0, layer: "depth", tint: "people", yaw: 0, pitch: 0, distance: 2, centre: [0, 0, 0], pan: [0, 0] };

function bytes(base64) {
  const text = atob(base64), out = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) out[i] = text.charCodeAt(i);
  return out;
}
async function inflate(base64) {
  const stream = new Blob([bytes(base64)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
// Millimetres as two planes, high bytes first: noise is in the low bytes only, so that both planes compress well.
function joinPlanes(planes) {
  const n = planes.length / 2, out = new Uint16Array(n);
  for (let i = 0; i < n; i++) out[i] = planes[i] << 8 | planes[n + i];
  return out;
}
const loaded = new Map();
async function load(k) {
  if (!loaded.has(k)) {
    const f = data.frames[k];
    const parts = await Promise.all(["depth", "depth_clean", "amplitude", "labels", "instance", "rgb", "nir"].map((name) => f[name] ? inflate(f[name]) : null));
    loaded.set(k, {
      depth: joinPlanes(parts[0]), depth_clean: parts[1] && joinPlanes(parts[1]), amplitude: parts[2],
      labels: parts[3], instance: parts[4] || new Uint8Array(W * H), rgb: parts[5], nir: parts[6],
    });
    if (loaded.size > 12) loaded.delete(loaded.keys().next().value);
  }
  return loaded.get(k);
}

const viridis = bytes(data.colour_map);
const labelRgb = new Uint8Array(768).fill(128), labelName = [];
for (const l of data.labels) { labelRgb.set([l.rgb >> 16, l.rgb >> 8 & 255, l.rgb & 255], 3 * l.id); labelName[l.id] = l.name; }
const css = (c) => `rgb(${c[0]},${c[1]},${c[2]})`;
const personColour = (position) => data.person_colours[position % data.person_colours.length];
const words = (name) => name.replaceAll("_", " ");
function depthIndex(mm) {
  const share = (mm / 1000 - data.near) / (data.far - data.near);
  return 3 * Math.round(255 * Math.min(1, Math.max(0, share)));
}
function element(tag, text, className) {
  const e = document.createElement(tag);
  if (text !== undefined) e.textContent = text;
  if (className) e.className = className;
  return e;
}

// ------------------------------------------------------------------------------------------------------------- image
function colourOf(images, layer, i, out) {
  if (layer === "labels") { const l = 3 * images.labels[i]; out[0] = labelRgb[l]; out[1] = labelRgb[l + 1]; out[2] = labelRgb[l + 2]; return; }
  if (layer === "rgb") { out[0] = images.rgb[3 * i]; out[1] = images.rgb[3 * i + 1]; out[2] = images.rgb[3 * i + 2]; return; }
  if (layer === "nir") { out[0] = out[1] = out[2] = images.nir[i]; return; }
  if (layer === "amplitude" || layer === "people") {
    const a = images.amplitude ? images.amplitude[i] : 200;
    if (layer === "people" && images.instance[i]) {
      const c = personColour(images.instance[i] - 1), s = 0.45 + 0.55 * a / 255;
      out[0] = c[0] * s; out[1] = c[1] * s; out[2] = c[2] * s;
    } else { const g = layer === "people" ? 40 + 0.6 * a : a; out[0] = g; out[1] = g; out[2] = g * (layer === "people" ? 1.06 : 1); }
    return;
  }
  const mm = images[layer][i];
  if (!mm) { out[0] = 38; out[1] = 40; out[2] = 46; return; }
  const d = depthIndex(mm); out[0] = viridis[d]; out[1] = viridis[d + 1]; out[2] = viridis[d + 2];
}
const small = document.createElement("canvas"); small.width = W; small.height = H;
function drawImage(images) {
  const canvas = $("image"), ratio = Math.max(1, window.devicePixelRatio || 1);
  const scale = Math.max(1, canvas.clientWidth * ratio / W);
  canvas.width = Math.round(W * scale); canvas.height = Math.round(H * scale);
  const g = small.getContext("2d"), picture = g.createImageData(W, H), px = picture.data, c = [0, 0, 0];
  const tint = $("tint").checked && state.layer !== "labels";
  for (let i = 0; i < W * H; i++) {
    colourOf(images, state.layer, i, c);
    const l = images.labels[i];
    if (tint && l > 0 && l < 64) for (let k = 0; k < 3; k++) c[k] = 0.55 * c[k] + 0.45 * labelRgb[3 * l + k];
    px[4 * i] = c[0]; px[4 * i + 1] = c[1]; px[4 * i + 2] = c[2]; px[4 * i + 3] = 255;
  }
  g.putImageData(picture, 0, 0);
  const big = canvas.getContext("2d");
  big.imageSmoothingEnabled = false;
  big.drawImage(small, 0, 0, canvas.width, canvas.height);
  if ($("skeleton").checked) for (const p of data.frames[state.frame].people)
    drawSkeleton(big, p, p.uv.map((uv) => uv && [(uv[0] + 0.5) * scale, (uv[1] + 0.5) * scale]), scale);
}
function drawSkeleton(g, person, points, scale) {
  g.lineCap = "round";
  for (const [colour, width] of [["rgba(16,18,22,0.9)", 3.2], ["rgb(238,241,245)", 1.4]]) {
    g.strokeStyle = colour; g.lineWidth = width * scale; g.beginPath();
    for (const [a, b] of data.limbs) if (points[a] && points[b]) { g.moveTo(...points[a]); g.lineTo(...points[b]); }
    g.stroke();
  }
  g.font = `${Math.max(10, 4.6 * scale)}px system-ui, sans-serif`;
  points.forEach((p, j) => {
    const colour = data.visibility_colours[person.visibility[j]];
    if (!p || !colour) return;
    g.beginPath(); g.arc(p[0], p[1], 2.7 * scale, 0, 7); g.fillStyle = css(colour); g.fill();
    g.lineWidth = 0.8 * scale; g.strokeStyle = "rgb(16,18,22)"; g.stroke();
    if ($("names").checked) {
      g.lineWidth = 3; g.strokeStyle = "rgba(0,0,0,0.8)"; g.fillStyle = "#fff";
      g.strokeText(data.joints[j], p[0] + 4 * scale, p[1] - 2 * scale); g.fillText(data.joints[j], p[0] + 4 * scale, p[1] - 2 * scale);
    }
  });
}
let pointer = null; // over the image, which may become another one under it
$("image").addEventListener("mousemove", async (event) => { pointer = event; readOut(await load(state.frame)); });
$("image").addEventListener("mouseleave", () => { pointer = null; });
function readOut(images) {
  if (!pointer) { $("readout").textContent = "Point at the image to read it."; return; }
  const box = $("image").getBoundingClientRect();
  const u = Math.min(W - 1, Math.floor((pointer.clientX - box.left) / box.width * W));
  const v = Math.min(H - 1, Math.floor((pointer.clientY - box.top) / box.height * H));
  if (u < 0 || v < 0) return;
  const i = v * W + u, m = (mm) => mm ? `${(mm / 1000).toFixed(3)} m` : "invalid";
  const clean = images.depth_clean ? `, geometry ${m(images.depth_clean[i])}` : "";
  const amplitude = images.amplitude ? `, amplitude ${Math.round((images.amplitude[i] / 255) ** 2 * data.white)}` : "";
  $("readout").textContent = `(${u}, ${v})  depth ${m(images.depth[i])}${clean}${amplitude}, ${words(labelName[images.labels[i]] || "?")}`;
}

// ------------------------------------------------------------------------------------------------------- point cloud
// Rays are given on a coarse grid; between its points they are linear to well under a pixel.
const rayTables = data.cameras.map((camera) => {
  const rays = new Float32Array(2 * W * H), { us, vs, rays: grid } = camera, n = us.length;
  let r = 0;
  for (let v = 0; v < H; v++) {
    while (r < vs.length - 2 && v >= vs[r + 1]) r++;
    const tv = (v - vs[r]) / (vs[r + 1] - vs[r]);
    let c = 0;
    for (let u = 0; u < W; u++) {
      while (c < n - 2 && u >= us[c + 1]) c++;
      const tu = (u - us[c]) / (us[c + 1] - us[c]);
      for (let k = 0; k < 2; k++) {
        const at = (row, column) => { const x = grid[2 * (row * n + column) + k]; return x === null ? NaN : x; };
        rays[2 * (v * W + u) + k] = (1 - tv) * ((1 - tu) * at(r, c) + tu * at(r, c + 1)) + tv * ((1 - tu) * at(r + 1, c) + tu * at(r + 1, c + 1));
      }
    }
  }
  return rays;
});
let cloud = null;
function makeCloud(images) {
  const f = data.frames[state.frame], m = f.vehicle_from_camera, rays = rayTables[f.camera];
  let n = 0;
  const xyz = new Float32Array(3 * W * H), rgb = new Uint8Array(3 * W * H), c = [0, 0, 0];
  const layer = state.tint === "people" ? "people" : state.tint;
  for (let i = 0; i < W * H; i++) {
    const z = images.depth[i] / 1000, x = rays[2 * i] * z, y = rays[2 * i + 1] * z;
    if (!z || x !== x) continue;
    for (let k = 0; k < 3; k++) xyz[3 * n + k] = m[4 * k] * x + m[4 * k + 1] * y + m[4 * k + 2] * z + m[4 * k + 3];
    colourOf(images, layer, i, c);
    rgb[3 * n] = c[0]; rgb[3 * n + 1] = c[1]; rgb[3 * n + 2] = c[2];
    n++;
  }
  const people = f.people.map((p) => p.xyz.map((q) => q && [0, 1, 2].map((k) => m[4 * k] * q[0] + m[4 * k + 1] * q[1] + m[4 * k + 2] * q[2] + m[4 * k + 3])));
  cloud = { n, xyz, rgb, people };
}
function lookAt(name) {
  const f = data.frames[state.frame], m = f.vehicle_from_camera;
  const joints = cloud.people.flat().filter(Boolean);
  if (joints.length) state.centre = [0, 1, 2].map((k) => joints.reduce((sum, j) => sum + j[k], 0) / joints.length);
  else state.centre = [0, 1, 2].map((k) => { let sum = 0; for (let i = 0; i < cloud.n; i++) sum += cloud.xyz[3 * i + k]; return sum / Math.max(1, cloud.n); });
  const eye = [m[3], m[7], m[11]].map((x, k) => x - state.centre[k]);
  const reach = Math.hypot(...eye);
  state.pan = [0, 0];
  state.distance = name === "camera" ? Math.max(0.8, reach) : Math.max(1.3, 1.05 * reach);
  if (name === "camera") { state.yaw = Math.atan2(eye[1], eye[0]); state.pitch = Math.asin(Math.max(-1, Math.min(1, eye[2] / (reach || 1)))); }
  if (name === "left") { state.yaw = Math.PI / 2; state.pitch = 0.05; }
  if (name === "front") { state.yaw = 0.5; state.pitch = 0.25; }
  if (name === "top") { state.yaw = Math.PI; state.pitch = 1.55; }
}
let depthBuffer = new Float32Array(0);
function drawCloud() {
  const canvas = $("cloud"), ratio = Math.max(1, window.devicePixelRatio || 1);
  const w = canvas.width = Math.round(canvas.clientWidth * ratio), h = canvas.height = Math.round(canvas.clientWidth * ratio * H / W);
  const g = canvas.getContext("2d"), picture = g.createImageData(w, h), px = new Uint32Array(picture.data.buffer);
  px.fill(0xff1f1a18);
  if (depthBuffer.length !== w * h) depthBuffer = new Float32Array(w * h);
  depthBuffer.fill(Infinity);
  const cy = Math.cos(state.yaw), sy = Math.sin(state.yaw), cp = Math.cos(state.pitch), sp = Math.sin(state.pitch);
  const back = [cy * cp, sy * cp, sp], right = [-sy, cy, 0], up = [-cy * sp, -sy * sp, cp];
  const focal = 1.1 * h, size = Math.max(1, Math.round(h / 330));
  const project = (x, y, z) => {
    x -= state.centre[0]; y -= state.centre[1]; z -= state.centre[2];
    const d = state.distance - (x * back[0] + y * back[1] + z * back[2]);
    if (d < 0.05) return null;
    return [w / 2 + focal * ((x * right[0] + y * right[1]) / d + state.pan[0]), h / 2 - focal * ((x * up[0] + y * up[1] + z * up[2]) / d + state.pan[1]), d];
  };
  for (let i = 0; i < cloud.n; i++) {
    const q = project(cloud.xyz[3 * i], cloud.xyz[3 * i + 1], cloud.xyz[3 * i + 2]);
    if (!q) continue;
    const s = Math.min(4, size + (q[2] < 1 ? 1 : 0)), u0 = q[0] | 0, v0 = q[1] | 0;
    const colour = 0xff000000 | cloud.rgb[3 * i + 2] << 16 | cloud.rgb[3 * i + 1] << 8 | cloud.rgb[3 * i];
    for (let v = v0; v < v0 + s; v++) for (let u = u0; u < u0 + s; u++) {
      if (u < 0 || v < 0 || u >= w || v >= h || depthBuffer[v * w + u] <= q[2]) continue;
      depthBuffer[v * w + u] = q[2]; px[v * w + u] = colour;
    }
  }
  g.putImageData(picture, 0, 0);
  if ($("skeleton").checked) data.frames[state.frame].people.forEach((p, k) => drawSkeleton(g, p, cloud.people[k].map((j) => j && project(...j)), h / 380));
}
const cloudCanvas = $("cloud");
let drag = null;
cloudCanvas.addEventListener("pointerdown", (e) => { drag = [e.clientX, e.clientY, e.shiftKey]; cloudCanvas.setPointerCapture(e.pointerId); });
cloudCanvas.addEventListener("pointerup", () => { drag = null; });
cloudCanvas.addEventListener("pointermove", (e) => {
  if (!drag) return;
  const dx = e.clientX - drag[0], dy = e.clientY - drag[1], box = cloudCanvas.clientHeight;
  if (drag[2]) { state.pan[0] += dx / box / 1.1; state.pan[1] -= dy / box / 1.1; }
  else { state.yaw -= dx * 0.008; state.pitch = Math.max(-1.55, Math.min(1.55, state.pitch + dy * 0.008)); }
  drag[0] = e.clientX; drag[1] = e.clientY;
  requestAnimationFrame(drawCloud);
});
cloudCanvas.addEventListener("wheel", (e) => {
  e.preventDefault();
  state.distance = Math.max(0.2, Math.min(10, state.distance * Math.exp(e.deltaY * 0.001)));
  requestAnimationFrame(drawCloud);
}, { passive: false });

// -------------------------------------------------------------------------------------------------------- frame, list
function shown() {
  const car = $("car").value, pov = $("pov").value;
  return data.frames.map((f, k) => k).filter((k) => (!car || data.frames[k].car === car) && (!pov || data.frames[k].pov === pov));
}
async function show(k, keepView) {
  const samePlace = keepView && data.frames[k].car === data.frames[state.frame].car && data.frames[k].pov === data.frames[state.frame].pov;
  state.frame = k;
  const images = await load(k), f = data.frames[k];
  if (state.frame !== k) return;
  makeCloud(images);
  if (!samePlace) lookAt("front");
  drawImage(images); drawCloud(); readOut(images);
  $("framename").textContent = `Frame ${f.index}`;
  const facts = [["car", words(f.car)], ["view", words(f.pov)], ["people", f.people.length], ["valid pixels", `${(100 * f.valid).toFixed(1)} %`]];
  $("facts").replaceChildren(...facts.flatMap(([name, value]) => [element("dt", name), element("dd", value)]));
  $("people").replaceChildren(...f.people.map((p) => {
    const box = element("div", undefined, "person");
    box.style.borderColor = css(personColour(p.position));
    box.append(element("strong", words(p.slot)), element("span", `${p.subject}, ${words(p.action)}`));
    const counts = data.visibility_names.map((name, s) => [name, p.visibility.filter((x) => x === s).length]).filter(([, n], s) => n && s);
    box.append(element("span", counts.reverse().map(([name, n]) => `${n} ${name}`).join(", ")));
    return box;
  }));
  const seen = new Map();
  for (const l of images.labels) seen.set(l, (seen.get(l) || 0) + 1);
  $("classes").replaceChildren(...[...seen].sort((a, b) => b[1] - a[1]).map(([l]) => {
    const li = element("li"), i = element("i");
    i.style.background = css(labelRgb.subarray(3 * l, 3 * l + 3));
    li.append(i, element("span", words(labelName[l] || String(l))));
    return li;
  }));
  listFrames();
}
function listFrames() {
  const list = shown();
  $("position").textContent = `${list.indexOf(state.frame) + 1 || "–"} of ${list.length} frames on this page, ${data.summary.frames} in all`;
  for (const button of $("strip").children) {
    button.hidden = !list.includes(Number(button.dataset.k));
    button.classList.toggle("on", Number(button.dataset.k) === state.frame);
    if (Number(button.dataset.k) === state.frame) $("strip").scrollLeft = button.offsetLeft - $("strip").offsetLeft - $("strip").clientWidth / 2 + 50;
  }
}
function step(by) {
  const list = shown();
  if (list.length) show(list[(Math.max(0, list.indexOf(state.frame)) + by + list.length) % list.length], true);
}
function choices(id, names, key, redraw) {
  $(id).replaceChildren(...names.map(([value, name]) => {
    const button = element("button", name);
    button.type = "button";
    button.setAttribute("role", "radio");
    button.addEventListener("click", async () => { state[key] = value; mark(); redraw(await load(state.frame)); });
    button.dataset.value = value;
    return button;
  }));
  const mark = () => { for (const b of $(id).children) { b.classList.toggle("on", b.dataset.value === state[key]); b.setAttribute("aria-checked", b.dataset.value === state[key]); } };
  mark();
}

// ------------------------------------------------------------------------------------------------------------ summary
function card(title, body) {
  const box = element("div", undefined, "card");
  box.append(element("h3", title), body);
  return box;
}
function bars(counts, unit) {
  const box = element("div", undefined, "scroll"), entries = Object.entries(counts);
  const most = Math.max(1, ...entries.map(([, n]) => n));
  for (const [name, n] of entries) {
    const row = element("div", undefined, "row"), track = element("span", undefined, "track"), fill = element("i");
    fill.style.width = `${100 * n / most}%`;
    track.append(fill);
    const label = element("span", words(name));
    label.title = words(name);
    row.append(label, track, element("span", unit ? unit(n) : n.toLocaleString("en")));
    box.append(row);
  }
  if (!entries.length) box.append(element("span", "none"));
  return box;
}
function histogram(shares, bin) {
  const ns = "http://www.w3.org/2000/svg", svg = document.createElementNS(ns, "svg");
  svg.setAttribute("viewBox", "0 0 300 130");
  let last = shares.length;
  while (last > 1 && shares[last - 1] < 1e-4) last--;
  const used = shares.slice(0, last), most = Math.max(1e-9, ...used), width = 278 / used.length;
  used.forEach((share, i) => {
    const rect = document.createElementNS(ns, "rect");
    for (const [name, value] of Object.entries({ x: 8 + i * width, y: 105 - 100 * share / most, width: Math.max(0.5, width - 0.6), height: 100 * share / most })) rect.setAttribute(name, value);
    svg.append(rect);
  });
  const every = Math.max(1, Math.ceil(used.length * bin / 6 / 0.25)) * 0.25;
  for (let m = 0; m <= used.length * bin; m += every) {
    const label = document.createElementNS(ns, "text");
    label.setAttribute("x", 8 + m / bin * width); label.setAttribute("y", 122); label.setAttribute("text-anchor", "middle");
    label.textContent = `${Number(m.toFixed(2))}`;
    svg.append(label);
  }
  return svg;
}
function summary() {
  const s = data.summary, percent = (n, of) => `${(100 * n / Math.max(1, of)).toFixed(1)} %`;
  const joints = Object.values(s.visibility).reduce((a, b) => a + b, 0);
  const known = s.acceptance !== null; // of sequences it is not
  const outcome = known ? { accepted: Math.max(0, s.proposals - Object.values(s.rejections).reduce((a, b) => a + b, 0)) } : {};
  for (const [cause, n] of Object.entries(s.rejections)) outcome[`rejected: ${cause}`] = n;
  const cards = [
    ["Frames by car", bars(s.by_car)], ["Frames by view", bars(s.by_pov)], ["Frames by number of people", bars(s.by_people)],
    ["Frames by seat", bars(s.by_seat)], ["Frames by person", bars(s.by_subject)], ["Frames by action", bars(s.by_action)],
    ["Joints by visibility", bars(Object.fromEntries(Object.values(s.visibility).map((n, i) => [data.visibility_names[i + 1], n])), (n) => percent(n, joints))],
    ...(!s.proposals ? [] : [[known ? `Proposed poses: ${percent(outcome.accepted, s.proposals)} accepted` : `Proposed poses and activities: ${s.proposals}`, bars(outcome)]]),
    [`Depth in metres (${(100 * s.valid_pixels).toFixed(1)} % of the pixels are valid)`, histogram(s.depth_histogram, data.bin_m)],
  ];
  $("cards").replaceChildren(...cards.map(([title, body]) => card(title, body)));
}

// -------------------------------------------------------------------------------------------------------------- start
function theme(name) { document.documentElement.dataset.theme = name; $("theme").textContent = name === "dark" ? "Light" : "Dark"; }
async function start() {
  const s = data.summary;
  document.title = $("title").textContent = data.title;
  $("subtitle").textContent = `${s.frames.toLocaleString("en")} frames of ${W} × ${H} pixels, ${(s.bytes_on_disk / 1e6).toLocaleString("en", { maximumFractionDigits: 0 })} MB, made by ${s.generator} with seed ${s.seed}`;
  $("footer").textContent = `Licence ${s.licence}. Variables: ${s.variables.join(", ")}. Left and right arrow keys change the frame.`;
  theme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  $("theme").addEventListener("click", () => theme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
  for (const key of ["car", "pov"]) {
    const names = [...new Set(data.frames.map((f) => f[key]))].sort();
    $(key).replaceChildren(new Option("all", ""), ...names.map((name) => new Option(words(name), name)));
    $(key).addEventListener("change", () => { const list = shown(); if (list.length && !list.includes(state.frame)) show(list[0]); else listFrames(); });
  }
  const first = data.frames[0];
  const preview = (first.renderer || "").startsWith("raster") ? " (raster preview)" : "";
  choices("layers", [["depth", "depth"], ["depth_clean", "geometry"], ["amplitude", "amplitude"], ["labels", "classes"], ["rgb", `colour${preview}`], ["nir", `near infrared${preview}`], ["people", "people"]].filter(([name]) => name === "people" || first[name]), "layer", drawImage);
  choices("tints", [["people", "people"], ["labels", "classes"], ["depth", "depth"]], "tint", (images) => { makeCloud(images); drawCloud(); });
  for (const id of ["skeleton", "names", "tint"]) $(id).addEventListener("change", async () => { drawImage(await load(state.frame)); drawCloud(); });
  for (const button of document.querySelectorAll("[data-view]")) button.addEventListener("click", () => { lookAt(button.dataset.view); drawCloud(); });
  $("previous").addEventListener("click", () => step(-1));
  $("next").addEventListener("click", () => step(1));
  document.addEventListener("keydown", (e) => { if (e.target.tagName === "SELECT") return; if (e.key === "ArrowLeft") step(-1); if (e.key === "ArrowRight") step(1); });
  addEventListener("resize", async () => { drawImage(await load(state.frame)); drawCloud(); });
  $("strip").replaceChildren(...data.frames.map((f, k) => {
    const button = element("button"), img = element("img");
    img.src = `data:image/jpeg;base64,${f.thumbnail}`; img.alt = `frame ${f.index}`;
    button.type = "button"; button.dataset.k = k; button.title = `frame ${f.index}: ${words(f.car)}, ${words(f.pov)}`;
    button.append(img);
    button.addEventListener("click", () => show(k, true));
    return button;
  }));
  $("legend").replaceChildren(...data.visibility_names.map((name, i) => [name, data.visibility_colours[i]]).filter(([, c]) => c).reverse().map(([name, c]) => {
    const li = element("li"), i = element("i");
    i.style.background = css(c);
    li.append(i, element("span", name));
    return li;
  }));
  const g = $("scale").getContext("2d");
  for (let x = 0; x < 180; x++) { const d = 3 * Math.round(255 * x / 179); g.fillStyle = css(viridis.subarray(d, d + 3)); g.fillRect(x, 0, 1, 10); }
  $("scaletext").textContent = `${data.near.toFixed(2)} to ${data.far.toFixed(2)} m`;
  summary();
  await show(0);
  document.documentElement.dataset.ready = "true";
}
start();
