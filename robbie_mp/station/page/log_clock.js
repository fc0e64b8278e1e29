// The time of the log that plays: here, in the head of each tile, and for the ages that other scripts show.
export default {
  template: `<span class="playback-clock" title="The log's time">{{ text }}</span>`,
  props: { now: Object, rules: Boolean }, // rules: whether ages on this page are in the log's time; now: position_s since 1970, rate (null: as fast as possible), is_standing, doing
  data() {
    return { text: "" };
  },
  mounted() {
    this.hear();
    this.timer = setInterval(() => this.show(), SHOW_MS);
  },
  unmounted() {
    clearInterval(this.timer);
  },
  watch: {
    now: "hear",
  },
  methods: {
    hear() {
      this.heard_ms = performance.now();
      this.show();
    },
    position_s() {
      const { position_s, rate, is_standing } = this.now;
      const since_s = Math.min(MAX_AHEAD_S, (performance.now() - this.heard_ms) / 1000);
      return position_s + (is_standing ? 0 : since_s * (rate ?? 0));
    },
    show() {
      if (!this.now) return;
      // A quick log is shown with greater steps, which are no sign of age.
      const pace = this.now.rate === null ? Infinity : Math.max(1, this.now.rate);
      if (this.rules) window.log_age_s = (born_s) => (born_s == null ? null : Math.abs(this.position_s() - born_s) / pace);
      const time = new Date(1000 * this.position_s()).toISOString();
      this.text = `${time.slice(0, 10)} ${time.slice(11, 21)} UTC`;
      const { doing } = this.now;
      document.documentElement.style.setProperty("--log-time", `"${time.slice(11, 21)} ${doing === "plays" ? "" : doing}"`);
    },
  },
};

const SHOW_MS = 100;
const MAX_AHEAD_S = 0.5; // the state comes five times a second
