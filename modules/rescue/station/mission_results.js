// The results of a mission that has ended. They stay on the page, also when the robot is gone, until you close them.
export default {
  template: `<div style="position: absolute"><section v-if="rows.length && !is_closed" id="mission-results" class="mission-results"
      aria-label="Results of the mission">
    <h2>{{ title }}</h2>
    <dl><template v-for="[name, text] in rows" :key="name"><dt>{{ name }}</dt><dd>{{ text }}</dd></template></dl>
    <p v-if="files.length">Report: <a v-for="name in files" :key="name" :href="prefix + '/results/' + name" :download="name">{{ name }}</a></p>
    <button type="button" id="close-results" @click="is_closed = true">Close</button>
  </section></div>`,
  props: { title: String, rows: Array, files: Array },
  created() {
    this.prefix = window.path_prefix;
  },
  data() {
    return { is_closed: false };
  },
  watch: {
    rows() {
      this.is_closed = false;
    },
  },
};
