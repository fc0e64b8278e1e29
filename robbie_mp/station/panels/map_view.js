import { from_json, Live, MapPicture, show_age } from "robbie-live";

const MAX_FIT_SCALE = 150; // pixels per m
const SHOWN_SCALE = 80; // pixels per m, at least, round a place that is to be shown
const SHOWN_MS = 10_000; // for so long, the map does not follow the robot then
const FOLLOW_SCALE = 40; // pixels per m, at least, round a robot that the map follows
const PRESS_PX = 6; // a press that moves farther drags the map
const NEAR_PX = 22; // of a mark that is pressed, which is as wide as a thumb
const STEP_M = 0.01; // of packed points
const LEGEND = [
  ["arrow", "#c62828", "robot"], ["target", "#2e7d32", "goal"], ["disc", "#3949ab", "place"], ["person", "#00897b", "person"], ["line", "#1565c0", "path"], ["line", "#ef6c00", "trail"],
  ["dot", "#d50000", "laser"], ["diamond", "#8e24aa", "frontier"], ["square", "#b71c1c", "no-go"],
];
const COLOURS = Object.fromEntries(LEGEND.map(([, colour, name]) => [name, colour]));

// The map from above: x to the right and y up, or the robot's heading up. Drag moves it, the wheel zooms. While
// something is to be placed, a press says where, and dragging from there says which way it looks; that is emitted
// as "placed", or for a place to name as "pointed". A no-go area is drawn as a rectangle by dragging, or corner by
// corner, until the first one is pressed again; that is emitted as "outlined".
export default {
  template: `<canvas class="map-view" tabindex="0" role="img" aria-label="Map" :data-placing="placing"
    :style="{ cursor: placing ? 'crosshair' : 'grab' }"></canvas>`,
  props: {
    placing: String,
    follows: { type: String, default: "follow" },
    draft: { type: Object, default: null }, // what is drawn and has no name yet: { corners } or { x, y }
    hidden: { type: Array, default: () => [] },
    waiting: { type: Array, default: () => [] },
  },
  watch: {
    follows() {
      this.is_dragged = false;
      if (this.follows === "stay") this.turn = 0;
      this.redraw();
    },
    placing() {
      this.corners = [];
      this.take_focus();
      this.redraw();
    },
    hidden() {
      this.redraw();
    },
    waiting() {
      this.redraw();
    },
    draft() {
      this.redraw();
    },
  },
  mounted() {
    this.marks = { robot: null, goal: null, path: [], trail: [], frontiers: [], marked: [], places: [], others: [], no_go: [] };
    this.corners = []; // of the no-go area that is being drawn
    this.scans = new Map();
    this.cells = new Map(); // the marked cells of each layer
    this.turn = 0; // rad, of the map on the screen
    this.measures = null;
    this.measured = null;
    this.map = new MapPicture();
    this.updates = 0;
    this.centre = { x: 0, y: 0 };
    this.scale = 40; // pixels per m
    this.fitted = false;
    this.adjusted = false; // by the visitor; until then, the view grows with the map
    this.press = null;
    const canvas = this.$el;
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", () => (this.press = null));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    this.is_dragged = false; // until the server knows, and the map does not follow any more
    this.observer = new ResizeObserver(() => this.keep_view());
    this.observer.observe(canvas);
    this.ageing = setInterval(() => show_age(canvas.parentElement, this.marks.born), 200);
    this.live = new Live("marks+map", canvas, (parts) => this.take(parts));
    this.on_show = () => this.show_place();
    addEventListener("robbie-show-on-map", this.on_show);
    this.show_place();
  },
  unmounted() {
    clearTimeout(this.focus_timer);
    clearInterval(this.ageing);
    this.observer.disconnect();
    this.live.close();
    removeEventListener("robbie-show-on-map", this.on_show);
  },
  methods: {
    // Brings the place that another panel wants to show into the middle, and stays there for a while.
    show_place() {
      const place = window.place_on_map;
      if (!place) return;
      window.place_on_map = null;
      this.centre = place;
      this.scale = Math.max(this.scale, SHOWN_SCALE);
      this.fitted = this.adjusted = true;
      this.stays_until_ms = performance.now() + SHOWN_MS;
      this.$el.dataset.centre = `${place.x.toFixed(2)} ${place.y.toFixed(2)}`;
      this.redraw();
    },
    // What was in sight stays in sight when the tile has another size: as many metres along its shorter edge.
    keep_view() {
      const edge_px = Math.min(this.$el.clientWidth, this.$el.clientHeight);
      if (!edge_px) return; // it is hidden
      if (this.edge_px && this.adjusted) this.scale *= edge_px / this.edge_px;
      else this.fitted = false;
      this.edge_px = edge_px;
      this.redraw();
    },
    async take(parts) {
      for (const [name, part] of Object.entries(parts))
        if (name.startsWith("marks/points/")) this.scans.set(name, new Int16Array(part));
        else if (name.startsWith("marks/cells/")) this.cells.set(name.slice("marks/cells/".length), new Int16Array(part));
        else if (name.startsWith("marks/shades/")) continue;
        else if (name.startsWith("marks/")) this.marks[name.slice("marks/".length)] = from_json(part);
      if ((await this.map.take(parts)) && !this.adjusted) this.fitted = false;
      this.redraw();
      this.$el.dataset.map = this.map.is_whole ? "whole" : "";
      this.$el.dataset.updates = this.updates += 1;
    },
    // Shows all that is known, whatever the extent of the grid is.
    fit() {
      const { map, $el: canvas } = this;
      if (!map.place || !canvas.clientWidth) return;
      const { x_m, y_m, yaw_rad, pixel_m, columns, rows, known } = map.place;
      const [left, bottom, right, top] = known ?? [0, 0, columns, rows];
      const [cos, sin] = [Math.cos(yaw_rad), Math.sin(yaw_rad)];
      const [u, v] = [((left + right) / 2) * pixel_m, ((bottom + top) / 2) * pixel_m];
      this.centre = { x: x_m + cos * u - sin * v, y: y_m + sin * u + cos * v };
      const [width, height] = [(right - left) * pixel_m, (top - bottom) * pixel_m];
      const fitting = 0.9 * Math.min(canvas.clientWidth / width, canvas.clientHeight / height, MAX_FIT_SCALE);
      this.scale = this.follows === "stay" ? fitting : Math.max(fitting, FOLLOW_SCALE);
      this.fitted = true;
      this.adjusted = false;
      this.redraw();
    },
    measure() {
      this.measures = !this.measures;
      this.measured = null;
      this.redraw();
    },
    zoom(factor, at) {
      const about = at || this.centre;
      const scale = Math.max(1, Math.min(2000, this.scale * factor));
      const kept = this.scale / scale;
      this.centre.x = about.x + (this.centre.x - about.x) * kept;
      this.centre.y = about.y + (this.centre.y - about.y) * kept;
      this.scale = scale;
      this.adjusted = true;
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
      const right = (event.clientX - box.left - box.width / 2) / this.scale;
      const up = (box.top + box.height / 2 - event.clientY) / this.scale;
      const [cos, sin] = [Math.cos(this.turn), Math.sin(this.turn)];
      return { x: this.centre.x + cos * right + sin * up, y: this.centre.y - sin * right + cos * up };
    },
    down(event) {
      if (event.button !== 0) return;
      this.$el.setPointerCapture(event.pointerId);
      const at = this.point(event);
      const from = [event.clientX, event.clientY];
      this.press = { begin: at, at, from, placing: this.placing, measures: this.measures };
    },
    move(event) {
      if (!this.press) return;
      this.press.at = this.point(event);
      if (this.press.measures) this.measured = { begin: this.press.begin, end: this.press.at };
      else if (!this.press.placing) {
        const moved_px = Math.hypot(event.clientX - this.press.from[0], event.clientY - this.press.from[1]);
        this.press.drags ||= moved_px > PRESS_PX;
        if (!this.press.drags) return;
        if (this.follows !== "stay" && !this.is_dragged) this.$emit("dragged", {});
        this.is_dragged = true;
        this.centre.x += this.press.begin.x - this.press.at.x;
        this.centre.y += this.press.begin.y - this.press.at.y;
        this.adjusted = true;
      }
      this.redraw();
    },
    up() {
      const press = this.press;
      this.press = null;
      this.redraw();
      if (!press || press.measures) return;
      if (!press.placing) return press.drags ? undefined : this.press_mark(press.begin);
      const [x, y] = [press.at.x - press.begin.x, press.at.y - press.begin.y];
      const dragged = Math.hypot(x, y) * this.scale > 10;
      if (press.placing === "no_go") return this.outline(press, dragged);
      this.$emit(press.placing === "place" ? "pointed" : "placed", {
        what: press.placing, x_m: press.begin.x, y_m: press.begin.y, yaw_rad: dragged ? Math.atan2(y, x) : null,
      });
    },
    // Tells which mark was pressed: the nearest, or the area in which the place lies; or that none was.
    press_mark(at) {
      const distance_px = ([x, y]) => Math.hypot(x - at.x, y - at.y) * this.scale;
      const near = this.pressable().filter(({ place }) => distance_px(place) < NEAR_PX);
      near.sort((one, other) => distance_px(one.place) - distance_px(other.place));
      const area = this.shows("no_go") && this.marks.no_go.find(({ corners }) => is_inside(corners, at));
      const found = near[0] ?? (area && { kind: "area", name: area.name, place: middle_of(area.corners) });
      if (!found) return this.$emit("pressed", { kind: "" });
      const { kind, name, place } = found;
      this.$emit("pressed", { kind, name, x_m: place[0], y_m: place[1] });
    },
    pressable() {
      const { places, marked, others } = this.marks;
      const marks = this.shows("marks") ? [...places, ...marked] : [];
      return [...marks, ...(this.shows("others") ? others : [])].map(({ x, y, name, kind }) => ({ kind: kind ?? "mark", name, place: [x, y] }));
    },
    // Brings a place into the middle.
    show(x, y) {
      window.place_on_map = { x, y };
      this.show_place();
    },
    // Takes one more corner of a no-go area, or both corners of a rectangle.
    outline({ begin, at }, dragged) {
      const near = (one) => Math.hypot(one.x - at.x, one.y - at.y) * this.scale < 14;
      if (dragged && !this.corners.length) this.emit_outline(rectangle(begin, at));
      else if (this.corners.length > 2 && near(this.corners[0])) this.emit_outline(this.corners);
      else this.corners.push(at);
      this.$el.dataset.corners = this.corners.length;
      this.redraw();
    },
    emit_outline(corners) {
      this.$emit("outlined", { corners: corners.map(({ x, y }) => [x, y]) });
      this.corners = [];
    },
    wheel(event) {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY / 500), this.point(event));
    },
    // While something is placed, the map has the focus. Otherwise the next key presses again the button with which the
    // visitor has begun. A menu that is about to close would take the focus back, so the map waits for it.
    take_focus() {
      clearTimeout(this.focus_timer);
      if (!this.placing) return;
      if (document.activeElement?.closest(".q-menu")) this.focus_timer = setTimeout(() => this.take_focus(), 50);
      else this.$el.focus({ preventScroll: true });
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
      this.go_along();
      if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
      if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
      const pen = canvas.getContext("2d");
      this.names = [];
      pen.setTransform(1, 0, 0, 1, 0, 0);
      pen.fillStyle = "#aaaaaa";
      pen.fillRect(0, 0, canvas.width, canvas.height);
      const scale = this.scale * ratio; // from here on in m, y up
      pen.translate(canvas.width / 2, canvas.height / 2);
      pen.scale(scale, -scale);
      pen.rotate(this.turn);
      pen.translate(-this.centre.x, -this.centre.y);
      this.draw_picture(pen);
      this.draw_marks(pen);
      this.draw_placing(pen);
      pen.setTransform(ratio, 0, 0, ratio, 0, 0); // from here on in pixels
      if (this.shows("names")) this.draw_names(pen, width, height);
      if (this.measured) this.draw_measured(pen);
      this.draw_scale(pen, height);
      if (this.shows("legend") && height > 260 && width > 320) this.draw_legend(pen, width, height);
    },
    shows(layer) {
      return !this.hidden.includes(layer);
    },
    // Keeps the robot in the middle.
    go_along() {
      const { robot } = this.marks;
      if (this.follows === "stay" || this.is_dragged || !robot || this.press || performance.now() < this.stays_until_ms) return;
      this.centre = { x: robot[0], y: robot[1] };
      this.turn = this.follows === "heading" ? Math.PI / 2 - robot[2] : 0;
    },
    draw_marks(pen) {
      const { robot, goal, frontiers, marked, places, others, path, trail, no_go, doubt } = this.marks;
      for (const [layer, cells] of this.cells)
        if (this.shows(layer)) {
          const edge_m = this.marks.cell_edges?.[layer];
          this.draw_points(pen, cells, this.marks.cell_colours?.[layer] ?? "#000000", edge_m ? edge_m * this.scale : 5);
        }
      if (this.shows("no_go"))
        for (const { name, corners } of no_go) {
          this.draw_area(pen, corners);
          this.names.push([...middle_of(corners), name]);
        }
      if (this.shows("trail")) this.draw_line(pen, trail, COLOURS.trail, 2);
      if (this.shows("path")) this.draw_line(pen, path, COLOURS.path, 3);
      if (this.shows("frontiers")) for (const frontier of frontiers) this.draw_frontier(pen, frontier);
      if (this.shows("scan")) for (const scan of this.scans.values()) this.draw_points(pen, scan, COLOURS.laser, 3);
      if (goal) this.draw_target(pen, goal, COLOURS.goal);
      this.waiting.forEach(([x, y], at) => this.draw_disc(pen, { x, y, name: `${at + 1}`, colour: COLOURS.goal }));
      for (const { x, y, yaw, name } of this.shows("others") ? others : []) {
        this.draw_arrow(pen, [x, y, yaw], "#5d4037");
        this.names.push([x, y, name]);
      }
      if (this.shows("marks")) for (const mark of [...places, ...marked]) this.draw_mark(pen, mark);
      if (robot && doubt && this.shows("doubt")) this.draw_doubt(pen, robot, doubt);
      if (robot) this.draw_arrow(pen, robot, COLOURS.robot);
    },
    // The ellipse in which the robot is.
    draw_doubt(pen, [x, y], [half, other_half, direction]) {
      pen.beginPath();
      pen.ellipse(x, y, half, other_half, direction, 0, 2 * Math.PI);
      pen.globalAlpha = 0.2;
      pen.fillStyle = pen.strokeStyle = COLOURS.robot;
      pen.fill();
      pen.globalAlpha = 1;
      pen.lineWidth = 1 / this.scale;
      pen.stroke();
    },
    draw_placing(pen) {
      const press = this.press;
      if (this.draft?.corners) this.draw_area(pen, this.draft.corners);
      else if (this.draft) this.draw_disc(pen, { ...this.draft, name: "", colour: COLOURS["no-go"] });
      if (this.corners.length) {
        this.draw_area(pen, this.corners.map(({ x, y }) => [x, y]));
        for (const { x, y } of this.corners) this.draw_disc(pen, { x, y, name: "", colour: COLOURS["no-go"] });
      }
      if (!press || !press.placing || press.measures) return;
      if (press.placing === "no_go") {
        if (!this.corners.length) this.draw_area(pen, rectangle(press.begin, press.at).map(({ x, y }) => [x, y]));
        return;
      }
      const yaw = Math.atan2(press.at.y - press.begin.y, press.at.x - press.begin.x);
      this.draw_arrow(pen, [press.begin.x, press.begin.y, yaw], "#1565c0");
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
    draw_line(pen, points, colour, pixels) {
      pen.beginPath();
      for (const [x, y] of points) pen.lineTo(x, y);
      pen.strokeStyle = colour;
      pen.lineWidth = pixels / this.scale;
      pen.stroke();
    },
    draw_area(pen, corners) {
      pen.beginPath();
      for (const [x, y] of corners) pen.lineTo(x, y);
      pen.closePath();
      pen.globalAlpha = 0.3;
      pen.fillStyle = pen.strokeStyle = COLOURS["no-go"];
      pen.fill("evenodd");
      pen.globalAlpha = 1;
      pen.lineWidth = 2 / this.scale;
      pen.stroke();
    },
    draw_points(pen, steps, colour, pixels) {
      pen.fillStyle = colour;
      const size = pixels / this.scale;
      for (let at = 0; at < steps.length; at += 3)
        pen.fillRect(steps[at] * STEP_M - size / 2, steps[at + 1] * STEP_M - size / 2, size, size);
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
    // A ring round a dot, with a line to where the robot is to look: no arrow, which is the robot.
    draw_target(pen, [x, y, yaw], colour) {
      const size = Math.max(0.2, 11 / this.scale);
      pen.save();
      pen.translate(x, y);
      pen.rotate(yaw);
      pen.strokeStyle = pen.fillStyle = colour;
      pen.lineWidth = size / 4;
      pen.beginPath();
      pen.arc(0, 0, size, 0, 2 * Math.PI);
      pen.moveTo(size, 0);
      pen.lineTo(1.8 * size, 0);
      pen.stroke();
      pen.beginPath();
      pen.arc(0, 0, 0.45 * size, 0, 2 * Math.PI);
      pen.fill();
      pen.restore();
    },
    draw_mark(pen, mark) {
      if (mark.shape !== "person") return this.draw_disc(pen, mark);
      const size = Math.max(0.16, 10 / this.scale);
      pen.save();
      pen.translate(mark.x, mark.y);
      pen.rotate(-this.turn); // upright on the screen
      pen.scale(size, -size);
      pen.fillStyle = mark.colour;
      figure(pen);
      pen.restore();
      this.names.push([mark.x, mark.y, mark.name]);
    },
    draw_frontier(pen, [x, y, length]) {
      // A diamond, as wide as the frontier is long, but for very long ones.
      const size = Math.max(5 / this.scale, Math.min(length, 1) / 4);
      pen.save();
      pen.translate(x, y);
      pen.rotate(Math.PI / 4);
      pen.fillStyle = COLOURS.frontier;
      pen.fillRect(-size / 2, -size / 2, size, size);
      pen.restore();
    },
    draw_disc(pen, { x, y, name, colour }) {
      pen.beginPath();
      pen.arc(x, y, Math.max(0.12, 7 / this.scale), 0, 2 * Math.PI);
      pen.fillStyle = colour;
      pen.fill();
      this.names.push([x, y, name]);
    },
    // Where a point of the map is on the screen, in pixels.
    on_screen(x, y) {
      const [cos, sin] = [Math.cos(this.turn), Math.sin(this.turn)];
      const [dx, dy] = [x - this.centre.x, y - this.centre.y];
      const { clientWidth, clientHeight } = this.$el;
      return [
        clientWidth / 2 + (cos * dx - sin * dy) * this.scale,
        clientHeight / 2 - (sin * dx + cos * dy) * this.scale,
      ];
    },
    // Each name goes where it covers no other one; where there is no such place, it is left out.
    draw_names(pen, width, height) {
      const taken = [];
      pen.font = "13px sans-serif";
      pen.lineWidth = 3;
      pen.strokeStyle = "rgba(255, 255, 255, 0.85)";
      pen.fillStyle = "#000000";
      for (const [x, y, name] of this.names) {
        const [u, v] = this.on_screen(x, y);
        if (u < 0 || v < 0 || u > width || v > height) continue;
        const long = pen.measureText(name).width;
        const places = [[10, -8], [10, 18], [-10 - long, -8], [-10 - long, 18], [-long / 2, -16], [-long / 2, 26]];
        const boxes = places.map(([right, down]) => [u + right, v + down - 12, u + right + long, v + down + 4]);
        const all_free = boxes.filter((one) => taken.every((other) => apart(one, other)));
        const free = all_free.find((one) => one[0] >= 0 && one[1] >= 0 && one[2] <= width && one[3] <= height) ?? all_free[0];
        if (!free) continue;
        taken.push(free);
        pen.strokeText(name, free[0], free[1] + 12);
        pen.fillText(name, free[0], free[1] + 12);
      }
    },
    draw_measured(pen) {
      const { begin, end } = this.measured;
      const [from, to] = [this.on_screen(begin.x, begin.y), this.on_screen(end.x, end.y)];
      pen.beginPath();
      pen.moveTo(...from);
      pen.lineTo(...to);
      pen.strokeStyle = "#000000";
      pen.lineWidth = 2;
      pen.stroke();
      const distance_m = Math.hypot(end.x - begin.x, end.y - begin.y);
      this.$el.dataset.measured = distance_m.toFixed(2);
      draw_box(pen, to[0] + 10, to[1] - 24, `${distance_m.toFixed(2)} m`);
    },
    // A bar of 1, 2 or 5 times a power of ten, between 50 and 150 pixels long.
    draw_scale(pen, height) {
      const power = 10 ** Math.floor(Math.log10(150 / this.scale));
      const length_m = [5, 2, 1].map((one) => one * power).find((one) => one * this.scale <= 150);
      const [x, y, long] = [12, height - 12, length_m * this.scale];
      pen.beginPath();
      pen.moveTo(x, y - 6);
      pen.lineTo(x, y);
      pen.lineTo(x + long, y);
      pen.lineTo(x + long, y - 6);
      pen.strokeStyle = "#000000";
      pen.lineWidth = 2;
      pen.stroke();
      pen.font = "12px sans-serif";
      pen.fillStyle = "#000000";
      pen.fillText(length_m >= 1 ? `${length_m} m` : `${Math.round(100 * length_m)} cm`, x + 4, y - 5);
    },
    draw_legend(pen, width, height) {
      const [wide, line] = [86, 17];
      const [x, y] = [width - wide - 8, height - LEGEND.length * line - 14];
      pen.fillStyle = "rgba(255, 255, 255, 0.8)";
      pen.fillRect(x, y, wide, LEGEND.length * line + 6);
      pen.font = "12px sans-serif";
      LEGEND.forEach(([shape, colour, name], at) => {
        const [u, v] = [x + 12, y + 12 + at * line];
        pen.fillStyle = colour;
        pen.beginPath();
        if (shape === "line") pen.rect(u - 7, v - 1.5, 14, 3);
        else if (shape === "square") pen.rect(u - 5, v - 5, 10, 10);
        else if (shape === "dot") pen.rect(u - 1.5, v - 1.5, 3, 3);
        else if (shape === "diamond") polygon(pen, u, v, [[0, -5], [5, 0], [0, 5], [-5, 0]]);
        else if (shape === "disc") pen.arc(u, v, 5, 0, 2 * Math.PI);
        else if (shape === "target") {
          pen.arc(u, v, 6, 0, 2 * Math.PI);
          pen.arc(u, v, 4, 0, 2 * Math.PI, true);
          pen.moveTo(u + 2, v);
          pen.arc(u, v, 2, 0, 2 * Math.PI);
        } else if (shape === "person") {
          pen.save();
          pen.translate(u, v);
          pen.scale(6.5, 6.5);
          figure(pen);
          pen.restore();
        } else polygon(pen, u, v, [[6, 0], [-5, -5], [-2, 0], [-5, 5]]);
        pen.fill();
        pen.fillStyle = "#000000";
        pen.fillText(name, u + 14, v + 4);
      });
    },
  },
};

// A head and shoulders, 2 high, about the origin; y down.
function figure(pen) {
  pen.beginPath();
  pen.arc(0, -0.55, 0.5, 0, 2 * Math.PI);
  pen.moveTo(-0.9, 1);
  pen.arc(0, 1, 0.9, Math.PI, 2 * Math.PI);
  pen.closePath();
  pen.fill();
}

function rectangle(one, other) {
  const { x, y } = other;
  return [one, { x, y: one.y }, other, { x: one.x, y }];
}

function middle_of(corners) {
  return [0, 1].map((axis) => corners.reduce((sum, corner) => sum + corner[axis], 0) / corners.length);
}

function is_inside(corners, { x, y }) {
  let inside = false;
  corners.forEach(([right, top], at) => {
    const [left, bottom] = corners.at(at - 1);
    if (top > y !== bottom > y && x < right + ((left - right) * (y - top)) / (bottom - top)) inside = !inside;
  });
  return inside;
}

function apart(one, other) {
  return one[2] < other[0] || other[2] < one[0] || one[3] < other[1] || other[3] < one[1];
}

function polygon(pen, x, y, corners) {
  for (const [right, down] of corners) pen.lineTo(x + right, y + down);
  pen.closePath();
}

function draw_box(pen, x, y, text) {
  pen.font = "13px sans-serif";
  pen.fillStyle = "rgba(255, 255, 255, 0.9)";
  pen.fillRect(x, y, pen.measureText(text).width + 10, 20);
  pen.fillStyle = "#000000";
  pen.fillText(text, x + 5, y + 15);
}
