// Sends "drive" events at 20 Hz while the pad, a key or a gamepad's dead man's button is held, and one
// with held = false when that ends, for any reason that the browser reports. The robot does not rely on the
// last one: it stops when the others are missing.
//
// It also answers the server's pings, by which the server knows the age of these events (dead_man.py). While
// Shift is held, the robot drives without its guard against collisions.
//
// Keys drive wherever the focus is, but for texts, menus and dialogs, and only while the page shows the pad or a camera to drive by.
export default {
  template: `<div style="position: absolute"></div>`,
  mounted() {
    this.keys = new Set();
    this.pointer = null;
    this.may_hold_gamepad = false;
    this.held = false;
    this.unguarded = false;
    this.on_key = (event) => {
      if (!KEYS[event.code]) {
        this.note_shift(event);
        return;
      }
      if (event.type === "keyup") {
        // A released key counts as released, wherever the focus is.
        this.keys.delete(event.code);
        this.note_shift(event);
        this.beat();
      } else if (this.is_shown() && !is_meant_for_another(event)) {
        event.preventDefault();
        if (event.shiftKey && event.code.startsWith("Arrow")) return; // turns the camera (panels/camera_look.js)
        if (event.repeat) return; // held since before it counted, if not known: the operator takes hold again
        this.keys.add(event.code);
        this.note_shift(event);
        this.beat();
      }
    };
    this.on_pad = (event) => {
      const begins_or_ends = !this.pointer !== !event.detail;
      this.pointer = event.detail;
      if (begins_or_ends) this.beat();
    };
    this.all_off = () => this.let_go();
    addEventListener("keydown", this.on_key);
    addEventListener("keyup", this.on_key);
    addEventListener("robbie-pad", this.on_pad);
    addEventListener("blur", this.all_off);
    addEventListener("pagehide", this.all_off);
    document.addEventListener("visibilitychange", this.all_off);
    this.timer = setInterval(() => this.beat(), BEAT_MS);
  },
  unmounted() {
    clearInterval(this.timer);
    removeEventListener("keydown", this.on_key);
    removeEventListener("keyup", this.on_key);
    removeEventListener("robbie-pad", this.on_pad);
    removeEventListener("blur", this.all_off);
    removeEventListener("pagehide", this.all_off);
    document.removeEventListener("visibilitychange", this.all_off);
    this.let_go();
  },
  methods: {
    // Shift with an arrow turns the camera: it does not take the guard away from a robot that arrows drive.
    note_shift(event) {
      this.unguarded = event.shiftKey && ![...this.keys].some((code) => code.startsWith("Arrow"));
    },
    is_shown() {
      if (document.visibilityState !== "visible") return false;
      return [...document.querySelectorAll(".drives")].some((one) => one.offsetParent !== null);
    },
    wish() {
      const wish = this.held_input();
      return wish && this.is_shown() ? wish : null; // is_shown last: it may make the browser lay out the page
    },
    held_input() {
      if (this.pointer && this.pointer.pad.offsetParent !== null) return this.pointer;
      if (this.keys.size) {
        const wish = { linear: 0, angular: 0 };
        for (const code of this.keys) {
          wish.linear += KEYS[code][0];
          wish.angular += KEYS[code][1];
        }
        return wish;
      }
      const pads = navigator.getGamepads ? [...navigator.getGamepads()] : [];
      const pad = pads.find((one) => one?.buttons[DEAD_MAN_BUTTON]?.pressed);
      // One that is held while the page opens, or since the operator was taken to have let go, must be let go first.
      this.may_hold_gamepad ||= !pad;
      return pad && this.may_hold_gamepad ? by_stick(pad) : null;
    },
    beat() {
      const wish = this.wish();
      if (wish) this.send(true, wish.linear, wish.angular);
      else if (this.held) this.send(false, 0, 0);
    },
    let_go() {
      this.unguarded = false;
      this.pointer = null;
      this.may_hold_gamepad = false;
      this.keys.clear();
      if (this.held) this.send(false, 0, 0);
    },
    send(held, linear, angular) {
      const begins = held && !this.held;
      this.held = held;
      dispatchEvent(new CustomEvent("robbie-driven", { detail: { linear, angular } }));
      const { unguarded } = this;
      const picture_age_s = age_of_picture();
      this.$emit("drive", { held, begins, linear, angular, unguarded, picture_age_s, sent_s: performance.now() / 1000 });
    },
    answer(number) {
      this.$emit("pong", { number, page_s: performance.now() / 1000 });
    },
  },
};

// The age of the picture that the operator drives by, s; null if none is in sight.
function age_of_picture() {
  const picture = window.picture_to_drive_by;
  return picture && picture.element.offsetParent !== null ? window.robot_age_s(picture.born_s) : null;
}

const KEYS = {
  KeyW: [1, 0], ArrowUp: [1, 0], KeyS: [-1, 0], ArrowDown: [-1, 0],
  KeyA: [0, 1], ArrowLeft: [0, 1], KeyD: [0, -1], ArrowRight: [0, -1],
};
const BEAT_MS = 50; // much less than the time for which the station lets a command be valid
const DEAD_MAN_BUTTON = 5; // the right shoulder button of a standard gamepad (W3C Gamepad API)
const SLOW_BUTTON = 4; // the left one
const SLOW_SHARE = 1 / 3;
const DEAD_ZONE = 0.12; // of a worn stick that nobody touches

// What the left stick of a gamepad asks for.
function by_stick({ axes, buttons }) {
  const share = (buttons[SLOW_BUTTON]?.pressed ? SLOW_SHARE : 1) / (1 - DEAD_ZONE);
  const pushed = (axis) => -Math.sign(axis) * Math.max(0, Math.min(1, Math.abs(axis)) - DEAD_ZONE) * share;
  return { linear: pushed(axes[1]), angular: pushed(axes[0]) };
}

// Keys that type a text, choose in a menu or dialog, or move a slider. A menu that closes keeps the focus for a moment.
const TAKES_KEYS = "input, textarea, [contenteditable], [role=listbox], [role=menu], [role=dialog], .q-menu, .q-dialog";
function is_meant_for_another(event) {
  if (event.ctrlKey || event.altKey || event.metaKey) return true;
  const arrows = event.code.startsWith("Arrow") ? ", [role=slider]" : "";
  return event.target.closest?.(TAKES_KEYS + arrows) != null;
}
