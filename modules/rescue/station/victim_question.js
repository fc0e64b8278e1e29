// Asks about one victim at a time, in a place that is always there. It keeps the question that it shows as long as the
// robot asks about that victim, and never changes while a pointer is down on it. An answer names the victim that was
// shown. It is sent a few seconds after it was given: until then the question stays, and it can be changed or taken back.
export default {
  template: `<div><div id="question-place" class="question-place" :class="{ 'is-asking': shown }" role="region" aria-label="Question">
    <span v-if="!shown">No question about a victim</span>
    <div v-else id="victim-question" class="victim-question" @pointerdown="hold">
    <img v-if="shown.count" :key="shown.id" :src="picture" alt="what the camera has seen">
    <div class="asked">
      <div class="title" role="status">Is this a victim? {{ shown.text }}{{ queue }}</div>
      <div v-if="waiting" id="victim-waiting" class="silent" role="status">{{ waiting }}</div>
      <div v-else-if="shown.silent" id="victim-silent" class="silent">{{ shown.silent }}</div>
      <div v-else id="victim-time-left">{{ shown.left }}</div>
    </div>
    <div v-if="answers.length" class="answers">
      <button v-for="[text, answer, colour] in answers" type="button" :id="'victim-' + text.toLowerCase()"
        :style="{ background: colour }" :class="{ 'is-given': given?.answer === answer }" :disabled="is_inert" :data-victim="shown.id"
        @click="give(text, answer)">{{ text }} <kbd>{{ text[0] }}</kbd></button>
      <button type="button" id="victim-undo" style="background: #37474f" :disabled="!given" @click="take_back">Undo <kbd>U</kbd></button>
    </div>
    </div></div></div>`,
  props: { questions: Array, answers: Array },
  data() {
    return { shown: null, held: false, is_inert: false, waiting: "", given: null };
  },
  mounted() {
    this.let_go = () => {
      // A click event follows right after the pointer has been released.
      if (this.held) setTimeout(() => ((this.held = false), this.look()), 100);
    };
    for (const name of ["pointerup", "pointercancel"]) addEventListener(name, this.let_go);
    this.on_key = (event) => {
      if (event.repeat || event.ctrlKey || event.altKey || event.metaKey || !this.shown) return;
      if (event.target.closest?.("input, textarea, [contenteditable], .q-dialog, .q-menu")) return;
      const key = event.key.toLowerCase();
      const answer = this.answers.find(([text]) => text[0].toLowerCase() === key);
      if (answer && !this.is_inert) this.give(answer[0], answer[1]);
      else if (key === "u") this.take_back();
    };
    addEventListener("keydown", this.on_key);
    this.look();
  },
  unmounted() {
    removeEventListener("keydown", this.on_key);
    for (const name of ["pointerup", "pointercancel"]) removeEventListener(name, this.let_go);
    clearTimeout(this.timer);
    clearInterval(this.clock);
  },
  watch: {
    questions() {
      this.look();
    },
  },
  computed: {
    picture() {
      return `${window.path_prefix}/pictures/victim/${this.shown.id}?count=${this.shown.count}`;
    },
    queue() {
      return this.questions.length > 1 ? ` (1 of ${this.questions.length})` : "";
    },
  },
  methods: {
    look() {
      if (this.held || this.given) return;
      const same = this.questions.find((one) => one.id === this.shown?.id);
      const next = same ?? this.questions[0] ?? null;
      if (!same) {
        clearTimeout(this.timer);
        this.waiting = "";
        // A press meant for the previous question, or for another element there, does not answer this question.
        this.is_inert = next !== null;
        if (this.is_inert) this.timer = setTimeout(() => (this.is_inert = false), INERT_MS);
      }
      this.shown = next;
    },
    hold(event) {
      const button = event.target.closest("button");
      if (!button) return;
      button.setPointerCapture(event.pointerId); // so that this page gets the release of the pointer at any place
      this.held = true;
    },
    give(text, answer) {
      clearInterval(this.clock);
      const undo_ms = Math.min(UNDO_MS, Math.max(0, this.shown.left_s * 1000 - MARGIN_MS)); // it must not be too late then
      this.given = { id: this.shown.id, text, answer, due_ms: performance.now() + undo_ms };
      this.clock = setInterval(() => this.count_down(), COUNT_MS);
      this.count_down();
    },
    count_down() {
      const left_ms = this.given.due_ms - performance.now();
      if (left_ms <= 0) return this.say();
      this.waiting = `“${this.given.text}” is sent in ${Math.ceil(left_ms / 1000)} s`;
    },
    take_back() {
      clearInterval(this.clock);
      if (!this.given) return;
      this.waiting = "";
      this.given = null;
      this.look();
    },
    say() {
      const { id, text, answer } = this.given;
      clearInterval(this.clock);
      this.given = null;
      this.$emit("answer", { id, answer });
      this.is_inert = true;
      this.waiting = `“${text}” is sent; the robot has not answered yet`;
      clearTimeout(this.timer);
      this.timer = setTimeout(() => ((this.is_inert = false), (this.waiting = "")), REPEAT_MS);
      this.look(); // the robot may have withdrawn the question meanwhile
    },
  },
};

const UNDO_MS = 3000; // time in which an answer can be taken back
const MARGIN_MS = 1000;
const COUNT_MS = 100;
const INERT_MS = 700; // longer than it takes to see that the question is another one
const REPEAT_MS = 3000; // an answer without a reaction of the robot may be given again after this time
