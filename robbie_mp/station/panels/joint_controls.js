// Sliders for joints, and buttons for poses. While one is held, "move" events are sent at 20 Hz, and one with
// held = false when that ends. The robot does not rely on the last one: the joints stop when the others are missing.
export default {
  template: `<div class="joint-controls">
    <div v-for="joint in joints" :key="joint.key" class="joint-row">
      <span class="joint-name">{{ joint.name }}</span>
      <input v-if="can_move" type="range" :min="joint.lower" :max="joint.upper" step="any" :value="shown(joint)"
        :data-joint="joint.key" :aria-label="joint.name" :class="{ 'joint-unknown': joint.at === null }"
        @pointerdown="aim(joint, $event)" @input="aim(joint, $event)"
        @pointerup="let_go" @pointercancel="let_go" @keyup="let_go" @blur="all_off">
      <span class="joint-at" :data-at="joint.key">{{ joint.at === null ? "NOT SET" : joint.at.toFixed(3) + " rad" }}</span>
      <template v-if="can_move && joint.is_gripper">
        <button v-for="[text, end] in [['Open', joint.upper], ['Close', joint.lower]]" :key="text" class="joint-button"
          @pointerdown="hold([[joint.key, end]])" @pointerup="let_go" @pointerleave="let_go" @pointercancel="let_go"
          @keydown.space.prevent="hold([[joint.key, end]])" @keyup="let_go" @blur="all_off">{{ text }} {{ joint.name }}</button>
      </template>
    </div>
    <div v-if="can_move" class="joint-poses">
      <button v-for="pose in poses" :key="pose.name" class="joint-button" :data-pose="pose.name"
        @pointerdown="hold(pose.goals)" @pointerup="let_go" @pointerleave="let_go" @pointercancel="let_go"
        @keydown.space.prevent="hold(pose.goals)" @keyup="let_go" @blur="all_off">{{ pose.name }}</button>
    </div></div>`,
  props: {
    joints: { type: Array, default: () => [] },
    poses: { type: Array, default: () => [] },
    can_move: Boolean,
  },
  data: () => ({ goals: null }),
  mounted() {
    this.all_off = () => this.let_go();
    for (const name of ["blur", "pagehide"]) addEventListener(name, this.all_off);
    document.addEventListener("visibilitychange", this.all_off);
    this.timer = setInterval(() => this.goals && this.send(false), BEAT_MS);
  },
  unmounted() {
    clearInterval(this.timer);
    for (const name of ["blur", "pagehide"]) removeEventListener(name, this.all_off);
    document.removeEventListener("visibilitychange", this.all_off);
    this.let_go();
  },
  methods: {
    // Where a slider stands: at its goal while it is held, otherwise where the joint is.
    shown({ key, lower, upper, at }) {
      const goal = this.goals && this.goals.find(([other]) => other === key);
      return goal ? goal[1] : at === null ? (lower + upper) / 2 : at;
    },
    aim(joint, event) {
      if (event.type === "pointerdown") event.target.setPointerCapture(event.pointerId);
      else this.hold([[joint.key, Number(event.target.value)]]);
    },
    hold(goals) {
      const begins = !this.goals;
      this.goals = goals;
      if (begins) this.send(true);
    },
    let_go() {
      if (!this.goals) return;
      this.goals = null;
      this.$emit("move", { held: false, begins: false, goals: [], sent_s: performance.now() / 1000 });
    },
    send(begins) {
      if (this.$el.offsetParent === null) return this.let_go();
      this.$emit("move", { held: true, begins, goals: this.goals, sent_s: performance.now() / 1000 });
    },
  },
};

const BEAT_MS = 50; // as that of driving/driver.js
