// The pad that is held to drive. It tells the page's driver (driving/driver.js) where it is held.
export default {
  template: `<div class="drive-pad drives" tabindex="0" role="application" aria-label="Drive: hold and move; or keys W A S D">
      <div class="drive-knob" ref="knob"></div></div>`,
  mounted() {
    const pad = this.$el;
    this.is_held = false;
    pad.addEventListener("pointerdown", (event) => {
      pad.setPointerCapture(event.pointerId);
      // The pad may move or change its size under the thumb, as when a question appears; that does not drive.
      this.box = pad.getBoundingClientRect();
      this.is_held = true;
      this.tell(this.place(event));
    });
    pad.addEventListener("pointermove", (event) => {
      if (this.is_held) this.tell(this.place(event));
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"])
      pad.addEventListener(name, () => this.let_go());
    this.all_off = () => this.let_go();
    for (const name of ["blur", "pagehide"]) addEventListener(name, this.all_off);
    document.addEventListener("visibilitychange", this.all_off);
    this.on_driven = ({ detail }) => {
      this.$refs.knob.style.left = `${50 - 40 * detail.angular}%`;
      this.$refs.knob.style.top = `${50 - 40 * detail.linear}%`;
    };
    addEventListener("robbie-driven", this.on_driven);
  },
  unmounted() {
    removeEventListener("robbie-driven", this.on_driven);
    for (const name of ["blur", "pagehide"]) removeEventListener(name, this.all_off);
    document.removeEventListener("visibilitychange", this.all_off);
    this.let_go();
  },
  methods: {
    place(event) {
      const { box } = this;
      const limit = (value) => Math.max(-1, Math.min(1, value));
      return {
        pad: this.$el,
        linear: limit(1 - (2 * (event.clientY - box.top)) / box.height),
        angular: limit(1 - (2 * (event.clientX - box.left)) / box.width),
      };
    },
    tell(place) {
      dispatchEvent(new CustomEvent("robbie-pad", { detail: place }));
    },
    let_go() {
      if (!this.is_held) return;
      this.is_held = false;
      this.tell(null);
    },
  },
};
