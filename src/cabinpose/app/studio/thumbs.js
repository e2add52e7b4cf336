// Frames as small images in a grid of which only what is seen is there, however many frames there are. Arrow keys move the choice, Enter
// opens it. Frames stand as runs of numbers: [first, count], ...
const GAP = 6, CAPTION = 18, MARGIN = 2; // px; rows beside those that are seen
const KEYS = ["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "Home", "End", "PageUp", "PageDown", "Enter"];

export default {
  template: `
    <div ref="box" class="frame-grid" tabindex="0" role="listbox" aria-label="frames" :aria-activedescendant="'thumb-' + at" @scroll="seen" @keydown="key">
      <div :style="{ height: rows * high + 'px', position: 'relative' }">
        <div v-for="i in shown" :key="number(i)" :id="'thumb-' + i" role="option" :aria-selected="i === at" class="frame-thumb" :class="{ chosen: i === at }"
          :style="place(i)" @click="choose(i)" @dblclick="$emit('open')">
          <img :src="url + number(i) + query" :width="width" :height="height" draggable="false" alt="">
          <div>{{ number(i) }}<span v-if="notes.length"> · {{ notes[i] }}</span></div>
        </div>
      </div>
    </div>`,
  props: { url: String, query: String, runs: Array, notes: Array, width: Number, height: Number, chosen: Number },
  data: () => ({ at: 0, top: 0, wide: 1, tall: 1 }),
  computed: {
    starts() { let start = 0; return this.runs.map(([, count]) => { const at = start; start += count; return at; }); },
    count() { return this.runs.reduce((sum, [, count]) => sum + count, 0); },
    columns() { return Math.max(Math.floor((this.wide + GAP) / (this.width + GAP)), 1); },
    high() { return this.height + CAPTION + GAP; },
    rows() { return Math.ceil(this.count / this.columns); },
    shown() {
      const first = Math.max(Math.floor(this.top / this.high) - MARGIN, 0) * this.columns;
      const last = Math.min((Math.ceil((this.top + this.tall) / this.high) + MARGIN) * this.columns, this.count);
      return Array.from({ length: Math.max(last - first, 0) }, (_, i) => first + i);
    },
  },
  watch: {
    chosen(at) { this.at = at; this.follow(); },
    runs() { this.at = this.chosen; this.$nextTick(() => this.follow()); },
  },
  mounted() {
    this.at = this.chosen;
    this.observer = new ResizeObserver(() => { this.measure(); this.follow(); });
    this.observer.observe(this.$refs.box);
    this.measure();
  },
  unmounted() { this.observer.disconnect(); },
  methods: {
    measure() { const box = this.$refs.box; this.wide = box.clientWidth - 2; this.tall = box.clientHeight; },
    seen() { this.top = this.$refs.box.scrollTop; },
    number(i) { // the run that holds it, by halves
      let low = 0, high = this.starts.length - 1;
      while (low < high) { const middle = (low + high + 1) >> 1; if (this.starts[middle] <= i) low = middle; else high = middle - 1; }
      return this.runs[low][0] + i - this.starts[low];
    },
    place(i) {
      const left = (i % this.columns) * (this.width + GAP), top = Math.floor(i / this.columns) * this.high;
      return { left: left + "px", top: top + "px", width: this.width + "px" };
    },
    follow() { // the chosen one stays in view
      const box = this.$refs.box, top = Math.floor(this.at / this.columns) * this.high;
      if (top < box.scrollTop) box.scrollTop = top;
      else if (top + this.high > box.scrollTop + box.clientHeight) box.scrollTop = top + this.high - box.clientHeight;
      this.seen();
    },
    choose(i) {
      this.at = Math.min(Math.max(i, 0), Math.max(this.count - 1, 0));
      this.follow();
      this.$emit("chosen", this.at);
    },
    key(event) {
      if (!KEYS.includes(event.key) || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      const page = this.columns * Math.max(Math.floor(this.tall / this.high), 1);
      const step = { ArrowLeft: -1, ArrowRight: 1, ArrowUp: -this.columns, ArrowDown: this.columns, PageUp: -page, PageDown: page }[event.key];
      if (event.key === "Enter") this.$emit("open");
      else if (event.key === "Home" || event.key === "End") this.choose(event.key === "Home" ? 0 : this.count - 1);
      else if (step % this.columns || (this.at + step >= 0 && this.at + step < this.count) || Math.abs(step) === page) this.choose(this.at + step);
    },
    focus() { this.$refs.box.focus({ preventScroll: true }); },
  },
};
