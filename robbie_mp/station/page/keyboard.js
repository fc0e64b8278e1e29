// The keys of the page's actions, and the list of them. Driving (driving/driver.js), the emergency stop and questions of
// panels listen themselves; the list has their keys, too.
export default {
  template: `<div style="position: absolute"><Teleport to="body">
    <div v-if="is_open" id="key-list" class="key-list" role="dialog" aria-label="Keys" @click="is_open = false">
      <div class="sheet" tabindex="0"><h2>Keys</h2>
        <dl><template v-for="[name, text] in all" :key="name"><dt><kbd>{{ name }}</kbd></dt><dd>{{ text }}</dd></template></dl>
        <p>Keys work whenever no text field has the focus. Press ? or click to close this list.</p></div>
    </div></Teleport></div>`,
  props: { keys: Array },
  data() {
    return { is_open: false };
  },
  computed: {
    all() {
      return [...ALWAYS, ...this.keys.map(([key, text]) => [NAMES[key] ?? key.toUpperCase(), text])];
    },
  },
  mounted() {
    this.on_key = (event) => {
      if (event.key === "Escape") this.is_open = false;
      if (event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
      if (event.target.closest?.("input, textarea, [contenteditable], .q-dialog, .q-menu")) return;
      const key = event.key.toLowerCase();
      if (USED[key] && event.target.closest?.(USED[key])) return; // such as the emergency stop that has the focus
      if (key === "?") this.is_open = !this.is_open;
      else if (this.keys.some(([name, , is_own]) => name === key && is_own)) {
        event.preventDefault();
        this.$emit("key", { key, panel: document.querySelector(".grid-stack-item:hover")?.id ?? "" });
      }
    };
    addEventListener("keydown", this.on_key);
    this.pressed = null; // buttons that are held when the page opens mean nothing
    this.timer = setInterval(() => this.look(), LOOK_MS);
    this.on_open = () => (this.is_open = !this.is_open);
    addEventListener("robbie-keys", this.on_open);
  },
  unmounted() {
    clearInterval(this.timer);
    removeEventListener("keydown", this.on_key);
    removeEventListener("robbie-keys", this.on_open);
  },
  methods: {
    // Acts on gamepad buttons that have just gone down; browsers send no events for them.
    look() {
      if (document.visibilityState !== "visible") return void (this.pressed = null);
      const pads = [...(navigator.getGamepads?.() ?? [])];
      const now = Object.keys(GAMEPAD_KEYS).filter((button) => pads.some((pad) => pad?.buttons[button]?.pressed));
      for (const button of now)
        if (this.pressed && !this.pressed.includes(button)) this.press(GAMEPAD_KEYS[button]);
      this.pressed = now;
    },
    press(key) {
      if (key === STOP) document.getElementById("emergency-stop")?.dispatchEvent(new PointerEvent("pointerdown"));
      else if (this.keys.some(([name, , is_own]) => name === key && is_own)) this.$emit("key", { key, panel: "" });
    },
  },
};

const ALWAYS = [
  ["Escape", "Emergency stop"],
  ["W A S D, arrows", "Drive while held"],
  ["Gamepad: right shoulder", "Held: drive by the left stick; with the left shoulder too, at a third of the speed"],
  ["Gamepad: B", "Emergency stop"],
  ["Gamepad: X, Y", "Lights, next camera"],
  ["?", "This list"],
];
const USED = { " ": "button, a, [role=button], [role=switch], [role=checkbox]", arrowleft: "[role=slider]", arrowright: "[role=slider]" };
const NAMES = { "+": "+", "-": "−", " ": "Space", "gamepad 8": "Gamepad: Back" };
const STOP = "stop";
// By the button's number on a standard gamepad (W3C Gamepad API): B, X, Y, and Back, Select or Share.
const GAMEPAD_KEYS = { 1: STOP, 2: "f", 3: "c", 8: "gamepad 8" };
const LOOK_MS = 50;
