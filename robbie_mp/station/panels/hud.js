// The robot's movement over the picture that one drives by. What is not known is left out.
export default {
  template: `<div class="hud" aria-hidden="false">
    <div class="hud-name" v-if="now.camera">{{ now.camera }}</div>
    <div class="hud-hint" v-if="now.hint" role="alert">{{ now.hint }}</div>
    <svg class="hud-level" v-if="now.roll != null && now.camera" viewBox="-50 -30 100 60" role="img"
      :aria-label="'pitch ' + now.pitch + '°, roll ' + now.roll + '°'">
      <g :transform="'rotate(' + -now.roll + ') translate(0 ' + -now.pitch + ')'"><path d="M-44 0H-14M14 0H44" /></g>
      <path class="own" d="M-8 0L0 4L8 0" />
    </svg>
    <svg class="hud-look" :class="{ aside: is_aside }" id="hud-look" v-if="now.look" viewBox="-30 -34 60 64" role="img"
      :aria-label="'The camera looks ' + way">
      <path class="wedge" :transform="'rotate(' + -now.look[0] + ')'" d="M0 0L-15 -30A33 33 0 0 1 15 -30Z" />
      <path class="robot" d="M-9 12V-7L0 -14L9 -7V12Z" />
      <text y="28">{{ way }}</text>
    </svg>
    <svg class="hud-ring" id="hud-ring" v-if="now.ring?.length" viewBox="-50 -50 100 100" role="img" :aria-label="'free around: ' + around">
      <g v-for="(free, at) in now.ring" :key="at"><path v-if="free != null" :class="near(free)" :d="ARC" :transform="'rotate(' + -45 * at + ')'"
        :data-at="DIRECTIONS[at]" :data-m="free" /><text v-if="free != null && free < SAID_M" :class="near(free)" :x="place(at)[0]" :y="place(at)[1]">{{ free.toFixed(1) }}</text></g>
      <text class="speed" y="1">{{ now.linear == null ? "" : now.linear.toFixed(2) }}</text><text class="unit" y="11">m/s</text>
    </svg>
    <div class="hud-bumper" id="hud-bumper" v-if="now.pressed?.length" role="alert">Touches: {{ now.pressed.join(", ") }}</div>
    <div class="hud-band" v-if="now.linear != null">
      <div class="hud-item"><b :class="{ warn: now.silent }">{{ now.linear.toFixed(2) }}</b> m/s
        <div class="hud-bar" title="commanded (line) and true (bar) speed">
          <i :style="bar(now.linear)"></i><s v-if="now.commanded != null" :style="mark(now.commanded)"></s></div></div>
      <div class="hud-item">{{ now.angular < 0 ? "↷" : "↶" }} <b>{{ Math.abs(now.angular).toFixed(1) }}</b> rad/s</div>
      <div class="hud-item" v-if="now.commanded != null">commanded <b>{{ now.commanded.toFixed(2) }}</b></div>
      <div class="hud-item" v-if="now.heading != null">heading <b>{{ now.heading }}°</b></div>
      <div class="hud-item" v-if="now.pitch != null">pitch <b>{{ now.pitch }}°</b> roll <b>{{ now.roll }}°</b></div>
      <div class="hud-item" v-if="now.ahead != null">ahead <b :class="{ warn: now.ahead < 0.3 }">{{ now.ahead }} m</b></div>
      <div class="hud-item warn" id="hud-slowed" v-if="now.slowed < 100">top speed <b>{{ now.slowed }} %</b>: old picture or slow network</div>
      <div class="hud-item warn" v-if="now.silent">odometry silent for {{ now.silent }}</div>
    </div></div>`,
  props: { now: Object },
  data: () => ({ ARC, DIRECTIONS, SAID_M }),
  computed: {
    around() {
      return this.now.ring.map((free, at) => (free == null ? "" : `${DIRECTIONS[at]} ${free} m`)).filter(Boolean).join(", ");
    },
    is_aside() {
      return Math.abs(this.now.look[0]) > 10;
    },
    way() {
      const [left] = this.now.look;
      return this.is_aside ? `${Math.abs(left)}° ${Math.abs(left) > 170 ? "behind" : left > 0 ? "left" : "right"}` : "ahead";
    },
  },
  methods: {
    near(free) {
      return free < 0.3 ? "is-near" : free < SAID_M ? "is-close" : "";
    },
    // Of the distance in a direction, inside the ring.
    place(at) {
      const angle = (Math.PI / 4) * at;
      return [-29 * Math.sin(angle), -29 * Math.cos(angle) + 3];
    },
    share(speed) {
      return 50 * Math.max(-1, Math.min(1, speed / (this.now.scale || 1)));
    },
    bar(speed) {
      const share = this.share(speed);
      return { left: `${50 + Math.min(0, share)}%`, width: `${Math.abs(share)}%` };
    },
    mark(speed) {
      return { left: `${50 + this.share(speed)}%` };
    },
  },
};

const SAID_M = 1.0; // a smaller distance is told as a number, too
const DIRECTIONS = ["ahead", "ahead left", "left", "behind left", "behind", "behind right", "right", "ahead right"];
// The eighth of a ring that lies ahead, which is up.
const [SIN, COS] = [Math.sin(Math.PI / 9), Math.cos(Math.PI / 9)];
const ARC = `M${-46 * SIN} ${-46 * COS}A46 46 0 0 1 ${46 * SIN} ${-46 * COS}L${38 * SIN} ${-38 * COS}A38 38 0 0 0 ${-38 * SIN} ${-38 * COS}Z`;
