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
    <div class="hud-band" v-if="now.linear != null">
      <div class="hud-item"><b :class="{ warn: now.silent }">{{ now.linear.toFixed(2) }}</b> m/s
        <div class="hud-bar" title="commanded (line) and true (bar) speed">
          <i :style="bar(now.linear)"></i><s v-if="now.commanded != null" :style="mark(now.commanded)"></s></div></div>
      <div class="hud-item">{{ now.angular < 0 ? "↷" : "↶" }} <b>{{ Math.abs(now.angular).toFixed(1) }}</b> rad/s</div>
      <div class="hud-item" v-if="now.commanded != null">commanded <b>{{ now.commanded.toFixed(2) }}</b></div>
      <div class="hud-item" v-if="now.heading != null">heading <b>{{ now.heading }}°</b></div>
      <div class="hud-item" v-if="now.pitch != null">pitch <b>{{ now.pitch }}°</b> roll <b>{{ now.roll }}°</b></div>
      <div class="hud-item" v-if="now.ahead != null">ahead <b :class="{ warn: now.ahead < 0.3 }">{{ now.ahead }} m</b></div>
      <div class="hud-item warn" id="hud-slowed" v-if="now.slowed < 100">top speed <b>{{ now.slowed }} %</b>: old picture</div>
      <div class="hud-item warn" v-if="now.silent">odometry silent for {{ now.silent }}</div>
    </div></div>`,
  props: { now: Object },
  computed: {
    is_aside() {
      return Math.abs(this.now.look[0]) > 10;
    },
    way() {
      const [left] = this.now.look;
      return this.is_aside ? `${Math.abs(left)}° ${Math.abs(left) > 170 ? "behind" : left > 0 ? "left" : "right"}` : "ahead";
    },
  },
  methods: {
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
