// One robot of the team: its last summary, how old that is, and the way to drive it.
export default {
  template: `<div class="robot-about" :class="{ 'is-stale': now.stale }">
    <h3 :style="{ borderLeftColor: now.colour || 'currentColor' }">{{ now.name || "this robot" }}<small v-if="!now.robot"> (this robot)</small></h3>
    <p v-if="now.stale" class="robot-stale" role="alert">STALE: {{ now.stale }}</p>
    <dl>
      <dt>Stop</dt><dd class="robot-stop" :class="look">{{ stop }}</dd>
      <dt>Control</dt><dd class="robot-mode">{{ now.mode || "not known" }}</dd>
      <dt v-if="now.state">Mission</dt><dd v-if="now.state" class="robot-state">{{ now.state }}</dd>
      <dt>Battery</dt><dd class="robot-battery" :class="{ 'is-low': now.low }">{{ now.battery == null ? "not known" : now.battery + "%" }}</dd>
    </dl>
    <ul v-if="now.alarms?.length" class="robot-alarms"><li v-for="[level, text] in now.alarms" :data-level="level">{{ LEVELS[level] ?? "Note" }}: {{ text }}</li></ul>
    <p v-else class="robot-alarms">no alarms</p>
    <a v-if="now.mayHold" class="robot-take-over" :href="now.page" target="_blank" rel="noopener" @click="$emit('hold')">Take over</a>
    <a v-else-if="now.robot && now.page" class="robot-open" :href="now.page" target="_blank" rel="noopener">Its page</a></div>`,
  props: { now: { type: Object, default: () => ({ alarms: [] }) } },
  emits: ["hold"],
  data: () => ({ stop: "not known", LEVELS: ["", "Note", "Caution", "Danger"] }),
  mounted() {
    this.hear = ({ detail }) => {
      const own = detail.robots.find((one) => one.robot === this.now.robot);
      this.stop = detail.is_lost || !own ? "not known" : own.state;
    };
    addEventListener("robbie-robots", this.hear);
  },
  unmounted() {
    removeEventListener("robbie-robots", this.hear);
  },
  computed: {
    look() {
      return this.stop === "STOPPED" ? "is-stopped" : /^(stopping|NOT)/.test(this.stop) ? "is-pending" : "";
    },
  },
};
