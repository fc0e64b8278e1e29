// Asks about one victim at a time. It keeps the question that it shows as long as the robot asks about that victim, and
// never changes while a pointer is down on it. An answer names the victim that was shown.
export default {
  template: `<div><div v-if="shown" id="victim-question" class="victim-question" role="region" aria-label="Question"
      @pointerdown="hold">
    <img v-if="shown.count" :key="shown.id" :src="picture" alt="what the camera has seen">
    <div class="asked">
      <div class="title" role="status">Is this a victim? {{ shown.text }}{{ queue }}</div>
      <div id="victim-time-left">{{ shown.left }}</div>
      <div id="victim-silent" v-if="shown.silent" class="silent">{{ shown.silent }}</div>
      <div v-if="waiting" class="silent">{{ waiting }}</div>
    </div>
    <div v-if="answers.length" class="answers">
      <button v-for="[text, answer, colour] in answers" type="button" :id="'victim-' + text.toLowerCase()"
        :style="{ background: colour }" :disabled="is_inert" :data-victim="shown.id"
        @click="say(text, answer)">{{ text }} <kbd>{{ text[0] }}</kbd></button>
    </div>
    </div></div>`,
  props: { questions: Array, answers: Array },
  data() {
    return { shown: null, held: false, is_inert: false, waiting: "" };
  },
  mounted() {
    this.let_go = () => {
      // A click event follows right after the pointer has been released.
      if (this.held) setTimeout(() => ((this.held = false), this.look()), 100);
    };
    for (const name of ["pointerup", "pointercancel"]) addEventListener(name, this.let_go);
    this.on_key = (event) => {
      if (event.repeat || event.ctrlKey || event.altKey || event.metaKey || !this.shown || this.is_inert) return;
      if (event.target.closest?.("input, textarea, [contenteditable], .q-dialog, .q-menu")) return;
      const answer = this.answers.find(([text]) => text[0].toLowerCase() === event.key.toLowerCase());
      if (answer) this.say(answer[0], answer[1]);
    };
    addEventListener("keydown", this.on_key);
    this.look();
  },
  unmounted() {
    removeEventListener("keydown", this.on_key);
    for (const name of ["pointerup", "pointercancel"]) removeEventListener(name, this.let_go);
    clearTimeout(this.timer);
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
      if (this.held) return;
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
    say(text, answer) {
      this.$emit("answer", { id: this.shown.id, answer });
      this.is_inert = true;
      this.waiting = `“${text}” is sent; the robot has not answered yet`;
      clearTimeout(this.timer);
      this.timer = setTimeout(() => ((this.is_inert = false), (this.waiting = "")), REPEAT_MS);
    },
  },
};

const INERT_MS = 700; // longer than it takes to see that the question is another one
const REPEAT_MS = 3000; // an answer without a reaction of the robot may be given again after this time
