// The time line of the run that goes on: a lane for each kind of point, from the run's begin to now.
export default {
  template: `<div class="time-line" role="group" aria-label="What happened in this run">
    <div class="time-line-tools" role="group" aria-label="How much is shown"><button v-for="[text, span_s] in SPANS" type="button" :aria-pressed="String(span === span_s)"
      :data-span="span_s" @click="span = span_s">{{ text }}</button></div>
    <div v-for="lane in lanes" class="time-lane" :data-lane="lane.name"><span>{{ lane.name }}</span>
      <div><button v-for="one in lane.points" :key="one.key" type="button" :class="{ 'is-chosen': one.key === now.chosen, 'shows-nothing': !one.shows }"
        :style="{ left: one.left }" :title="one.text" :aria-label="one.text" @click="$emit('choose', one.key)"><i class="q-icon material-icons" aria-hidden="true">{{ one.icon }}</i></button></div></div>
    <div class="time-lane time-scale"><span></span><div><b>{{ ago(from) }}</b><b>{{ ago((from + end) / 2) }}</b><b>now</b></div></div></div>`,
  props: { now: { type: Object, default: () => ({ begin: 0, now: 1, points: [], chosen: "" }) } },
  emits: ["choose"],
  data: () => ({ SPANS, span: Infinity }),
  computed: {
    end() {
      return Math.max(this.now.now, this.now.begin + 1);
    },
    from() {
      return Math.max(this.now.begin, this.end - this.span);
    },
    lanes() {
      const { from, end } = this;
      const shown = this.now.points.filter((one) => one.at >= from)
        .map((one) => ({ ...one, left: `${(100 * (one.at - from)) / (end - from)}%` }));
      return LANES.map((name) => ({ name, points: shown.filter((one) => one.lane === name) }));
    },
  },
  methods: {
    ago(at) {
      const s = Math.round(this.end - at);
      return s < 120 ? `${s} s ago` : `${Math.floor(s / 60)}:${String(s % 60).padStart(2, "0")} min ago`;
    },
  },
};

const LANES = ["Victims", "Marks", "Stops", "Restarts", "Other"];
const SPANS = [["1 min", 60], ["10 min", 600], ["All", Infinity]];
