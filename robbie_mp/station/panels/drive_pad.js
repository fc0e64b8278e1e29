// Sends "drive" events at 10 Hz while the pad, a key or a gamepad's dead man's button is held, and one
// with held = false when that ends, for any reason that the browser reports. The robot does not rely on the
// last one: it stops when the others are missing.
export default {
  template: `<div class="drive-pad" tabindex="0" role="application" aria-label="Drive: hold and move; or keys W A S D">
      <div class="drive-knob" ref="knob"></div></div>`,
  mounted() {
    this.keys = new Set();
    this.pointer = null;
    this.held = false;
    const pad = this.$el;
    pad.addEventListener("pointerdown", (event) => {
      pad.setPointerCapture(event.pointerId);
      this.pointer = this.place(event);
      this.beat();
    });
    pad.addEventListener("pointermove", (event) => {
      if (this.pointer) this.pointer = this.place(event);
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"])
      pad.addEventListener(name, () => this.let_go());
    this.on_key = (event) => {
      if (!KEYS[event.code]) return;
      if (event.type === "keyup") {
        // A released key counts as released, wherever the focus is.
        this.keys.delete(event.code);
        this.beat();
      } else if (this.is_shown() && !is_meant_for_another(event)) {
        event.preventDefault();
        this.keys.add(event.code);
        if (!event.repeat) this.beat();
      }
    };
    this.all_off = () => this.let_go();
    addEventListener("keydown", this.on_key);
    addEventListener("keyup", this.on_key);
    addEventListener("blur", this.all_off);
    addEventListener("pagehide", this.all_off);
    document.addEventListener("visibilitychange", this.all_off);
    this.timer = setInterval(() => this.beat(), 100);
  },
  unmounted() {
    clearInterval(this.timer);
    removeEventListener("keydown", this.on_key);
    removeEventListener("keyup", this.on_key);
    removeEventListener("blur", this.all_off);
    removeEventListener("pagehide", this.all_off);
    document.removeEventListener("visibilitychange", this.all_off);
    this.let_go();
  },
  methods: {
    is_shown() {
      return this.$el.offsetParent !== null && document.visibilityState === "visible";
    },
    place(event) {
      const box = this.$el.getBoundingClientRect();
      const limit = (value) => Math.max(-1, Math.min(1, value));
      return {
        linear: limit(1 - (2 * (event.clientY - box.top)) / box.height),
        angular: limit(1 - (2 * (event.clientX - box.left)) / box.width),
      };
    },
    wish() {
      if (!this.is_shown()) return null;
      if (this.pointer) return this.pointer;
      if (this.keys.size) {
        const wish = { linear: 0, angular: 0 };
        for (const code of this.keys) {
          wish.linear += KEYS[code][0];
          wish.angular += KEYS[code][1];
        }
        return wish;
      }
      for (const pad of navigator.getGamepads ? navigator.getGamepads() : [])
        if (pad && pad.buttons[DEAD_MAN_BUTTON] && pad.buttons[DEAD_MAN_BUTTON].pressed)
          return { linear: -pad.axes[1], angular: -pad.axes[0] };
      return null;
    },
    beat() {
      const wish = this.wish();
      if (wish) this.send(true, wish.linear, wish.angular);
      else if (this.held) this.send(false, 0, 0);
    },
    let_go() {
      this.pointer = null;
      this.keys.clear();
      if (this.held) this.send(false, 0, 0);
    },
    send(held, linear, angular) {
      const begins = held && !this.held;
      this.held = held;
      this.$refs.knob.style.left = `${50 - 40 * angular}%`;
      this.$refs.knob.style.top = `${50 - 40 * linear}%`;
      this.$emit("drive", { held, begins, linear, angular, sent_s: performance.now() / 1000 });
    },
  },
};

const KEYS = {
  KeyW: [1, 0], ArrowUp: [1, 0], KeyS: [-1, 0], ArrowDown: [-1, 0],
  KeyA: [0, 1], ArrowLeft: [0, 1], KeyD: [0, -1], ArrowRight: [0, -1],
};
const DEAD_MAN_BUTTON = 5; // the right shoulder button of a standard gamepad (W3C Gamepad API)

// Keys that type a text or control another element, such as arrows on sliders and tabs.
function is_meant_for_another(event) {
  if (event.ctrlKey || event.altKey || event.metaKey) return true;
  const arrows = event.code.startsWith("Arrow") ? ", [role=slider], [role=tab]" : "";
  return event.target.closest(`input, textarea, [contenteditable]${arrows}`) !== null;
}
