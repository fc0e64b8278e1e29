// The keys of the page's actions, and the list of them. Driving (driving/driver.js), the emergency stop and questions of
// panels listen themselves; the list has their keys, too.
export default {
  template: `<div style="position: absolute"><Teleport to="body">
    <div v-if="is_open" id="key-list" class="key-list" role="dialog" aria-label="Keys" @click="is_open = false">
      <div class="sheet"><h2>Keys</h2>
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
      if (key === "?") this.is_open = !this.is_open;
      else if (this.keys.some(([name, , is_own]) => name === key && is_own)) {
        event.preventDefault();
        this.$emit("key", { key, panel: document.querySelector(".grid-stack-item:hover")?.id ?? "" });
      }
    };
    addEventListener("keydown", this.on_key);
    this.on_open = () => (this.is_open = !this.is_open);
    addEventListener("robbie-keys", this.on_open);
  },
  unmounted() {
    removeEventListener("keydown", this.on_key);
    removeEventListener("robbie-keys", this.on_open);
  },
};

const ALWAYS = [
  ["Escape", "Emergency stop"],
  ["W A S D, arrows", "Drive while held"],
  ["?", "This list"],
];
const NAMES = { "+": "+", "-": "−", " ": "Space" };
