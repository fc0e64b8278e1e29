// Shows the newest picture at an address, and its age, which this browser measures: with the time at which the picture
// was taken, and what it knows of the robot's clock (stop/emergency_stop.js). It fetches one picture at a time, and the
// next only when there is a newer one, so that a slow link shows fewer pictures and not older ones.
export default {
  template: `<div class="newest-image" :class="{ grayscale: look === 'is-silent' }"><img ref="image" :alt="alt" draggable="false">
    <span v-if="age" class="picture-age" :class="look">{{ age }}</span></div>`,
  props: { address: String, count: Number, alt: String, drives: Boolean },
  data() {
    return { age: "", look: "" };
  },
  mounted() {
    this.shown = 0;
    this.loading = false;
    this.born_s = null;
    this.fetch_newest();
    this.timer = setInterval(() => this.grow(), GROW_MS);
  },
  unmounted() {
    clearInterval(this.timer);
    this.is_gone = true;
    if (window.picture_to_drive_by?.element === this.$el) window.picture_to_drive_by = null;
    URL.revokeObjectURL(this.$refs.image?.src ?? "");
  },
  watch: {
    count() {
      this.fetch_newest();
    },
  },
  methods: {
    async fetch_newest() {
      if (this.loading || this.is_gone || !this.count || this.count === this.shown) return;
      this.loading = true;
      this.shown = this.count;
      try {
        const answer = await fetch(`${window.path_prefix}${this.address}?count=${this.count}`);
        if (answer.status === 200) await this.show(await answer.blob(), answer.headers.get("X-Robbie-Born"));
      } catch {
        // The next count brings another one.
      }
      this.loading = false;
      this.fetch_newest();
    },
    async show(picture, born_s) {
      const { image } = this.$refs;
      const before = image?.src;
      if (!image) return;
      image.src = URL.createObjectURL(picture);
      await image.decode().catch(() => null);
      if (before) URL.revokeObjectURL(before);
      const { naturalWidth: width, naturalHeight: height } = image;
      if (width) this.$el.parentElement?.style.setProperty("--ratio", width / height);
      this.born_s = born_s === null ? null : Number(born_s);
      if (this.drives) window.picture_to_drive_by = { element: this.$el, born_s: this.born_s };
      this.grow();
    },
    grow() {
      const age_s = window.robot_age_s?.(this.born_s);
      if (age_s == null) return;
      this.age = window.age_text(age_s);
      this.look = age_s > SILENT_S ? "is-silent" : age_s > LATE_S ? "is-late" : age_s > OLD_S ? "is-old" : "";
    },
  },
};

const GROW_MS = 50;
const OLD_S = 0.5; // from here on the robot drives more slowly (driving/driver.py)
const LATE_S = 1.0;
const SILENT_S = 2.0;
