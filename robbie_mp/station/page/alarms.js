// The most urgent alarm in one line, which never changes its size; all alarms below it when the line is pressed. A new
// alarm sounds in one of three ways, and stands in the title of the browser's tab until somebody has acknowledged it.
export default {
  template: `<div class="alarms" role="group" aria-label="Alarms">
    <button type="button" class="alarm-line" id="alarm-line" :class="'is-level-' + (first ? first.level : 0)" aria-haspopup="true"
      :aria-expanded="open" @mousedown.prevent @click="open = !open">
      <span class="material-icons" aria-hidden="true">{{ ICONS[first ? first.level : 0] }}</span>
      <span id="alarm-text" role="status">{{ first ? first.text : alarms.length ? "no new alarm" : "no alarm" }}</span>
      <span class="alarm-count" id="alarm-count">{{ alarms.length || "" }}</span></button>
    <ul v-if="open" class="alarm-list" id="alarm-list">
      <li v-for="one in alarms" :key="one.number" :class="['is-level-' + one.level, { 'is-over': !one.active }]">
        <span class="material-icons" aria-hidden="true">{{ ICONS[one.level] }}</span>
        <span class="alarm-time">{{ one.time }}</span>
        <span class="alarm-sentence">{{ LEVELS[one.level] }}: {{ one.text }}{{ one.active ? "" : " (over)" }}</span>
        <button v-if="may && !one.acknowledged" type="button" @mousedown.prevent @click="$emit('acknowledge', one.number)"
          :aria-label="'Acknowledge: ' + one.text">Seen</button>
        <span v-else class="alarm-seen">{{ one.acknowledged ? "seen" : "" }}</span></li>
      <li v-if="!alarms.length">There is no alarm.</li></ul></div>`,
  props: { alarms: Array, may: Boolean },
  data() {
    return { open: false };
  },
  created() {
    Object.assign(this, { ICONS, LEVELS, heard: 0, title: document.title });
  },
  mounted() {
    this.take();
    this.timer = setInterval(() => this.repeat(), REPEAT_MS);
    this.on_press = ({ target }) => this.$el.contains(target) || (this.open = false);
    addEventListener("pointerdown", this.on_press);
  },
  unmounted() {
    clearInterval(this.timer);
    removeEventListener("pointerdown", this.on_press);
    document.title = this.title;
  },
  watch: {
    alarms() {
      this.take();
    },
  },
  computed: {
    first() {
      return this.alarms.find((one) => !one.acknowledged) ?? null;
    },
    waiting() {
      return this.alarms.filter((one) => !one.acknowledged);
    },
  },
  methods: {
    take() {
      const news = this.waiting.filter((one) => one.number > this.heard);
      this.heard = Math.max(this.heard, ...this.alarms.map((one) => one.number));
      document.title = this.first ? `(${this.waiting.length}) ${this.first.text} · ${this.title}` : this.title;
      if (news.length) this.sound(Math.max(...news.map((one) => one.level)));
    },
    repeat() {
      if (this.waiting.some((one) => one.level === DANGER && one.active)) this.sound(DANGER);
    },
    sound(level) {
      this.$el.dataset.sounded = level;
      if (!navigator.userActivation?.hasBeenActive) return; // browsers allow no sound before the first press
      audio ??= new AudioContext();
      if (audio.state === "suspended") audio.resume();
      for (const [at, hertz] of SOUNDS[level].entries()) beep(audio.currentTime + at * BEEP_S * 1.5, hertz);
    },
  },
};

function beep(at_s, hertz) {
  const [tone, loudness] = [audio.createOscillator(), audio.createGain()];
  tone.frequency.value = hertz;
  loudness.gain.setValueAtTime(0.15, at_s);
  loudness.gain.linearRampToValueAtTime(0, at_s + BEEP_S);
  tone.connect(loudness).connect(audio.destination);
  tone.start(at_s);
  tone.stop(at_s + BEEP_S);
}

let audio = null;
const DANGER = 3;
const REPEAT_MS = 4000;
const BEEP_S = 0.18;
const SOUNDS = [[], [440], [660, 660], [880, 1175, 880, 1175]]; // Hz, by level
const ICONS = ["notifications_none", "info", "warning", "dangerous"];
const LEVELS = ["", "Note", "Caution", "Danger"];
