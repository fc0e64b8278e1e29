// A picture that stands still, on which one draws a box by dragging. It emits "boxed" with left, top, width and height in
// shares of the picture's size, or "cancelled".
export default {
  template: `<div><div class="teaching" v-if="address" id="teaching">
    <div class="camera-picture" ref="picture" :style="{ '--ratio': ratio }" @pointerdown="down" @pointermove="move" @pointerup="up"
      @pointercancel="box = null">
      <img :src="source" alt="the picture to teach from" draggable="false" @load="loaded">
      <div v-if="box" class="teaching-box" :style="style"></div></div>
    <div class="teaching-hint" role="status"><span>This picture stands still. Drag a box around one object or one face.</span>
      <button type="button" id="teach-cancel" @click="$emit('cancelled')">Cancel</button></div></div></div>`,
  props: { address: String },
  data() {
    return { box: null, ratio: 4 / 3, is_down: false };
  },
  watch: {
    address() {
      this.box = null;
      this.is_down = false;
    },
  },
  computed: {
    source() {
      return window.path_prefix + this.address;
    },
    style() {
      const { left, top, width, height } = this.rectangle();
      return { left: `${100 * left}%`, top: `${100 * top}%`, width: `${100 * width}%`, height: `${100 * height}%` };
    },
  },
  methods: {
    loaded({ target }) {
      if (target.naturalWidth) this.ratio = target.naturalWidth / target.naturalHeight;
      this.$refs.picture.dataset.loaded = "yes";
    },
    place(event) {
      const area = this.$refs.picture.getBoundingClientRect();
      const share = (value) => Math.max(0, Math.min(1, value));
      return [share((event.clientX - area.left) / area.width), share((event.clientY - area.top) / area.height)];
    },
    rectangle() {
      const [[x, y], [u, v]] = this.box;
      return { left: Math.min(x, u), top: Math.min(y, v), width: Math.abs(x - u), height: Math.abs(y - v) };
    },
    down(event) {
      if (event.button !== 0) return;
      event.preventDefault();
      this.$refs.picture.setPointerCapture(event.pointerId);
      const at = this.place(event);
      this.box = [at, at];
      this.is_down = true;
    },
    move(event) {
      if (this.is_down) this.box = [this.box[0], this.place(event)];
    },
    up(event) {
      if (!this.is_down) return;
      this.move(event);
      this.is_down = false;
      const box = this.rectangle();
      if (box.width < 0.01 || box.height < 0.01) this.box = null; // a click
      else this.$emit("boxed", box);
    },
  },
};
