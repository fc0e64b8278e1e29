// Stops all robots of the team. The emergency stop (stop/emergency_stop.js) keeps and sends the press on its own connection,
// and tells which robots have confirmed it.
export default {
  template: `<div class="stop-all" role="group" aria-label="Stop of all robots">
    <button id="stop-all" type="button" title="Stop all robots" @pointerdown.stop="press" @mousedown.prevent @click.stop="click">STOP ALL ROBOTS</button>
    <div id="stop-all-state" role="status" :class="shown.look">{{ shown.text }}</div></div>`,
  data: () => ({ now: null }),
  mounted() {
    this.hear = (event) => (this.now = event.detail);
    addEventListener("robbie-robots", this.hear);
  },
  unmounted() {
    removeEventListener("robbie-robots", this.hear);
  },
  computed: {
    shown() {
      const { now } = this;
      if (!now) return { text: "connecting", look: "" };
      if (now.pressed_s != null && !now.is_at_station) {
        const is_soon = now.pressed_s < SOON_S;
        const text = `NOT DELIVERED: it is kept, and sent first; pressed ${Math.floor(now.pressed_s)} s ago`;
        return { text: is_soon ? "stopping …" : text, look: "is-pending" };
      }
      if (now.is_lost) return { text: "no link to this robot's station", look: "" };
      const pending = now.robots.filter((one) => one.state.startsWith("NOT CONFIRMED"));
      if (pending.length)
        return { text: pending.map((one) => `${name_of(one)}: ${one.state}`).join("; "), look: "is-pending" };
      if (now.robots.some((one) => one.state.startsWith("stopping"))) return { text: "stopping …", look: "is-pending" };
      const stopped = now.robots.filter((one) => one.state === "STOPPED").length;
      const silent = now.robots.filter((one) => !["STOPPED", "ready"].includes(one.state)).map(name_of);
      const unknown = silent.length ? `; not known: ${silent.join(", ")}` : "";
      if (stopped === now.robots.length) return { text: `all ${stopped} robots are STOPPED`, look: "is-stopped" };
      return { text: `${stopped} of ${now.robots.length} are STOPPED${unknown}`, look: "" };
    },
  },
  methods: {
    press() {
      dispatchEvent(new CustomEvent("robbie-stop-all"));
    },
    click(event) {
      if (event.detail === 0) this.press(); // by the keyboard; a pointer has pressed already when it went down
    },
  },
};

const SOON_S = 0.7;

function name_of(one) {
  return one.robot || "this robot";
}
