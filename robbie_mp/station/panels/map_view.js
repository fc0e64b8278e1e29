import { from_json, Live, MapPicture } from "robbie-live";

// The map from above: x to the right, y up. Drag moves it, the wheel zooms. While something is to be placed,
// a press says where, and dragging from there says which way it looks; that is emitted as "placed".
export default {
  template: `<canvas class="map-view" tabindex="0" role="img" aria-label="Map" :data-placing="placing"
    :style="{ cursor: placing ? 'crosshair' : 'grab' }"></canvas>`,
  props: { placing: String },
  mounted() {
    this.marks = { robot: null, goal: null, path: [], frontiers: [], marked: [], places: [], others: [] };
    this.map = new MapPicture();
    this.updates = 0;
    this.centre = { x: 0, y: 0 };
    this.scale = 40; // pixels per m
    this.fitted = false;
    this.press = null;
    const canvas = this.$el;
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", () => (this.press = null));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.observer = new ResizeObserver(() => this.redraw());
    this.observer.observe(canvas);
    this.live = new Live("marks+map", canvas, (parts) => this.take(parts));
  },
  unmounted() {
    this.observer.disconnect();
    this.live.close();
  },
  methods: {
    async take(parts) {
      for (const [name, part] of Object.entries(parts))
        if (name.startsWith("marks/")) this.marks[name.slice("marks/".length)] = from_json(part);
      await this.map.take(parts);
      this.redraw();
      this.$el.dataset.map = this.map.is_whole ? "whole" : "";
      this.$el.dataset.updates = this.updates += 1;
    },
    fit() {
      const { map, $el: canvas } = this;
      if (!map.place || !canvas.clientWidth) return;
      const [cos, sin] = [Math.cos(map.place.yaw_rad), Math.sin(map.place.yaw_rad)];
      const [w, h] = [map.width_m / 2, map.height_m / 2];
      this.centre = { x: map.place.x_m + cos * w - sin * h, y: map.place.y_m + sin * w + cos * h };
      this.scale = 0.9 * Math.min(canvas.clientWidth / map.width_m, canvas.clientHeight / map.height_m);
      this.fitted = true;
      this.redraw();
    },
    zoom(factor, at) {
      const about = at || this.centre;
      const scale = Math.max(1, Math.min(2000, this.scale * factor));
      const kept = this.scale / scale;
      this.centre.x = about.x + (this.centre.x - about.x) * kept;
      this.centre.y = about.y + (this.centre.y - about.y) * kept;
      this.scale = scale;
      this.redraw();
    },
    save(name) {
      this.draw();
      const link = document.createElement("a");
      link.download = name;
      link.href = this.$el.toDataURL("image/png");
      link.click();
    },
    point(event) {
      const box = this.$el.getBoundingClientRect();
      return {
        x: this.centre.x + (event.clientX - box.left - box.width / 2) / this.scale,
        y: this.centre.y - (event.clientY - box.top - box.height / 2) / this.scale,
      };
    },
    down(event) {
      if (event.button !== 0) return;
      this.$el.setPointerCapture(event.pointerId);
      const at = this.point(event);
      this.press = { begin: at, at, placing: this.placing };
    },
    move(event) {
      if (!this.press) return;
      this.press.at = this.point(event);
      if (!this.press.placing) {
        this.centre.x += this.press.begin.x - this.press.at.x;
        this.centre.y += this.press.begin.y - this.press.at.y;
      }
      this.redraw();
    },
    up() {
      const press = this.press;
      this.press = null;
      this.redraw();
      if (!press || !press.placing) return;
      const [x, y] = [press.at.x - press.begin.x, press.at.y - press.begin.y];
      const dragged = Math.hypot(x, y) * this.scale > 10;
      this.$emit("placed", {
        what: press.placing, x_m: press.begin.x, y_m: press.begin.y, yaw_rad: dragged ? Math.atan2(y, x) : null,
      });
    },
    wheel(event) {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 500), this.point(event));
    },
    redraw() {
      if (this.asked) return;
      this.asked = true;
      requestAnimationFrame(() => {
        this.asked = false;
        this.draw();
      });
    },
    draw() {
      const canvas = this.$el;
      const [width, height, ratio] = [canvas.clientWidth, canvas.clientHeight, devicePixelRatio];
      if (!width || !height) return;
      if (!this.fitted) this.fit();
      if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
      if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
      const pen = canvas.getContext("2d");
      pen.setTransform(1, 0, 0, 1, 0, 0);
      pen.fillStyle = "#aaaaaa";
      pen.fillRect(0, 0, canvas.width, canvas.height);
      const scale = this.scale * ratio; // from here on in m, y up
      pen.setTransform(scale, 0, 0, -scale, canvas.width / 2 - this.centre.x * scale,
        canvas.height / 2 + this.centre.y * scale);
      this.draw_picture(pen);
      this.draw_path(pen);
      const { robot, goal, frontiers, marked, places, others } = this.marks;
      for (const frontier of frontiers) this.draw_frontier(pen, frontier);
      if (goal) this.draw_arrow(pen, goal, "#2e7d32");
      if (robot) this.draw_arrow(pen, robot, "#c62828");
      for (const { x, y, yaw, name } of others) {
        this.draw_arrow(pen, [x, y, yaw], "#5d4037");
        this.draw_name(pen, x, y, name);
      }
      for (const mark of [...places, ...marked]) this.draw_disc(pen, mark);
      const press = this.press;
      if (press && press.placing) {
        const yaw = Math.atan2(press.at.y - press.begin.y, press.at.x - press.begin.x);
        this.draw_arrow(pen, [press.begin.x, press.begin.y, yaw], "#1565c0");
      }
    },
    draw_picture(pen) {
      const map = this.map;
      if (!map.place) return;
      pen.save();
      // Walls are thin: when several cells share a pixel, none may be left out.
      pen.imageSmoothingEnabled = this.scale * devicePixelRatio * map.place.pixel_m < 1;
      pen.translate(map.place.x_m, map.place.y_m);
      pen.rotate(map.place.yaw_rad);
      pen.scale(1, -1);
      pen.drawImage(map.canvas, 0, -map.height_m, map.width_m, map.height_m);
      pen.restore();
    },
    draw_path(pen) {
      pen.beginPath();
      for (const [x, y] of this.marks.path) pen.lineTo(x, y);
      pen.strokeStyle = "#1565c0";
      pen.lineWidth = 3 / this.scale;
      pen.stroke();
    },
    draw_arrow(pen, [x, y, yaw], colour) {
      const size = Math.max(0.2, 10 / this.scale);
      pen.save();
      pen.translate(x, y);
      pen.rotate(yaw);
      pen.beginPath();
      pen.moveTo(size, 0);
      pen.lineTo(-0.7 * size, 0.7 * size);
      pen.lineTo(-0.3 * size, 0);
      pen.lineTo(-0.7 * size, -0.7 * size);
      pen.closePath();
      pen.fillStyle = colour;
      pen.fill();
      pen.restore();
    },
    draw_frontier(pen, [x, y, length]) {
      // A diamond, as wide as the frontier is long, but for very long ones.
      const size = Math.max(5 / this.scale, Math.min(length, 1) / 4);
      pen.save();
      pen.translate(x, y);
      pen.rotate(Math.PI / 4);
      pen.fillStyle = "#8e24aa";
      pen.fillRect(-size / 2, -size / 2, size, size);
      pen.restore();
    },
    draw_disc(pen, { x, y, name, colour }) {
      pen.beginPath();
      pen.arc(x, y, Math.max(0.12, 7 / this.scale), 0, 2 * Math.PI);
      pen.fillStyle = colour;
      pen.fill();
      this.draw_name(pen, x, y, name);
    },
    draw_name(pen, x, y, name) {
      pen.save();
      pen.translate(x, y);
      pen.scale(1 / this.scale, -1 / this.scale);
      pen.font = "13px sans-serif";
      pen.fillStyle = "#000000";
      pen.fillText(name, 10, -8);
      pen.restore();
    },
  },
};
