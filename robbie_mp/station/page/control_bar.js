// Who controls the robot, why, and the age of this page's own link, which the emergency stop's connection measures
// (stop/emergency_stop.js). No button ever moves: one that would change nothing is disabled.
export default {
  template: `<div class="control-bar" role="group" aria-label="Control">
    <div class="control-mode" :class="'is-' + (now.mode.toLowerCase() || 'unknown')" id="control-mode" role="status">
      <span class="material-icons" aria-hidden="true">{{ icon }}</span>{{ now.mode || "control unknown" }}</div>
    <div class="control-text">
      <b id="control-who">{{ now.who }}</b>
      <span id="control-why" :class="{ 'is-alert': now.alert }" :title="now.why">{{ now.why }}</span></div>
    <div class="control-link" :class="look" id="control-link" title="How late this page is: the time until the robot answers it">
      <span class="material-icons" aria-hidden="true">{{ look === "is-late" ? "link_off" : "link" }}</span>{{ age }}</div>
    <template v-if="now.is_operator">
      <button v-for="[name, text, icon, id, key] in BUTTONS" :key="id" :id="id" type="button" :title="text + ' (key ' + key + ')'"
        :aria-label="text" :disabled="!now.orders.includes(name)" @mousedown.prevent @click="$emit('order', name)">
        <span class="material-icons" aria-hidden="true">{{ icon }}</span><span class="text">{{ text }}</span></button>
    </template></div>`,
  props: { now: Object },
  data() {
    return { age_ms: 0 };
  },
  created() {
    this.BUTTONS = BUTTONS;
  },
  mounted() {
    this.on_link = ({ detail }) => (this.age_ms = detail.age_ms);
    addEventListener("robbie-link", this.on_link);
  },
  unmounted() {
    removeEventListener("robbie-link", this.on_link);
  },
  computed: {
    icon() {
      return { AUTO: "smart_toy", MANUAL: "sports_esports", HOLD: "pause_circle" }[this.now.mode] ?? "help";
    },
    age() {
      return this.age_ms < 950 ? `${Math.ceil(this.age_ms / 10) * 10} ms` : `${(this.age_ms / 1000).toFixed(1)} s`;
    },
    look() {
      return this.age_ms > LATE_MS ? "is-late" : this.age_ms > SLOW_MS ? "is-slow" : "";
    },
  },
};

const SLOW_MS = 200; // with a longer round trip the page does not drive (driving/dead_man.py)
const LATE_MS = 1000;
const BUTTONS = [
  ["AUTO", "Go on", "play_arrow", "go-on", "G"],
  ["HOLD", "Hold", "pause", "hold", "O"],
  ["take over", "Take over", "pan_tool", "take-over", "T"],
];
