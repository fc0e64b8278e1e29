// Shows the newest picture at an address. It fetches one at a time, and the next only when there is a newer
// one, so that a slow link shows fewer pictures and not older ones.
export default {
  template: `<img class="newest-image" @load="loaded" @error="loaded">`,
  props: { address: String, count: Number },
  mounted() {
    this.shown = 0;
    this.loading = false;
    this.fetch_newest();
  },
  watch: {
    count() {
      this.fetch_newest();
    },
  },
  methods: {
    fetch_newest() {
      if (this.loading || !this.count || this.count === this.shown) return;
      this.loading = true;
      this.shown = this.count;
      this.$el.src = `${window.path_prefix}${this.address}?count=${this.count}`;
    },
    loaded() {
      const { naturalWidth: width, naturalHeight: height, parentElement } = this.$el;
      if (width) parentElement?.style.setProperty("--ratio", width / height);
      this.loading = false;
      this.fetch_newest();
    },
  },
};
