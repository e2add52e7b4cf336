// A frame's image in colours and its people's joints over it. Depth and amplitude come as 16 bits a pixel and are coloured here, so
// that contrast and zoom cost the server nothing; a joint is dragged here, and the server told where it was let go.
const MOST_ZOOM = 64;
const HIT_PX = 12; // on the screen, from a joint to the pointer that takes it
const TELL_MS = 400, AGAIN_MS = 500, ANSWER_MS = 20000, SHOWN_MS = 8000; // what waits so long is told; tried again; given up; words stay
const REFOCUS_MS = 200; // a click within that of the window's own focus brought the window to the front
const FOCUS_MS = [60, 200, 400]; // a list that closes takes the keyboard back, at some time
const KEYS_OF = [ // which keys belong to what has the keyboard outside the image; the others are the image's
  ["input, textarea, select, [contenteditable], [role=combobox]", () => true],
  ["[role=tab], .q-item", (key) => ["Enter", " ", "Tab"].includes(key) || key.startsWith("Arrow")],
  ["button, a, [role=button], [role=checkbox], [role=switch]", (key) => ["Enter", " ", "Tab"].includes(key)],
  ["[role=slider], .q-slider", (key) => key === "Tab" || key.startsWith("Arrow")],
  ["*", (key) => key === "Tab"],
];
const OURS = /^([^?]|Enter|Tab|Escape|Arrow.*)$/; // browsers keep the others, and the page the list of keys
const KEPT = 8; // images, where those that may come next are fetched before they are shown
const counted = (count) => (count === 1 ? "1 input" : count + " inputs");

// What `packed` of pictures.py wrote: `count` numbers as differences, the low bytes first; also for points.js.
window.studioUnpack = (bytes, at, count, wide) => {
  const values = wide ? new Uint16Array(count) : new Uint8Array(count);
  for (let i = 0, last = 0; i < count; i++) {
    const even = wide ? bytes[at + i] | (bytes[at + count + i] << 8) : bytes[at + i];
    values[i] = last = (last + ((even >>> 1) ^ -(even & 1))) & 0xffff;
  }
  return values;
};

export default {
  template: `
    <div ref="box" class="frame-canvas" tabindex="0" :data-seen="seen" style="position:relative;overflow:hidden;width:100%;height:100%">
      <canvas ref="canvas" style="width:100%;height:100%;display:block;cursor:crosshair;touch-action:none"></canvas>
      <div ref="note" style="position:absolute;left:8px;bottom:6px;font:12px monospace;color:#fff;background:#0009;
        padding:1px 6px;border-radius:4px;pointer-events:none"></div>
      <div v-if="unwritten || untaken" role="status" class="frame-canvas-inputs" style="position:absolute;right:8px;top:6px;max-width:60%;
        font:13px sans-serif;color:#fff;background:#a33;padding:3px 8px;border-radius:4px;pointer-events:none">
        {{ [unwritten, untaken].filter((words) => words).join("; ") }}</div>
      <div v-if="state" style="position:absolute;inset:0;display:flex;align-items:center;justify-content:center;color:#889;
        font:14px sans-serif;pointer-events:none">{{ state }}</div>
    </div>`,
  props: { keeps: String, url: String, near: Number, far: Number, people: Array, limbs: Array, editable: Boolean, live: Boolean, selected: Array, palette: Array, inputs: String, most: Number, ahead: Array, taken: Array },
  data: () => ({ unwritten: "", untaken: "", state: "loading", seen: "", image: null, view: null, drag: null, pointer: null, loads: 0, loading: false, shown: [], loaded: 0, waiting: false }),
  created() { // what is done here and not yet there, oldest first
    Object.assign(this, { keeping: [], queue: [], number: 0, name: Math.random().toString(36).slice(2), sending: false, trouble: "", closed: false, cache: new Map() });
    this.leaving = (event) => { if (this.queue.length) event.preventDefault(); };
  },
  mounted() {
    window.addEventListener("beforeunload", this.leaving);
    const canvas = this.$refs.canvas;
    this.context = canvas.getContext("2d");
    this.observer = new ResizeObserver(() => this.fit());
    this.observer.observe(this.$refs.box);
    canvas.addEventListener("wheel", this.wheel, { passive: false });
    for (const [name, handler] of [["pointerdown", this.down], ["pointermove", this.move], ["pointerup", this.up], ["pointercancel", this.release], ["pointerleave", this.leave]])
      canvas.addEventListener(name, handler);
    canvas.addEventListener("dblclick", () => { this.view = null; this.kept = []; this.draw(); this.keep(); });
    this.leaveFocus = (event) => { if (!this.$refs.box.contains(event.target)) this.keeping.forEach(clearTimeout); };
    document.addEventListener("pointerdown", this.leaveFocus, true);
    this.toFront = () => { this.frontSince = performance.now(); };
    window.addEventListener("focus", this.toFront);
    if (this.inputs) document.addEventListener("keydown", this.key);
    if (this.taken) document.addEventListener("keydown", this.press);
    this.kept = this.keeps ? (new URL(location).searchParams.get(this.keeps) || "").split(",").map(Number) : [];
    if (this.inputs) this.focus();
    this.load();
  },
  activated() { if (this.inputs) this.focus(); },
  unmounted() {
    this.observer.disconnect();
    window.removeEventListener("beforeunload", this.leaving);
    window.removeEventListener("focus", this.toFront);
    document.removeEventListener("pointerdown", this.leaveFocus, true);
    document.removeEventListener("keydown", this.key);
    document.removeEventListener("keydown", this.press);
    this.keeping.forEach(clearTimeout);
  },
  watch: {
    url() { this.load(); },
    near() { this.recolour(); }, far() { this.recolour(); }, palette() { this.recolour(); },
    people() { if (!this.loading) this.take(); }, // of a frame whose image is on its way: with that image
    selected() { this.draw(); },
  },
  methods: {
    take() {
      if (this.drag) return;
      this.shown = JSON.parse(JSON.stringify(this.people || []));
      this.draw();
    },
    async load() {
      const load = ++this.loads;
      const url = this.url;
      if (!url) { this.state = "no image"; this.seen = ""; this.image = null; this.take(); return; }
      this.loading = true;
      try {
        const image = await (this.ahead ? this.fetched(url) : this.fetchImage(url));
        if (load !== this.loads) return; // another frame was asked for meanwhile
        this.loaded = load;
        const { width, height } = image;
        const same = this.image && this.image.width === width && this.image.height === height;
        this.image = image;
        if (!same) this.view = null;
        this.state = "";
        this.seen = url; // goes with all that is done: the server ignores what was meant for the image before
        this.loading = false;
        this.colour();
        this.take();
        this.$emit("loaded");
        for (const next of this.ahead || []) this.fetched(next).catch(() => null);
      } catch (error) {
        if (load !== this.loads) return;
        this.loading = false;
        this.seen = url;
        if (this.live && this.image) return; // a frame that was gone before it was fetched: the next one is coming
        this.image = null;
        this.state = "this image cannot be had: " + error.message;
        this.draw();
        this.$emit("loaded");
      }
    },
    async fetchImage(url) {
      const answer = await fetch(url);
      if (!answer.ok) throw new Error(await answer.text());
      const body = await answer.arrayBuffer(), told = (name) => answer.headers.get("x-" + name);
      const [width, height] = [+told("width"), +told("height")], wide = told("bits") !== "8";
      const values = told("packed") ? window.studioUnpack(new Uint8Array(body), 0, width * height, wide) : wide ? new Uint16Array(body) : new Uint8Array(body);
      return { width, height, step: +told("step"), kind: told("kind"), values, unit: told("unit") || "" };
    },
    fetched(url) { // an image, asked for once
      const image = this.cache.get(url) || this.fetchImage(url);
      this.cache.delete(url); // to the end of those that are kept
      this.cache.set(url, image);
      image.catch(() => this.cache.delete(url));
      for (const [old] of this.cache) if (this.cache.size > KEPT) this.cache.delete(old);
      return image;
    },
    recolour() { // once for all that changes together; not for an image that is on its way out
      if (this.waiting) return;
      this.waiting = true;
      this.$nextTick(() => { this.waiting = false; if (this.loaded === this.loads) this.colour(); });
    },
    colour() {
      if (!this.image) return;
      const { width, height, step, kind, values } = this.image; // out of Vue's proxy, which each pixel would ask again
      const picture = new ImageData(width, height), out = new Uint32Array(picture.data.buffer);
      const palette = Uint32Array.from(this.palette || [], ([r, g, b]) => (255 << 24) | (b << 16) | (g << 8) | r);
      if (kind === "classes") {
        for (let i = 0; i < out.length; i++) out[i] = palette[values[i] % palette.length];
      } else {
        const last = palette.length - 1, grey = kind === "grey", invalid = grey ? 255 << 24 : 0xff2e2826;
        const low = this.near / step, scale = step / Math.max(this.far - this.near, 1e-9);
        for (let i = 0; i < out.length; i++) {
          const share = Math.min(Math.max((values[i] - low) * scale, 0), 1);
          out[i] = values[i] ? palette[Math.round((grey ? Math.sqrt(share) : share) * last)] : invalid;
        }
      }
      this.bitmap = new OffscreenCanvas(width, height);
      this.bitmap.getContext("2d").putImageData(picture, 0, 0);
      requestAnimationFrame(() => this.draw()); // what is drawn between frames is at times not shown
    },
    fit() {
      const box = this.$refs.box.getBoundingClientRect(), ratio = window.devicePixelRatio || 1, canvas = this.$refs.canvas;
      canvas.width = Math.max(box.width * ratio, 1); canvas.height = Math.max(box.height * ratio, 1);
      this.draw();
    },
    keptPlace() { // of the view that stands in the address, until the user zooms or moves
      const [zoom, u, v] = this.kept, { width, height } = this.$refs.canvas;
      if (!(zoom > 1 && zoom <= MOST_ZOOM && Number.isFinite(u) && Number.isFinite(v))) return null;
      const scale = zoom * Math.min(width / this.image.width, height / this.image.height);
      return { scale, x: width / 2 - (u + 0.5) * scale, y: height / 2 - (v + 0.5) * scale };
    },
    keep() { // the view, in the address: how often as large as the whole image, and the pixel in the middle
      if (!this.keeps || !this.image) return;
      const { width, height } = this.$refs.canvas, { scale, x, y } = this.place();
      const zoom = scale / Math.min(width / this.image.width, height / this.image.height);
      const words = [zoom, (width / 2 - x) / scale - 0.5, (height / 2 - y) / scale - 0.5].map((n) => n.toFixed(3)).join(",");
      window.studioRemember({ [this.keeps]: this.view ? words : "" });
    },
    place() { // the view: screen = pixel * scale + offset; the whole image until the user zooms
      const canvas = this.$refs.canvas, image = this.image;
      const view = this.view || this.keptPlace();
      if (view) return view;
      const scale = Math.min(canvas.width / image.width, canvas.height / image.height);
      return { scale, x: (canvas.width - image.width * scale) / 2, y: (canvas.height - image.height * scale) / 2 };
    },
    draw() {
      const c = this.context, canvas = this.$refs.canvas;
      if (!c) return;
      c.setTransform(1, 0, 0, 1, 0, 0);
      c.clearRect(0, 0, canvas.width, canvas.height);
      this.tell();
      if (!this.image || !this.bitmap) return;
      const { scale, x, y } = this.place(), ratio = window.devicePixelRatio || 1;
      c.imageSmoothingEnabled = false;
      c.drawImage(this.bitmap, x, y, this.image.width * scale, this.image.height * scale);
      const at = ([u, v]) => [(u + 0.5) * scale + x, (v + 0.5) * scale + y]; // an integer pixel is a pixel's centre
      this.shown.forEach((person, p) => {
        const there = (j) => person.joints[j] && person.joints[j].u !== null;
        c.lineWidth = 2 * ratio; c.strokeStyle = person.colour; c.setLineDash(person.dashed ? [5 * ratio, 4 * ratio] : []);
        for (const [a, b] of person.limbs || this.limbs || []) {
          if (!there(a) || !there(b)) continue;
          c.beginPath();
          c.moveTo(...at([person.joints[a].u, person.joints[a].v]));
          c.lineTo(...at([person.joints[b].u, person.joints[b].v]));
          c.stroke();
        }
        c.setLineDash([]);
        person.joints.forEach((joint, j) => {
          if (!there(j)) return;
          const [sx, sy] = at([joint.u, joint.v]), chosen = this.selected && this.selected[0] === p && this.selected[1] === j;
          const colour = joint.colour || person.colour;
          c.beginPath(); c.arc(sx, sy, (chosen ? 6 : 4) * ratio, 0, 7);
          c.fillStyle = joint.hidden ? "#000b" : colour; c.fill();
          c.lineWidth = (chosen ? 2.5 : 1) * ratio; c.strokeStyle = chosen ? "#fff" : "#111"; c.stroke();
          if (joint.hidden) { // a ring: what is there is not seen
            c.beginPath(); c.arc(sx, sy, (chosen ? 8 : 5) * ratio, 0, 7); c.lineWidth = 2 * ratio; c.strokeStyle = colour; c.stroke();
            c.beginPath(); c.arc(sx, sy, (chosen ? 9.5 : 6.5) * ratio, 0, 7); c.lineWidth = ratio; c.strokeStyle = "#111"; c.stroke();
          }
          if (joint.doubt) { c.beginPath(); c.arc(sx, sy, 10 * ratio, 0, 7); c.strokeStyle = "#ff3bd4"; c.lineWidth = 1.5 * ratio; c.stroke(); }
          if (chosen) {
            c.font = `${13 * ratio}px sans-serif`; c.lineWidth = 3 * ratio; c.strokeStyle = "#000c"; c.fillStyle = "#fff";
            c.strokeText(joint.name, sx + 10 * ratio, sy - 8 * ratio); c.fillText(joint.name, sx + 10 * ratio, sy - 8 * ratio);
          }
        });
      });
    },
    pixel(event) {
      const box = this.$refs.canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1, { scale, x, y } = this.place();
      const sx = (event.clientX - box.left) * ratio, sy = (event.clientY - box.top) * ratio;
      return { u: (sx - x) / scale - 0.5, v: (sy - y) / scale - 0.5, sx, sy };
    },
    nearest(event) {
      const { sx, sy } = this.pixel(event), { scale, x, y } = this.place(), ratio = window.devicePixelRatio || 1;
      let best = null, least = HIT_PX * ratio;
      this.shown.forEach((person, p) => person.fixed || person.joints.forEach((joint, j) => {
        if (joint.u === null) return;
        const distance = Math.hypot((joint.u + 0.5) * scale + x - sx, (joint.v + 0.5) * scale + y - sy);
        if (distance < least) { least = distance; best = [p, j]; }
      }));
      return best;
    },
    wheel(event) {
      event.preventDefault();
      if (!this.image) return;
      const { u, v, sx, sy } = this.pixel(event), scale = this.place().scale * Math.exp(-event.deltaY / 400);
      const whole = Math.min(this.$refs.canvas.width / this.image.width, this.$refs.canvas.height / this.image.height);
      this.kept = [];
      this.view = scale <= whole ? null : { scale: Math.min(scale, MOST_ZOOM * whole), x: 0, y: 0 };
      if (this.view) { this.view.x = sx - (u + 0.5) * this.view.scale; this.view.y = sy - (v + 0.5) * this.view.scale; }
      this.draw();
      this.keep();
    },
    down(event) {
      const focusing = document.activeElement !== this.$refs.box || performance.now() - this.frontSince < REFOCUS_MS;
      this.$refs.box.focus();
      if (!this.image) return;
      this.$refs.canvas.setPointerCapture(event.pointerId);
      const hit = event.button === 0 ? this.nearest(event) : null;
      const panning = event.button !== 0 || event.shiftKey;
      this.drag = { url: this.seen, hit, panning, focusing, moved: false, from: [event.clientX, event.clientY], view: { ...this.place() } };
      if (hit) this.ask("pick", { url: this.seen, person: hit[0], joint: hit[1] });
    },
    move(event) {
      if (!this.image) return;
      const { u, v } = this.pixel(event), drag = this.drag;
      this.pointer = { clientX: event.clientX, clientY: event.clientY };
      this.tell();
      if (!drag) return;
      if (!event.buttons) { this.release(); return; } // let go where nobody told: a menu was open
      const [dx, dy] = [event.clientX - drag.from[0], event.clientY - drag.from[1]];
      drag.moved = drag.moved || Math.hypot(dx, dy) > 3;
      if (!drag.moved) return;
      if (drag.panning) {
        const ratio = window.devicePixelRatio || 1;
        this.kept = [];
        this.view = { scale: drag.view.scale, x: drag.view.x + dx * ratio, y: drag.view.y + dy * ratio };
      } else if (drag.hit && this.editable) {
        Object.assign(this.shown[drag.hit[0]].joints[drag.hit[1]], { u, v });
      }
      this.draw();
    },
    release() { // what came meanwhile is shown, also joints of another frame
      this.drag = null;
      this.take();
    },
    up(event) {
      const drag = this.drag;
      if (drag && drag.hit && drag.moved && drag.url === this.seen) this.drag = null; // it stays where it was let go until the answer
      else this.release();
      if (drag && drag.panning) this.keep();
      if (!this.image || !drag || drag.panning) return;
      const { u, v } = this.pixel(event);
      if (drag.hit && drag.moved && this.editable) this.ask("place", { url: drag.url, person: drag.hit[0], joint: drag.hit[1], u, v, dragged: true });
      else if (!drag.hit && !drag.moved && !drag.focusing && u > -0.5 && v > -0.5 && u < this.image.width - 0.5 && v < this.image.height - 0.5)
        this.ask("place", { url: drag.url, u, v, dragged: false });
    },
    leave() { this.pointer = null; this.tell(); },
    tell() { // of the pixel under the pointer, also where another image or another part of it comes there
      if (!this.image || !this.pointer) { this.$refs.note.textContent = ""; return; }
      const { u, v } = this.pixel(this.pointer);
      const { width, height, values, step, unit } = this.image, [x, y] = [Math.round(u), Math.round(v)];
      const inside = x >= 0 && y >= 0 && x < width && y < height, value = inside ? values[y * width + x] : 0;
      this.$refs.note.textContent = inside ? `${x}, ${y}: ${value ? (value * step).toFixed(unit === "m" ? 3 : 0) + " " + unit : "invalid"}` : "";
    },
    free(event) { // a key anywhere on the page, while the image is seen and nothing else that has the keyboard wants it
      if (!this.$refs.box.offsetParent || document.querySelector(".q-dialog, .q-menu")) return false;
      return this.$refs.box.contains(event.target) || !KEYS_OF.find(([what]) => event.target.closest(what))?.[1](event.key);
    },
    press(event) {
      if (!this.taken.includes(event.key) || event.ctrlKey || event.metaKey || event.altKey || !this.free(event)) return;
      event.preventDefault();
      this.$emit("pressed", event.key);
    },
    key(event) {
      if (!OURS.test(event.key) || !this.free(event)) return;
      if (event.key === "Escape") { this.keeping.forEach(clearTimeout); this.$refs.box.blur(); return; }
      if (event.ctrlKey || event.metaKey || event.altKey) { if (!(event.ctrlKey && event.key === "z")) return; }
      event.preventDefault();
      this.ask("key", { url: this.seen, key: event.key, shift: event.shiftKey });
    },
    ask(event, values) {
      if (!this.inputs) return;
      this.queue.push({ n: ++this.number, event, since: performance.now(), ...values });
      this.send();
    },
    async send() { // one request at a time, with all that waits: the next goes once this one is done
      if (this.sending) return;
      this.sending = true;
      const clock = setInterval(() => this.tellWaiting(), TELL_MS / 2);
      while (this.queue.length && !this.closed) {
        const inputs = this.queue.slice(0, this.most).map(({ since, ...input }) => input);
        try {
          const body = JSON.stringify({ window: this.name, inputs });
          const answer = await fetch(this.inputs, { method: "POST", headers: { "content-type": "application/json" }, body, signal: AbortSignal.timeout(ANSWER_MS) });
          if (answer.status >= 500) throw new Error();
          this.closed = answer.status === 404;
          if (this.closed) break;
          const said = answer.ok ? await answer.json() : { taken: inputs[inputs.length - 1].n, missed: 0, refused: inputs.length, why: await answer.text() };
          this.queue = this.queue.filter(({ n }) => n > said.taken);
          this.trouble = "";
          this.tellRefused(said);
        } catch {
          this.trouble = "the studio does not answer: ";
          await new Promise((ready) => setTimeout(ready, AGAIN_MS));
        }
      }
      clearInterval(clock);
      this.sending = false;
      this.tellWaiting();
    },
    tellWaiting() {
      const count = this.queue.length, old = count && performance.now() - this.queue[0].since > TELL_MS;
      if (this.closed) this.unwritten = count ? `this page is not the studio's any more: ${counted(count)} not written; load it again` : "";
      else this.unwritten = old ? `${this.trouble}${counted(count)} not yet written` : "";
    },
    tellRefused({ missed, refused, why }) {
      if (!missed && !refused) return;
      const words = [];
      if (missed) words.push(`${counted(missed)} not taken: the next frame was not shown yet`);
      if (refused) words.push(`${counted(refused)} not taken: ${why}`);
      this.untaken = words.join("; ");
      clearTimeout(this.forgetting);
      this.forgetting = setTimeout(() => { this.untaken = ""; }, SHOWN_MS);
    },
    focus() { // once, and again where a list has taken the keyboard meanwhile
      this.keeping.forEach(clearTimeout);
      this.keeping = FOCUS_MS.map((wait, again) => setTimeout(() => {
        const box = this.$refs.box, at = document.activeElement, free = again === 0 || at === document.body || at.closest(".q-select");
        if (box?.offsetParent && free && !document.querySelector(".q-menu, .q-dialog")) box.focus({ preventScroll: true });
      }, wait));
    },
  },
};
