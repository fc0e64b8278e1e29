import { video } from "robbie-live";

// Draws on the floor in a picture, by where the camera was when it took it (floor/sight.py): the robot's track, the way that
// it drives, and a way that is proposed to a place that an operator has pressed. Places on the floor are [x, y], m. A press
// proposes a way (floor/touch_to_go.py); a second one on the ring drives it, and one elsewhere cancels it.
export default {
  template: `<div class="floor" :class="{ 'can-press': presses }">
    <svg v-if="view" viewBox="0 0 1 1" preserveAspectRatio="none" aria-hidden="true">
      <template v-for="[name, line] in lines" :key="name"><path class="edge" :d="line" /><path :class="name" :d="line" /></template></svg>
    <div v-if="missing" class="floor-why" id="floor-why" role="status">{{ missing }}</div>
    <button v-if="presses" class="floor-aim" id="floor-aim" ref="aim" :style="{ left: 100 * aim[0] + '%', top: 100 * aim[1] + '%' }" @click.stop
      @pointerdown.stop @keydown="key" aria-label="Place on the floor: the arrows move it, Enter shows the way there"></button>
    <section v-if="proposal" class="floor-card closes-with-escape" id="floor-card" aria-label="Way to the place" @click.stop @pointerdown.stop
      @keydown.enter="(event) => event.repeat && event.preventDefault()">
      <span role="status">{{ proposal.text }}</span>
      <button v-if="proposal.number" id="floor-go" ref="go" @click="go">Go</button><button id="floor-cancel" @click="cancel">Cancel</button>
    </section></div>`,
  props: { camera: String, presses: Boolean, track: Array, driven: Array, proposal: Object },
  data: () => ({ view: null, why: "", aim: [0.5, 0.8] }),
  computed: {
    lines() {
      const { base, map } = this.view;
      const lines = this.track ? [["track", track_of(this.track).map((line) => this.drawn(base, line)).join("")]] : [];
      if (map && this.driven?.length) lines.push(["driven", this.drawn(map, this.driven)]);
      if (map && this.proposal?.number) lines.push(["way", this.drawn(map, this.proposal.way) + this.drawn(map, ring(this.proposal.goal))]);
      return lines;
    },
    // Why something is not drawn that should be.
    missing() {
      if (!this.view) return (this.track || this.driven?.length || this.proposal?.number) && this.why ? `Nothing is drawn on the floor: ${this.why}` : "";
      const is_way_lost = !this.view.map && (this.driven?.length || this.proposal?.number);
      return is_way_lost ? "The way is not drawn: the robot's position on the map is not known" : "";
    },
  },
  watch: {
    "proposal.number"(number) {
      this.shown_ms = performance.now();
      if (this.by_key) this.$nextTick(() => (number ? this.$refs.go : this.proposal ? null : this.$refs.aim)?.focus());
    },
  },
  mounted() {
    this.stage = this.$el.parentElement;
    this.on_pointer = (event) => (event.type === "click" ? this.click(event) : this.point(event));
    this.on_key = (event) => {
      if (event.key === "Escape" && this.proposal) this.cancel();
      if (event.key === "j" && !event.ctrlKey && !event.altKey && !event.metaKey && !event.target.closest?.(TYPED)) this.$refs.aim?.focus();
    };
    video.add(this.$el, this.camera, (picture, about) => this.show(picture, about));
    for (const name of POINTER_EVENTS) this.stage.addEventListener(name, this.on_pointer);
    addEventListener("keydown", this.on_key);
  },
  unmounted() {
    video.remove(this.$el);
    for (const name of POINTER_EVENTS) this.stage.removeEventListener(name, this.on_pointer);
    removeEventListener("keydown", this.on_key);
  },
  methods: {
    show(picture, { floor, no_floor, stamp }) {
      if (picture === null) return;
      this.view = floor ? Object.freeze(floor) : null;
      this.why = no_floor ?? "";
      this.stamp = stamp;
    },
    // The picture that counts is the one that was there when the finger came down.
    point(event) {
      this.down = event.isPrimary ? { x: event.clientX, y: event.clientY, stamp: this.stamp } : null;
    },
    click(event) {
      const down = this.down;
      this.down = null;
      if (!this.presses || !down || Math.hypot(event.clientX - down.x, event.clientY - down.y) >= DRAG_PX) return;
      const box = this.$el.getBoundingClientRect();
      this.by_key = false;
      this.press((down.x - box.left) / box.width, (down.y - box.top) / box.height, down.stamp, box);
    },
    press(across, down, stamp, box) {
      if (this.proposal && this.is_on_ring(across, down, box)) this.go();
      else if (this.proposal) this.cancel();
      else if (stamp) this.$emit("touch", { camera: this.camera, stamp, across, down });
    },
    is_on_ring(across, down, { width, height }) {
      if (!this.view?.map || !this.proposal.number) return false;
      const [middle, ...edge] = [this.proposal.goal, ...ring(this.proposal.goal)].map((place) => projected(this.view, this.view.map, place));
      const off = (one) => (one ? Math.hypot(width * (one[0] - middle[0]), height * (one[1] - middle[1])) : 0);
      return middle !== null && off([across, down]) < Math.max(LEAST_PX, ...edge.map(off));
    },
    // Not at once: the second press of a double click was not meant for what it has brought up.
    go() {
      if (performance.now() - this.shown_ms > SETTLED_MS) this.$emit("go", { number: this.proposal.number });
    },
    cancel() {
      this.$emit("cancel");
    },
    // The keys of the cross; all others, and the arrows with Shift, mean what they mean elsewhere.
    key(event) {
      const step = STEPS[event.code];
      const is_press = event.code === "Enter" || event.code === "Space";
      if (event.shiftKey || (!step && !is_press)) return;
      event.preventDefault();
      event.stopPropagation();
      if (step) this.aim = this.aim.map((at, axis) => Math.min(1, Math.max(0, at + STEP * step[axis])));
      if (step || event.repeat) return;
      this.by_key = true;
      this.press(...this.aim, this.stamp, this.$el.getBoundingClientRect());
    },
    drawn(matrix, places) {
      let line = "", is_on = false;
      for (const place of places) {
        const at = projected(this.view, matrix, place);
        if (at) line += `${is_on ? "L" : "M"}${at[0].toFixed(4)} ${at[1].toFixed(4)}`;
        is_on = at !== null;
      }
      return line;
    },
  },
};

// Where a place on the floor is in a picture, in shares of its width and height; null if the camera does not see it.
export function projected({ focal, centre, distortion, reach }, [a, b, c, d, e, f, g, h, i], [x, y]) {
  const ahead = g * x + h * y + i;
  if (!(ahead > NEAR_M)) return null;
  const [right, down] = [(a * x + b * y + c) / ahead, (d * x + e * y + f) / ahead];
  const r = right * right + down * down;
  if (r > reach * reach) return null;
  const [k1, k2, p1, p2, k3, k4, k5, k6] = distortion ?? NONE;
  const k = (1 + r * (k1 + r * (k2 + r * k3))) / (1 + r * (k4 + r * (k5 + r * k6)));
  const u = right * k + 2 * p1 * right * down + p2 * (r + 2 * right * right);
  const v = down * k + 2 * p2 * right * down + p1 * (r + 2 * down * down);
  return [focal[0] * u + centre[0], focal[1] * v + centre[1]];
}

// Both edges of the way of a robot that goes on as now, and a bar across it at each metre; in base_link.
export function track_of([linear, angular, half_width]) {
  const bend = angular / linear;
  const far = Math.min(LENGTH_M, MAX_TURN_RAD / Math.abs(bend || 1e-9));
  const at = (way, side) => {
    const turn = bend * way;
    const [x, y] = Math.abs(turn) < 1e-6 ? [way, 0] : [Math.sin(turn) / bend, (1 - Math.cos(turn)) / bend];
    return [x - side * Math.sin(turn), y + side * Math.cos(turn)];
  };
  const ways = [...Array(Math.floor(far / STEP_M) + 1).keys()].map((n) => Math.sign(linear) * STEP_M * n);
  const across = [...Array(9).keys()].map((n) => half_width * (n / 4 - 1));
  const bars = [...Array(Math.floor(far)).keys()].map((n) => across.map((side) => at(Math.sign(linear) * (n + 1), side)));
  return [...[-half_width, half_width].map((side) => ways.map((way) => at(way, side))), ...bars];
}

function ring([x, y]) {
  return [...Array(25).keys()].map((n) => [x + RING_M * Math.cos((n * Math.PI) / 12), y + RING_M * Math.sin((n * Math.PI) / 12)]);
}

const [LENGTH_M, STEP_M, MAX_TURN_RAD] = [3, 0.1, 2.5]; // of the track
const RING_M = 0.2;
const NEAR_M = 0.05; // what is nearer to the camera's plane is not drawn
const NONE = Array(8).fill(0);
const [DRAG_PX, LEAST_PX, SETTLED_MS] = [5, 28, 500];
const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const STEP = 0.02;
const POINTER_EVENTS = ["pointerdown", "click"];
const TYPED = "input, textarea, [contenteditable], .q-menu, .q-dialog";
