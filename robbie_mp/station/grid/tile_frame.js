// A tile of the grid. What is in it costs nothing until it is shown for the first time.
export default {
  template: `<div><slot v-if="seen"></slot></div>`,
  props: { panel: String, shown: Boolean },
  data() {
    return { seen: this.shown };
  },
  watch: {
    shown(shown) {
      if (shown) this.seen = true;
    },
  },
};
