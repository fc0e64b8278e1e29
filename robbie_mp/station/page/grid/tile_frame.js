// A tile of the grid. What is in it costs nothing until it is shown for the first time.
export default {
  template: `<div><slot v-if="seen"></slot></div>`,
  props: { panel: String, shown: Boolean },
  data() {
    return { seen: this.shown };
  },
  mounted() {
    this.let_tables_be_scrolled_by_keys();
  },
  watch: {
    shown(shown) {
      if (shown) this.seen = true;
      this.$nextTick(() => this.let_tables_be_scrolled_by_keys());
    },
  },
  methods: {
    let_tables_be_scrolled_by_keys() {
      for (const table of this.$el.querySelectorAll(".q-table__middle")) table.tabIndex = 0;
    },
  },
};
