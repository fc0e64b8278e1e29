// Turns the camera: with Shift and the arrows, a gamepad's right stick, or by dragging the picture; V centres it. While one
// of these is held, "look" events are sent at 20 Hz, and one with held = false when that ends, as driving/driver.js does.
export default {
  template: `<div style="position: absolute"></div>`,
  mounted() {
    this.keys = new Set();
    this.drag = null;
    this.centres_until_ms = 0;
    this.held = false;
    this.on_key = (event) => {
      if (event.type === "keyup") this.keys.delete(event.code);
      else if (!this.is_shown() || is_typed(event)) return;
      else if (ARROWS[event.code] && event.shiftKey) {
        event.preventDefault();
        this.keys.add(event.code);
      } else if (event.code === "KeyV" && !event.repeat) this.centres_until_ms = performance.now() + CENTRE_MS;
      this.beat();
    };
    this.stage = this.$el.parentElement.querySelector(".camera-picture");
    this.on_pointer = (event) => this.pointer(event);
    this.all_off = () => this.let_go();
    for (const name of KEY_EVENTS) addEventListener(name, this.on_key);
    for (const name of POINTER_EVENTS) this.stage.addEventListener(name, this.on_pointer);
    for (const name of ["blur", "pagehide"]) addEventListener(name, this.all_off);
    document.addEventListener("visibilitychange", this.all_off);
    this.timer = setInterval(() => this.beat(), BEAT_MS);
  },
  unmounted() {
    clearInterval(this.timer);
    for (const name of KEY_EVENTS) removeEventListener(name, this.on_key);
    for (const name of POINTER_EVENTS) this.stage.removeEventListener(name, this.on_pointer);
    for (const name of ["blur", "pagehide"]) removeEventListener(name, this.all_off);
    document.removeEventListener("visibilitychange", this.all_off);
    this.let_go();
  },
  methods: {
    is_shown() {
      return document.visibilityState === "visible" && this.stage.offsetParent !== null;
    },
    pointer(event) {
      if (event.type === "pointerdown" && event.isPrimary && event.button === 0) {
        this.stage.setPointerCapture(event.pointerId);
        this.drag = { x: event.clientX, y: event.clientY, offset: null };
      } else if (event.type === "pointermove" && this.drag) {
        const { width } = this.stage.getBoundingClientRect();
        const [right, down] = [event.clientX - this.drag.x, event.clientY - this.drag.y];
        if (!this.drag.offset && Math.hypot(right, down) < MIN_DRAG_PX) return;
        this.drag.offset = [right / width, -down / width]; // the picture goes along with the hand
      } else if (event.type !== "pointermove") this.drag = null;
      this.beat();
    },
    wish() {
      if (this.drag?.offset) return { drag: this.drag.offset };
      const turn = [0, 0];
      for (const code of this.keys) ARROWS[code].forEach((part, at) => (turn[at] += part));
      const pad = [...(navigator.getGamepads?.() ?? [])].find((one) => one);
      const stick = [-(pad?.axes[2] ?? 0), pad?.axes[3] ?? 0];
      if (!turn[0] && !turn[1] && Math.hypot(...stick) > DEAD_ZONE) return { turn: stick };
      if (this.keys.size) return { turn };
      return performance.now() < this.centres_until_ms ? { centre: true } : null;
    },
    beat() {
      const wish = this.wish();
      if (wish && !wish.centre) this.centres_until_ms = 0;
      // A drag counts from where the camera looks when it begins, also while another turn goes on.
      const kind = Object.keys(wish ?? {})[0];
      if (wish && this.is_shown()) this.send({ held: true, begins: !this.held || kind !== this.kind, ...wish });
      else if (this.held) this.send({ held: false });
    },
    let_go() {
      this.keys.clear();
      this.drag = null;
      this.centres_until_ms = 0;
      if (this.held) this.send({ held: false });
    },
    send(wish) {
      this.held = wish.held;
      this.kind = ["turn", "drag", "centre"].find((kind) => kind in wish);
      this.$emit("look", { ...wish, sent_s: performance.now() / 1000 });
    },
  },
};

const ARROWS = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const KEY_EVENTS = ["keydown", "keyup"];
const POINTER_EVENTS = ["pointerdown", "pointermove", "pointerup", "pointercancel", "lostpointercapture"];
const BEAT_MS = 50;
const CENTRE_MS = 2000; // enough for the turn of a usual unit; press again for a slow one
const DEAD_ZONE = 0.2; // of a stick that nobody touches
const MIN_DRAG_PX = 5;
function is_typed(event) {
  if (event.ctrlKey || event.altKey || event.metaKey) return true;
  return event.target.closest?.("input, textarea, [contenteditable], .q-menu, .q-dialog") != null;
}
