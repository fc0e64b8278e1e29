import { video } from "robbie-live";

// Shows the newest picture of a camera, and its age, which this browser measures: with the time at which the picture
// was taken, and what it knows of the robot's clock (stop/emergency_stop.js).
export default {
  template: `<div class="newest-image" :class="{ grayscale: look === 'is-silent' }"><img ref="image" v-show="shown === 'image' && !reason" :alt="alt" draggable="false">
    <canvas ref="canvas" v-show="shown === 'frame' && !reason" role="img" :aria-label="alt"></canvas>
    <span v-if="reason" class="no-picture">No picture: {{ reason }}</span>
    <span v-else-if="!shown" class="no-picture">no picture yet</span>
    <span v-if="note" class="picture-note" role="status">{{ note }}</span>
    <span v-if="age" class="picture-age" :class="look">{{ age }}</span></div>`,
  props: { camera: String, alt: String, drives: Boolean },
  data() {
    return { age: "", look: "", reason: "", note: "", shown: "" };
  },
  mounted() {
    this.born_s = null;
    video.add(this.$el, this.camera, (picture, about) => this.show(picture, about), this.drives);
    this.timer = setInterval(() => this.grow(), GROW_MS);
  },
  unmounted() {
    clearInterval(this.timer);
    video.remove(this.$el);
    if (window.picture_to_drive_by?.element === this.$el) window.picture_to_drive_by = null;
    URL.revokeObjectURL(this.$refs.image?.src ?? "");
  },
  methods: {
    // picture: a Blob or a VideoFrame; null: there is none, for the reason in `about`.
    async show(picture, { born_s, reason, note }) {
      if (!this.$refs.image) return;
      [this.reason, this.note] = [reason ?? "", note ?? ""];
      if (picture === null) return;
      const is_frame = !(picture instanceof Blob);
      const [width, height] = is_frame ? this.paint(picture) : await this.load(picture);
      if (!width) return (this.reason = "the browser cannot decode it");
      this.shown = is_frame ? "frame" : "image";
      (this.$el.closest(".camera-card") ?? this.$el.parentElement)?.style.setProperty("--ratio", width / height);
      this.born_s = born_s;
      if (this.drives) window.picture_to_drive_by = { element: this.$el, born_s: this.born_s };
      this.grow();
    },
    async load(blob) {
      const { image } = this.$refs;
      const before = image.src;
      image.src = URL.createObjectURL(blob);
      await image.decode().catch(() => null);
      if (before) URL.revokeObjectURL(before);
      return [image.naturalWidth, image.naturalHeight];
    },
    paint(frame) {
      const { canvas } = this.$refs;
      const { displayWidth: width, displayHeight: height } = frame;
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
      canvas.getContext("2d").drawImage(frame, 0, 0);
      return [width, height];
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
