// The results of a mission that has ended. They stay on the page, also when the robot is gone, until you close them.
export default {
  template: `<div style="position: absolute"><section v-if="rows.length && !is_closed" id="mission-results" class="mission-results"
      aria-label="Results of the mission">
    <h2>The mission has ended</h2>
    <dl><template v-for="[name, text] in rows" :key="name"><dt>{{ name }}</dt><dd>{{ text }}</dd></template></dl>
    <button type="button" id="close-results" @click="is_closed = true">Close</button>
  </section></div>`,
  props: { rows: Array },
  data() {
    return { is_closed: false };
  },
  watch: {
    rows() {
      this.is_closed = false;
    },
  },
};
